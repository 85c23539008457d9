"""The viewport: draws the object, and turns actions of the pointer into edits and views."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.camera_control import OrbitCamera
from app.model.document import Document, Key
from app.model.knife import SHORTEST, Stroke, plane_of
from app.model.marking import SURFACE_OPACITY
from app.model.pieces import Member, PlacedPiece
from app.model.rigid_transform import STILL, Motion
from app.model.upright import point_under
from app.session.session import Session
from app.translation import _
from app.ui.keyboard import press_in_viewport
from app.ui.panels.view_options import ViewOptions
from app.ui.theme import palette, px, rgb, rgba, u32
from app.ui.view.animation import CameraAnimation, PieceAnimation
from app.ui.view.annotations import marker_outline
from app.ui.view.axis_cube import axis_cube
from app.ui.view.box_handles import BoxHandles
from app.ui.view.gizmo import handles, on_handles
from app.ui.view.overlays import family_names, film_label, mode_switch, piece_names, statistics, tool_hint
from app.ui.view.painter import REST, Painter
from app.ui.view.plane_lines import PlaneLines
from app.ui.view.point_picker import PointPicker
from app.ui.view.selection import selection_frames
from app.ui.view.slices import slice_colours
from app.ui.view.stroke import cut_lines, draw_stroke
from app.ui.widgets import colours
from engine.render.gl.overlay import Lines, Sheet
from engine.scene.camera import Camera
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from training.families import Kind

__all__ = ["Viewport"]

ANY_BUTTON = (
    imgui.ButtonFlags_.mouse_button_left
    | imgui.ButtonFlags_.mouse_button_right
    | imgui.ButtonFlags_.mouse_button_middle
)

CUTTING = {
    "stroke": _("release to cut    Shift: snap"),
    "blade": _("release to cut"),
    "plane": _("release to place    Shift: snap"),
}
"""What releasing the button does, by the kind of drag that draws a stroke."""


@dataclass
class Drag:
    """A drag: what the pointer does while a button is pressed."""

    kind: str
    """'stroke', 'blade', 'plane', 'mark', 'orbit', 'pan', 'move' or 'turn'."""
    start: tuple[float, float]
    last: tuple[float, float]
    keys: frozenset[Key] = frozenset()
    depth: float = 1.0
    """Distance of the dragged point along the view direction, world units."""
    cancelled: bool = False
    path: list[tuple[float, float]] = field(default_factory=list)
    """Where the pointer has been, for 'mark' and 'blade'."""


class Viewport:
    """Draws the middle of the window and handles the pointer in it."""

    def __init__(self, session: Session, painter: Painter) -> None:
        self.session, self.painter = session, painter
        self.camera_animation = CameraAnimation()
        self.piece_animations: dict[int, PieceAnimation] = {}
        """Animations of pieces by the object's number."""
        self._members: list[Member] = []
        """The pieces that the last frame shows, in the order in which they were drawn."""
        self.drag: Drag | None = None
        self.show_families: frozenset[Kind] = frozenset()
        self.sliced: Sequence[Plane] = ()
        """The planes of the slices beside the object, in object space."""
        self.focused = False
        """Whether the picture has the keyboard focus."""
        self.menu_requested = False
        self.menu_point: tuple[float, float] | None = None
        """Where on the object the context menu was requested, in the window's units."""
        self.size = (640, 480)
        """Width and height of the picture, in the window's units."""
        self.origin = ImVec2(0, 0)
        self.plane_lines = PlaneLines(session)
        self.point_picker = PointPicker(session)
        self._behind = False
        """Whether there is input that the last frame has not handled: ImGui takes a press and a release one by one."""
        self._handled = False
        """Whether handles were drawn in the last frame."""
        self.box_handles = BoxHandles(session)
        self.options = ViewOptions(session)
        self._eye = OrbitCamera()
        self._placed: tuple[object, ...] = ()
        self._moved = -10.0

    @property
    def moving(self) -> bool:
        """Whether an animation is running or input is waiting, so that frames must be drawn without an event."""
        sliding = any(animation.moving for animation in self.piece_animations.values())
        return (
            sliding
            or self.session.film.playing
            or self.session.throw.active
            or self._behind
            or self.camera_animation.now() is not None
        )

    def camera(self, scale: float = 1.0) -> Camera:
        """The camera of the picture, in window units times `scale`."""
        eye = self.camera_animation.now() or self.session.viewing.eye
        width, height = (max(1, round(side * scale)) for side in self.size)
        return eye.camera(width, height, self.session.view_up)

    def go(self, eye: OrbitCamera) -> None:
        """Moves the view to a camera, animated if the settings allow it."""
        if self.session.settings.motion:
            self.camera_animation.go(self.session.viewing.eye, eye)
        self.session.viewing = replace(self.session.viewing, eye=eye)

    def fit(self) -> None:
        """Fits everything into the picture, animated if the settings allow it."""
        before = self.session.viewing.eye
        self.session.fit(self.size[0] / max(self.size[1], 1))
        if self.session.settings.motion:
            self.camera_animation.go(before, self.session.viewing.eye)

    def game_keys(self) -> None:
        """Handles the keys that end Throw and slice, keeping the cuts made in flight or not."""
        throw = self.session.throw
        if not throw.active or self.drag is not None:
            return
        if imgui.is_key_pressed(imgui.Key.escape):
            throw.stop()
        elif imgui.is_key_pressed(imgui.Key.enter) or imgui.is_key_pressed(imgui.Key.keypad_enter):
            throw.keep()

    def show(self) -> None:
        """Draws one frame."""
        session = self.session
        available = imgui.get_content_region_avail()
        self.origin = imgui.get_cursor_screen_pos()
        self.size = (max(16, round(available.x)), max(16, round(available.y)))
        size = ImVec2(*self.size)
        scale = float(imgui.get_io().display_framebuffer_scale.x) or 1.0
        pieces = self._placed_pieces(session.drawn_documents[session.active])
        self._members = self._placed_members(pieces)
        shown = session.drawn(self._members)
        background = session.viewing.background or rgb(palette().view)
        draw = imgui.get_window_draw_list()
        corner = ImVec2(self.origin.x + size.x, self.origin.y + size.y)
        moving = self._is_moving(shown)
        stroke = self._stroke() if session.solids else None
        wired = session.settings.wires and session.object is not None and not session.throw.active
        over: list[Lines | Sheet] = [
            *([] if session.previewing else self.plane_lines.sheets()),
            *self.plane_lines.families(self.show_families, pieces, scale),
            *(self.plane_lines.body([] if session.mode == "capture" else self._members, scale) if wired else []),
            *self.plane_lines.slices(self.sliced, slice_colours(), pieces, scale),
            *(cut_lines(session, self.camera(), stroke, self._members, self.plane_lines, scale) if stroke else []),
            *self.box_handles.edges(scale),
        ]
        self._behind = bool(len(imgui.get_current_context().input_events_queue))
        texture = self.painter.shown
        if not self._behind or texture is None:  # otherwise keys come faster than frames: handle all presses first
            texture = self.painter.frame(session, self.camera(scale), shown, background, over, moving)
        if texture is None:
            draw.add_rect_filled(self.origin, corner, u32(palette().view))
        else:
            draw.add_image(imgui.ImTextureRef(texture.glo), self.origin, corner)
        imgui.push_clip_rect(self.origin, corner, True)
        camera = self.camera()
        if self._handled and on_handles():  # handles take no click while any item is under the pointer
            imgui.dummy(size)
            hovered = active = self.focused = False
        else:
            imgui.set_next_item_allow_overlap()
            with colours(nav_cursor=rgba(palette().text, 0)):  # ImGui's own focus ring would lie outside
                imgui.invisible_button("##canvas", size, ANY_BUTTON | imgui.ButtonFlags_.enable_nav)
            flags = imgui.HoveredFlags_.no_nav_override
            hovered, active = imgui.is_item_hovered(flags), imgui.is_item_active()
            self.focused = imgui.is_item_focused()
            if self.focused:
                if imgui.get_io().nav_visible:
                    draw.add_rect(self.origin, corner, u32(palette().text), px(3), px(4))  # half of it is clipped
                press_in_viewport(session, camera, self.size, self.point_picker.cut_id is not None)
        selection_frames(session, camera, pieces, self.origin)
        if session.settings.names and session.mode != "capture" and not session.previewing:
            piece_names(session, camera, pieces, self.origin)
        family_names(session, self.show_families, self.plane_lines, camera, pieces, self.origin)
        self._handled = self.drag is None and not session.previewing and handles(session, camera, self.origin, size)
        busy = self._handled and on_handles()
        busy = self.box_handles.show(camera, self.origin, self.drag is None and hovered) or busy
        if not busy:
            self._mouse(camera, hovered, active)
        stroke = self._stroke()
        if stroke is not None and self.drag is not None:
            draw_stroke(stroke, self.origin, self.size[1], CUTTING[self.drag.kind])
        if self.drag is not None and self.drag.kind == "mark" and not self.drag.cancelled:
            marker_outline(draw, session.isolation.marker, self.drag.path, self.origin)
        self.point_picker.show(camera, self.origin, hovered and self.drag is None)
        opened = session.document.scene is not None
        if opened:
            if mode_switch(session, self.origin, self.size) is not None:
                session.film.leave()
            self.options.show()
        if opened and self.size[0] > px(420):
            middle = ImVec2(self.origin.x + self.size[0] - px(62), self.origin.y + px(62))
            axis = axis_cube(camera, session.view_up, middle, px(92))
            if axis is not None:
                self.go(session.viewing.eye.along(axis, session.view_up))
        film_label(session, self.origin, self.size)
        if session.settings.statistics:
            statistics(session, self._members, self.painter.milliseconds, self.origin, self.size)
        if hovered and self.drag is None and not busy:
            tool_hint(session)
        imgui.pop_clip_rect()

    def _placed_pieces(self, document: Document) -> list[PlacedPiece]:
        """An object's pieces where they are drawn now."""
        animation = self.piece_animations.setdefault(document.number, PieceAnimation())
        moves = self.session.settings.motion and not self.session.previewing
        return animation.placed(self.session.pieces_of(document), moves)

    def _placed_members(self, pieces: list[PlacedPiece]) -> list[Member]:
        """The visible pieces of all visible objects where they are drawn now. `pieces`: those of the active object."""
        session, result = self.session, []
        solids = session.solids
        for index, document in enumerate(session.drawn_documents):
            if document.visible and document.number in solids:
                placed = pieces if index == session.active else self._placed_pieces(document)
                result += [Member(index, piece) for piece in placed if piece.visible]
        return result

    def _is_moving(self, shown: Sequence[Piece]) -> bool:
        """Whether the view is changing: the camera moves, or pieces or planes are dragged."""
        eye = self.camera_animation.now() or self.session.viewing.eye
        placed = tuple((piece.planes, piece.transform.tobytes()) for piece in shown)
        dragged = imgui.is_mouse_down(imgui.MouseButton_.left) and placed != self._placed
        now = time.monotonic()
        if eye != self._eye or dragged:
            self._moved = now
        self._eye, self._placed = eye, placed
        return self.moving or now - self._moved < REST

    # The pointer

    def _at(self) -> tuple[float, float]:
        """Position of the pointer in the picture, in the window's units."""
        mouse = imgui.get_mouse_pos()
        return mouse.x - self.origin.x, mouse.y - self.origin.y

    def _mouse(self, camera: Camera, hovered: bool, active: bool) -> None:
        session, io, at = self.session, imgui.get_io(), self._at()
        if hovered and io.mouse_wheel and self.drag is None:
            session.film.playing = False
            eye = session.viewing.eye.zoomed(io.mouse_wheel, at, self.size, session.view_up, session.solid.radius)
            session.viewing = replace(session.viewing, eye=eye)
        if active and self.drag is None:
            self._begin(camera, at)
        drag = self.drag
        if drag is None:
            return
        dx, dy = at[0] - drag.last[0], at[1] - drag.last[1]
        drag.last = at
        eye = session.viewing.eye
        if drag.kind == "orbit":
            if dx or dy:
                session.viewing = replace(session.viewing, eye=eye.turned(dx, dy))
        elif drag.kind == "pan":
            if dx or dy:
                session.viewing = replace(session.viewing, eye=eye.panned(dx, dy, self.size[1], session.view_up))
        elif drag.kind in ("move", "turn") and (dx or dy):
            self._drag_pieces(camera, drag, dx, dy)
        elif drag.kind in ("mark", "blade") and (dx or dy):
            drag.path.append(at)
        if imgui.is_key_pressed(imgui.Key.escape) and drag.kind in (*CUTTING, "mark"):
            drag.cancelled = True
            session.notify(_("Not selected.") if drag.kind == "mark" else _("Not cut."))
        if not active:
            self._end(camera, drag, at)
            self.drag = None

    def _begin(self, camera: Camera, at: tuple[float, float]) -> None:
        session, io = self.session, imgui.get_io()
        left = imgui.is_mouse_down(imgui.MouseButton_.left)
        kind = "orbit"
        if imgui.is_mouse_down(imgui.MouseButton_.middle) or (not left and io.key_shift):
            kind = "pan"
        keys: frozenset[Key] = frozenset()
        depth = session.viewing.eye.distance
        if left and session.throw.active:
            kind = "stroke"
        elif left and session.tool == "isolate":
            kind = "mark" if session.mode == "capture" and session.isolation.available else kind
        elif left and not io.key_alt:
            if session.tool in ("knife", "blade", "plane"):
                kind = "stroke" if session.tool == "knife" else session.tool
            elif session.tool in ("move", "turn"):
                member, point = self._pick(at)
                if member is not None and point is not None:
                    key = self._activate(member)
                    kind, depth = session.tool, float((point - camera.position) @ camera.forward)
                    keys = session.selected if key in session.selected else frozenset([key])
                    session.selected = keys
        session.film.playing = False
        if kind not in ("orbit", "pan") and not session.throw.active:
            session.film.leave()  # edits apply to the object as it is
        self.drag = Drag(kind, at, at, keys, depth, path=[at])

    def _end(self, camera: Camera, drag: Drag, at: tuple[float, float]) -> None:
        session, io = self.session, imgui.get_io()
        moved = float(np.hypot(at[0] - drag.start[0], at[1] - drag.start[1]))
        stroke = self._stroke()
        if stroke is not None and drag.kind != "plane":
            session.slice(camera, stroke)
            if session.throw.active:
                return
            session.change_settings(replace(session.settings, seen_hint=True))
        elif stroke is not None:
            plane = plane_of(camera, stroke, session.up, session.solid.centre)
            if plane is not None:
                towards = plane if np.asarray(plane.normal) @ camera.forward <= 0 else plane.flipped()
                session.add_plane(towards)
        elif drag.kind == "mark" and not drag.cancelled:
            how = "add" if io.key_shift else "subtract" if io.key_alt else session.isolation.how
            session.isolation.select(camera, drag.path, how)
        elif drag.kind in ("move", "turn"):
            session.history.settle()
        elif drag.kind == "orbit" and moved < SHORTEST:
            self._click(at)

    def _click(self, at: tuple[float, float]) -> None:
        session = self.session
        member, point = self._pick(at)
        if self.point_picker.cut_id is not None and imgui.is_mouse_released(imgui.MouseButton_.left):
            self.point_picker.click(member, point)
            return
        key = None
        if member is not None:
            key = self._activate(member)
        elif session.tool != "upright" and session.mode != "capture":
            session.object_selected = False
        if imgui.is_mouse_released(imgui.MouseButton_.right):
            if key is not None and key not in session.selected:
                session.selected = frozenset([key])
            self.menu_requested = True
            self.menu_point = at if key is not None or session.mode == "capture" else None
        elif session.tool == "upright":
            self.stand_on(at)
        elif imgui.get_io().key_ctrl and key is not None:
            session.selected = session.selected ^ {key}
        else:
            session.selected = frozenset() if key is None or len(session.pieces) < 2 else frozenset([key])

    def _activate(self, member: Member) -> Key:
        """Makes the object that a piece belongs to the active one; returns the piece's key."""
        self.session.activate(member.index, len(self.session.documents) > 1)
        return member.piece.key

    def _pick(self, at: tuple[float, float]) -> tuple[Member | None, NDArray[np.float64] | None]:
        """The piece at a point of the picture, and the world point (3,) there."""
        if self.session.mode == "capture":
            return None, None
        scale = float(imgui.get_io().display_framebuffer_scale.x) or 1.0
        number, point = self.painter.pick(at[0] * scale, at[1] * scale)
        shown = [member for member in self._members for _ in member.piece.cells]
        return (shown[number], point) if number is not None and number < len(shown) else (None, None)

    def stand_on(self, at: tuple[float, float]) -> None:
        """Stands the object on the face at a point of the picture."""
        session, camera = self.session, self.camera()
        shown = session.object
        if shown is None or shown.capture is None:
            return
        motion = STILL
        if session.mode == "capture":
            opaque = shown.capture.opacities > SURFACE_OPACITY
            point = point_under(shown.capture.means[opaque], camera, at)
        else:
            member, point = self._pick(at)
            if member is not None:
                self._activate(member)
                motion = member.piece.motion.inverse()
        if point is None:
            session.notify(_("Click on the object: on the face that it stands on."))
            return
        session.stand_on(motion.apply(point), motion.apply(camera.position))

    def _drag_pieces(self, camera: Camera, drag: Drag, dx: float, dy: float) -> None:
        """Moves the dragged pieces parallel to the picture, or rotates them about its axes."""
        session = self.session
        rotation = camera.viewmat[:3, :3]
        if drag.kind == "move":
            unit = 1 / camera.fx if camera.orthographic else drag.depth / camera.fx
            motion = Motion.by(unit * (dx * rotation[0] + dy * rotation[1]))
        else:
            rows = [p.motion.apply(session.solid.points[p.rows]) for p in session.pieces if p.key in drag.keys]
            if not rows:  # undone or deleted while it is dragged
                return
            middle = np.concatenate(rows).mean(0)
            motion = Motion.about(middle, rotation[1], -0.4 * dx).after(Motion.about(middle, rotation[0], 0.4 * dy))
        session.place(_("Move") if drag.kind == "move" else _("Turn"), drag.keys, motion, merge="drag")

    # The overlay

    def _stroke(self) -> Stroke | None:
        """The stroke that is being drawn."""
        drag = self.drag
        if drag is None or drag.kind not in CUTTING or drag.cancelled:
            return None
        if drag.kind == "blade":
            return Stroke(drag.start, drag.path[-1], path=tuple(drag.path))
        return Stroke(drag.start, drag.last, imgui.get_io().key_shift)
