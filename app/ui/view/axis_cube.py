"""The axis cube: shows the orientation of the view, and changes it when a face is clicked."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.rigid_transform import Vec3, vec3
from app.translation import _
from app.ui.theme import Fonts, palette, u32
from app.ui.widgets import font
from engine.scene.camera import Camera, equator

__all__ = ["axis_cube"]


def axis_cube(camera: Camera, up: Vec3, centre: ImVec2, size: float) -> Vec3 | None:
    """Draws the cube around a point of the screen; if a face was clicked, returns the axis to look from."""
    p, draw = palette(), imgui.get_window_draw_list()
    u = np.asarray(up, np.float64)
    e1, e2 = equator(u)
    axes = {_("Right"): e1, _("Left"): -e1, _("Back"): e2, _("Front"): -e2, _("Top"): u, _("Bottom"): -u}
    rotation = camera.viewmat[:3, :3]
    mouse = np.array([imgui.get_mouse_pos().x, imgui.get_mouse_pos().y])
    half = size / 2 / 1.55
    chosen: Vec3 | None = None
    imgui.set_cursor_screen_pos(ImVec2(centre.x - size / 2, centre.y - size / 2))
    imgui.set_next_item_allow_overlap()
    pressed = imgui.invisible_button("##cube", ImVec2(size, size))
    inside = imgui.is_item_hovered()
    for name, axis in axes.items():
        facing = -float(rotation[2] @ axis)
        if facing < 0.04:
            continue
        side = e2 if name in (_("Right"), _("Left")) else e1
        other = np.cross(axis, side)
        corners = [axis + a * side + b * other for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        flat = np.array([(rotation @ c)[:2] for c in corners]) * half + (centre.x, centre.y)
        hovered = inside and _within(mouse, flat)
        a, b, c, d = (ImVec2(*point) for point in flat.tolist())
        draw.add_quad_filled(a, b, c, d, u32(p.pressed if hovered else p.field, 0.92))
        draw.add_quad(a, b, c, d, u32(p.second, 0.5), 1.0)
        if facing > 0.35:
            with font(Fonts.small):
                extent = imgui.calc_text_size(name)
                at = flat.mean(0)
                colour = u32(p.text if hovered else p.second, min(1.0, 0.45 + 0.9 * facing))
                draw.add_text(ImVec2(float(at[0]) - extent.x / 2, float(at[1]) - extent.y / 2), colour, name)
        if hovered:
            imgui.set_mouse_cursor(imgui.MouseCursor_.hand)
            if pressed:
                chosen = vec3(axis)
    return chosen


def _within(point: NDArray[np.float64], corners: NDArray[np.float64]) -> bool:
    """Whether a point (2,) is inside a convex polygon (N, 2) of either orientation."""
    edges = np.roll(corners, -1, 0) - corners
    to = point - corners
    sides = edges[:, 0] * to[:, 1] - edges[:, 1] * to[:, 0]
    return bool((sides >= 0).all() or (sides <= 0).all())
