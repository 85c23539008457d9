"""Annotations that ImGui draws over the viewport: labels, and brackets around selected pieces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.marking import Marker, Point
from app.ui.theme import palette, px, u32

__all__ = ["brackets", "label", "marker_outline"]


def label(draw: imgui.ImDrawList, at: ImVec2, text: str) -> None:
    """Draws text on a background that keeps it readable, moved inside the clip rectangle."""
    size = imgui.calc_text_size(text)
    low, high = draw.get_clip_rect_min(), draw.get_clip_rect_max()
    at = ImVec2(
        max(low.x + px(10), min(at.x, high.x - size.x - px(14))), max(low.y, min(at.y, high.y - size.y - px(10)))
    )
    low = ImVec2(at.x - px(7), at.y - px(4))
    draw.add_rect_filled(low, ImVec2(at.x + size.x + px(7), at.y + size.y + px(4)), u32(palette().ground, 0.8), px(5))
    draw.add_text(at, u32(palette().text), text)


def brackets(draw: imgui.ImDrawList, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    """Draws the four corners of a rectangle, given by its low and high corner (2,)."""
    colour, length = u32(palette().accent), px(12)
    for x, dx in ((low[0], 1), (high[0], -1)):
        for y, dy in ((low[1], 1), (high[1], -1)):
            corner = ImVec2(float(x), float(y))
            draw.add_line(corner, ImVec2(float(x) + dx * length, float(y)), colour, px(1.8))
            draw.add_line(corner, ImVec2(float(x), float(y) + dy * length), colour, px(1.8))


def marker_outline(draw: imgui.ImDrawList, marker: Marker, path: Sequence[Point], origin: ImVec2) -> None:
    """Draws the selection of a drag along `path`, relative to `origin`: a box, a circle around its start or a lasso."""
    points = [ImVec2(x + origin.x, y + origin.y) for x, y in path]
    start, end = points[0], points[-1]
    for colour, width in ((u32("#000000", 0.35), px(4)), (u32(palette().accent), px(1.8))):
        if marker == "box":
            low, high = (
                ImVec2(min(start.x, end.x), min(start.y, end.y)),
                ImVec2(max(start.x, end.x), max(start.y, end.y)),
            )
            draw.add_rect(low, high, colour, 0.0, width)
        elif marker == "sphere":
            draw.add_circle(start, float(np.hypot(end.x - start.x, end.y - start.y)), colour, 0, width)
        else:
            for a, b in zip(points, [*points[1:], start], strict=True):
                draw.add_line(a, b, colour, width)
