"""Edits of a face's outline: dragging its points, and a brush that adds and takes away."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from training.faces.edges import largest_component
from training.faces.marks import Place
from training.faces.polygon import mask_polygon, polygon_mask

__all__ = ["BrushStroke", "Outline", "drag_point", "nearest_point", "refine"]

Outline = tuple[Place, ...]

SOFT = 0.05
"""How far along the outline, on either side of a dragged point, others follow it; a part of the outline's length."""

MOST_REFINED = 500
"""An outline with more points is not refined: they are close enough together wherever it was dragged."""

MOST_AWAY = 0.9
"""A dragged point's neighbours follow it by less than this part of its way, so that it leads."""


def refine(outline: Outline, aspect: float) -> Outline:
    """The outline with more points on its long sides, so that those near a dragged one can follow it in a curve.

    `aspect`: width of the picture over its height.
    """
    if len(outline) > MOST_REFINED:
        return outline
    points = np.array(outline)
    sides = np.roll(points, -1, axis=0) - points
    steps = np.hypot(*(sides * (aspect, 1)).T)
    parts = np.maximum(np.ceil(steps / max(SOFT / 6 * float(steps.sum()), 1e-9) - 1e-6).astype(int), 1)
    finer = [point + np.arange(n)[:, None] / n * side for point, side, n in zip(points, sides, parts, strict=True)]
    return tuple((float(x), float(y)) for x, y in np.concatenate(finer))


def drag_point(outline: Outline, index: int, to: Place, aspect: float, soft: bool = True) -> Outline:
    """The outline with one point moved to a place; others near it along the outline follow less the farther they are.

    `aspect`: width of the picture over its height. `soft`: False moves the one point alone.
    """
    points = np.array(outline)
    steps = np.hypot(*((np.roll(points, -1, axis=0) - points) * (aspect, 1)).T)
    along = np.concatenate([[0], np.cumsum(steps)])
    length = float(along[-1])
    away = np.abs(along[:-1] - along[index])
    away = np.minimum(away, length - away) / max(SOFT * length, 1e-9)
    part = np.where(away < 1, MOST_AWAY * (0.5 + 0.5 * np.cos(np.pi * np.minimum(away, 1))), 0) * soft
    part[index] = 1
    moved = np.clip(points + part[:, None] * (np.array(to) - points[index]), 0, 1)
    return tuple((float(x), float(y)) for x, y in moved)


def nearest_point(outline: Outline, at: Place, aspect: float) -> tuple[int, float]:
    """Index of the outline's point nearest to a place, and its distance in heights of the picture."""
    away = np.hypot(*((np.array(outline) - at) * (aspect, 1)).T)
    index = int(away.argmin())
    return index, float(away[index])


class BrushStroke:
    """A stroke of the brush over a face, from the press of the button until its release."""

    def __init__(self, outline: Outline | None, size: tuple[int, int], radius: float, add: bool) -> None:
        """`size`: width and height of the picture in pixels. `radius`: that of the brush, in heights of the picture."""
        self.before = outline
        width, height = size
        self.radius, self.add = radius * height, add
        empty = np.zeros((height, width), bool)
        self.mask: NDArray[np.bool_] = empty if outline is None else polygon_mask(outline, height, width)
        self.last: Place | None = None

    def move(self, to: Place) -> None:
        """Paints from where the brush was to a place."""
        height, width = self.mask.shape
        x1, y1 = to[0] * width, to[1] * height
        x0, y0 = (x1, y1) if self.last is None else (self.last[0] * width, self.last[1] * height)
        self.last = to
        reach = math.ceil(self.radius) + 1
        low_x, high_x = max(int(min(x0, x1)) - reach, 0), min(int(max(x0, x1)) + reach + 1, width)
        low_y, high_y = max(int(min(y0, y1)) - reach, 0), min(int(max(y0, y1)) + reach + 1, height)
        if low_x >= high_x or low_y >= high_y:
            return
        y, x = np.mgrid[low_y:high_y, low_x:high_x] + 0.5
        run = np.array([x1 - x0, y1 - y0])
        part = np.clip(((x - x0) * run[0] + (y - y0) * run[1]) / max(float(run @ run), 1e-9), 0, 1)
        painted = np.hypot(x - x0 - part * run[0], y - y0 - part * run[1]) <= self.radius
        self.mask[low_y:high_y, low_x:high_x][painted] = self.add

    @property
    def outline(self) -> Outline | None:
        """Outline of the painted face: of its largest part, without holes; as before the stroke if nothing is left."""
        return mask_polygon(largest_component(self.mask)) or self.before
