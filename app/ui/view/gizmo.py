"""Handles for the selected pieces and for the active cut plane, drawn by ImGuizmo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imgui_bundle import ImVec2, imgui, imguizmo
from numpy.typing import NDArray

from app.model.document import Part
from app.model.pieces import sections, shown_points
from app.model.rigid_transform import Motion
from app.session.session import Session
from app.translation import _
from engine.scene.camera import Camera
from engine.scene.plane import Plane, frame

__all__ = ["handles", "on_handles"]

gizmo = imguizmo.im_guizmo

WIDE, NARROW = 0.4, 0.1
"""Sizes of handles, where the width of the picture is 2: wide ones around the object, so that its faces can be clicked,
and ImGuizmo's default for handles in the middle of what they move."""


def handles(session: Session, camera: Camera, origin: ImVec2, size: ImVec2) -> bool:
    """Draws the handles of the tool; False if it has none."""
    if session.tool in ("move", "turn") and session.selected:
        return _piece_handles(session, camera, origin, size)
    if session.tool == "plane" and session.active_cut is not None:
        return _plane_handles(session, camera, origin, size)
    if session.tool == "upright" and session.object is not None:
        return _upright_handles(session, camera, origin, size)
    return False


def _piece_handles(session: Session, camera: Camera, origin: ImVec2, size: ImVec2) -> bool:
    chosen = [piece for piece in session.pieces if piece.key in session.selected and piece.visible]
    if not chosen:
        return False
    hidden = sections(session.document)
    points = np.concatenate([shown_points(piece, session.solid, hidden) for piece in chosen])
    if not len(points):
        return False
    place = np.eye(4)
    place[:3, 3] = points.mean(0)
    operation = gizmo.OPERATION.translate if session.tool == "move" else gizmo.OPERATION.rotate
    moved = _manipulate("piece", camera, origin, size, operation, gizmo.MODE.world, place)
    if moved is not None:
        motion = Motion.of(moved @ np.linalg.inv(place))
        session.place(_("Move") if session.tool == "move" else _("Turn"), session.selected, motion, merge="handles")
    return True


def _plane_handles(session: Session, camera: Camera, origin: ImVec2, size: ImVec2) -> bool:
    assert session.active_cut is not None
    cut = session.document.cut(session.active_cut)
    if cut.kind != "section" or len(cut.parts) != 1 or not cut.on:
        return False
    plane = cut.plane(cut.parts[0])
    place = np.eye(4)
    place[:3, :3] = frame(plane.normal).T
    centre = session.solid.centre
    place[:3, 3] = centre - np.asarray(plane.normal) * float(plane.distance(centre))
    moved = None
    for name, operation in (("slide", gizmo.OPERATION.translate_z), ("tilt", gizmo.OPERATION.rotate)):
        dragged = _manipulate(name, camera, origin, size, operation, gizmo.MODE.local, place)
        moved = moved if dragged is None else dragged
    if moved is not None:
        new = Plane.through(moved[:3, 3], moved[:3, 2])
        session.change_cut(
            _("Move plane"), cut.id, lambda c: replace(c, parts=(Part(new),), shift=0.0), merge="handles"
        )
    return True


def _upright_handles(session: Session, camera: Camera, origin: ImVec2, size: ImVec2) -> bool:
    # The handles work in the viewer's frame, with up as z, where nothing but the object moves while it is turned.
    up, right = np.asarray(session.up), camera.viewmat[0, :3]
    viewer = np.stack([right, np.cross(up, right), up])
    to_object = np.eye(4)
    to_object[:3, :3], to_object[:3, 3] = viewer.T, session.solid.centre
    seen = replace(camera, viewmat=camera.viewmat @ to_object)
    gizmo.set_gizmo_size_clip_space(WIDE)
    moved = _manipulate("upright", seen, origin, size, gizmo.OPERATION.rotate, gizmo.MODE.world, np.eye(4))
    gizmo.set_gizmo_size_clip_space(NARROW)
    if moved is not None:
        session.turn_object(viewer.T @ moved[:3, :3] @ viewer)
    return True


def _manipulate(
    name: str,
    camera: Camera,
    origin: ImVec2,
    size: ImVec2,
    operation: object,
    mode: object,
    place: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Draws handles at `place` (4, 4). Returns the new matrix if they were dragged, else None."""
    gizmo.set_orthographic(camera.orthographic)
    gizmo.set_drawlist(imgui.get_window_draw_list())
    gizmo.set_rect(origin.x, origin.y, size.x, size.y)
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ camera.viewmat
    matrix = gizmo.Matrix16(place.T.ravel().tolist())
    gizmo.push_id(name)
    changed = gizmo.manipulate(
        gizmo.Matrix16(view.T.ravel().tolist()),
        gizmo.Matrix16(projection(camera).T.ravel().tolist()),
        operation,  # type: ignore[arg-type]
        mode,  # type: ignore[arg-type]
        matrix,
    )
    gizmo.pop_id()
    return np.asarray(matrix.values, np.float64).reshape(4, 4).T if changed else None


def on_handles() -> bool:
    """Whether the pointer is on handles, or drags them; only meaningful after some were drawn."""
    return bool(gizmo.is_using() or gizmo.is_over())


def projection(camera: Camera) -> NDArray[np.float64]:
    """(4, 4). OpenGL's projection matrix of a camera whose principal point is the centre of the picture."""
    w, h = camera.width, camera.height
    depth = float(np.linalg.norm(camera.viewmat[:3, 3])) or 1.0
    near, far = 1e-2 * depth, 1e2 * depth
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = 2 * camera.fx / w, 2 * camera.fy / h
    if camera.orthographic:
        matrix[2, 2], matrix[2, 3], matrix[3, 3] = -2 / (far - near), -(far + near) / (far - near), 1.0
    else:
        matrix[2, 2], matrix[2, 3], matrix[3, 2] = -(far + near) / (far - near), -2 * far * near / (far - near), -1.0
    return matrix
