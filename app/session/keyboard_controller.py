"""Work in the viewport without a pointer: places, moves and tilts a plane and cuts along it; moves and turns pieces and
the view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.model.document import Cut
from app.model.pieces import sections, shown_points
from app.model.rigid_transform import Motion
from app.session.workspace import Workspace
from app.translation import _, ngettext
from engine.scene.camera import Camera, equator
from engine.scene.plane import Plane

__all__ = ["KeyboardController"]

STEP, ANGLE = 0.04, 5.0
"""How far one key press moves something, in radii of the object, and turns it, in degrees."""

FINE = 0.1
"""Part of these steps that a press makes while Ctrl is held."""

ORBIT = 20.0
"""How far one press looks around: as far as a drag of this many of the window's units."""

PLACED = _("Arrows move and tilt the plane, with Shift they turn it, with Ctrl finely. Enter: cut, Esc: take it away.")


class KeyboardController:
    """Moves the plane, the pieces or the view with keys, depending on the tool."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._hinge: tuple[int, NDArray[np.float64]] | None = None
        """Id of a cut, and the level axis that its plane tilts about, which is kept while the plane passes through the
        horizontal."""

    @property
    def section(self) -> Cut | None:
        """The cut whose plane keys act on: the active section, while a cutting tool is chosen."""
        workspace = self.workspace
        if workspace.active_cut is None or workspace.tool not in ("knife", "plane") or workspace.mode == "capture":
            return None
        cut = workspace.document.cut(workspace.active_cut)
        return cut if cut.kind == "section" and cut.on and len(cut.parts) == 1 else None

    def enter(self, camera: Camera) -> None:
        """Places an upright plane through the middle of the object, seen edge-on; or cuts along the present plane."""
        workspace, cut = self.workspace, self.section
        if workspace.tool not in ("knife", "plane"):
            return
        if workspace.atoms is None:
            workspace.notify(_("There is no solid to cut."))
        elif cut is None:
            workspace.select_tool("plane")
            workspace.add_plane(Plane.through(workspace.solid.centre, camera.viewmat[0, :3]))
            workspace.notify(PLACED)
        else:
            workspace.change_cut(_("Slice"), cut.id, lambda c: replace(c, kind="slice"))
            workspace.active_cut = None
            workspace.notify(
                ngettext("Cut into {count} piece.", "Cut into {count} pieces.", len(workspace.pieces)).format(
                    count=len(workspace.pieces)
                )
            )

    def escape(self) -> None:
        """Removes the plane that has not been cut along yet."""
        cut = self.section
        if cut is not None:
            self.workspace.remove_cut(cut.id)
            self.workspace.notify(_("Not cut."))

    def arrow(self, camera: Camera, x: int, y: int, shift: bool = False, fine: bool = False) -> None:
        """Handles an arrow key: right (x = 1), left (-1), up (y = 1) or down (-1)."""
        workspace, part = self.workspace, FINE if fine else 1.0
        cut = self.section
        if cut is not None:
            self._move_plane(camera, cut, part * x, part * y, shift)
        elif workspace.tool in ("move", "turn") and workspace.selected:
            self._move_pieces(camera, part * x, part * y, shift)
        else:
            eye, by = workspace.viewing.eye, part * ORBIT
            if shift:
                eye = eye.panned(by * x, -by * y, camera.height, workspace.view_up)
            else:
                eye = eye.turned(by * x, -by * y)
            workspace.viewing = replace(workspace.viewing, eye=eye)

    def _move_plane(self, camera: Camera, cut: Cut, x: float, y: float, shift: bool) -> None:
        """Moves the plane along its normal, to the right or up as seen (x), tilts it about a level axis in it (y), or
        turns it about the up axis (x with Shift)."""
        workspace = self.workspace
        plane, up = cut.plane(cut.parts[0]), np.asarray(workspace.up)
        normal, centre = np.asarray(plane.normal), workspace.solid.centre
        foot = centre - normal * float(plane.distance(centre))
        hinge = self._hinge[1] if self._hinge is not None and self._hinge[0] == cut.id else None
        if hinge is None or abs(float(hinge @ normal)) > 0.1:
            level = np.cross(up, normal)
            hinge = level / np.linalg.norm(level) if np.linalg.norm(level) > 1e-3 else equator(up)[0]
        motion = Motion.about(foot, hinge, -ANGLE * y)
        if x and shift:
            motion = Motion.about(foot, up, ANGLE * x)
            hinge = motion.rotation @ hinge
        elif x:
            seen = camera.viewmat[:2, :3] @ normal
            way = 1.0 if seen[0] - seen[1] > 0 else -1.0
            motion = Motion.by(way * x * STEP * workspace.solid.radius * normal)
        self._hinge = (cut.id, hinge)
        moved = motion.carried(plane)
        workspace.change_cut(_("Move plane"), cut.id, lambda c: c.with_plane(moved), merge=f"keys {cut.id}")

    def _move_pieces(self, camera: Camera, x: float, y: float, shift: bool) -> None:
        """Moves the pieces in the plane of the picture, or with Shift nearer and farther. With the turn tool, turns
        them about the picture's axes."""
        workspace, (right, down, forward) = self.workspace, camera.viewmat[:3, :3]
        chosen = [piece for piece in workspace.pieces if piece.key in workspace.selected]
        if workspace.tool == "move":
            towards = x * right + y * (forward if shift else -down)
            motion = Motion.by(STEP * workspace.solid.radius * towards)
        else:
            hidden = sections(workspace.document)
            shown = [shown_points(piece, workspace.solid, hidden) for piece in chosen]
            points = np.concatenate([np.empty((0, 3)), *shown])
            if not len(points):  # another cut hides all of them
                return
            axis = x * (forward if shift else down) * (1 if shift else -1) + y * right
            motion = Motion.about(points.mean(0), axis, -ANGLE * float(np.hypot(x, y)))
        name = _("Move") if workspace.tool == "move" else _("Turn")
        workspace.place(name, workspace.selected, motion, merge="keys")
