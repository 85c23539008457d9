"""A round face that the picture's border cuts off, completed: its outline by an ellipse, its inside by its own other
side."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["MIN_SEEN", "NEAR_BORDER", "Oval", "complete_face", "find_oval"]

MIN_SEEN = 0.75
"""Of a face, the least that the picture shows for the rest to be completed: three quarters of a disc end where it is
nine tenths as wide as it is at most. Where it does not narrow, nothing says where it ends."""

MAX_CHORD = 0.25
"""Of a face's width, how much of one side of the picture it may lie on and lack nothing that anybody sees: 1.6 % of the
width of a round face."""

FIT = 0.03
"""Of the mean radius, the root mean square by which the hull of an outline may differ from its ellipse. Whole apples,
oranges and melons of 20 photographs differ by 0.4 to 3.2 %, pomegranates by 1.4 to 7.6, slices by 6 and more."""

NEAR_BORDER = 4
"""Pixels from the border from which on an outline is the picture's, not the face's: the search leaves the outermost two
pixels to the background, and rounds corners."""

EATEN = 0.06
"""Of a face's width, how deep beside the border the search may take the face for background, whose colours it learns
from the border."""


@dataclass(frozen=True)
class Oval:
    """The ellipse of a face that the picture's border cuts off."""

    centre: NDArray[np.float64]
    """(2,). (x, y) in pixels."""
    axes: NDArray[np.float64]
    """(2, 2). Half axes as rows, pixels."""

    def contains(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which places in pixels lie in it; any shape."""
        away = np.stack([x, y], -1) - self.centre
        return np.square(away @ (self.axes / np.square(self.axes).sum(1, keepdims=True)).T).sum(-1) <= 1


def find_oval(mask: NDArray[np.bool_]) -> Oval | None:
    """The ellipse of a face (H, W) that one side of the picture cuts off; None if none does, if several do, if the face
    is not round, or if less than MIN_SEEN of it is seen.

    Of faces that two sides cut off, the search often takes the rim for background: they came out too small.
    """
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return None
    height, width = mask.shape
    across = max(np.ptp(rows), np.ptp(columns)) + 1
    low, high = NEAR_BORDER - 1, -NEAR_BORDER
    touched = [int(side.sum()) for side in (mask[low], mask[high], mask[:, low], mask[:, high])]
    if max(touched) <= MAX_CHORD * across or sorted(touched)[-2] > max(NEAR_BORDER, MAX_CHORD / 4 * across):
        return None
    hull = cv2.convexHull(np.stack([columns, rows], -1).astype(np.int32))  # without dents that the search ate
    drawn = cv2.fillConvexPoly(np.zeros(mask.shape, np.uint8), hull, 1)
    outlines, _ = cv2.findContours(drawn, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = max(outlines, key=len)[:, 0]
    own = points[((points >= NEAR_BORDER) & (points < np.array([width, height]) - NEAR_BORDER)).all(1)]
    if len(own) < 20:  # an ellipse has five unknowns
        return None
    (x, y), diameters, angle = cv2.fitEllipseDirect(own.astype(np.float32))
    if not np.isfinite([x, y, *diameters, angle]).all() or min(diameters) < 1:
        return None
    turn = np.radians(angle)
    directions = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    oval = Oval(np.array([x, y]) + 0.5, directions * np.array(diameters)[:, None] / 2)
    reach = np.hypot(*((own - [x, y]) @ directions.T / diameters * 2).T)
    if np.sqrt(np.square(reach - 1).mean()) > FIT or drawn.sum() < MIN_SEEN * np.pi * np.prod(diameters) / 4:
        return None
    return oval


def complete_face(
    rgb: NDArray[np.float32], mask: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_], tuple[int, int]]:
    """The picture (H, W, 3) and its face (H, W) with room for what the border cuts off of the face, which shows the
    mirror image of its other side; and the columns and rows that were added before the first. Unchanged, with (0, 0),
    where `find_oval` finds nothing."""
    oval = find_oval(mask)
    if oval is None:
        return rgb, mask, (0, 0)
    reach = np.hypot(*oval.axes)  # half the width and height of its box
    size = np.array(mask.shape[::-1])
    before = np.maximum(np.ceil(reach - oval.centre), 0).astype(int) + NEAR_BORDER
    after = np.maximum(np.ceil(oval.centre + reach - size), 0).astype(int) + NEAR_BORDER
    padding = ((before[1], after[1]), (before[0], after[0]))
    x, y = (a.astype(np.float64) + 0.5 for a in np.indices((size + before + after)[::-1])[::-1])
    x, y = x - before[0], y - before[1]
    outside = [(a < 0) | (a > n) for a, n in zip((x, y), size, strict=True)]
    deep = EATEN * 2 * reach.max()
    beside = (np.minimum(x, size[0] - x) < deep) | (np.minimum(y, size[1] - y) < deep)
    whole = np.pad(mask, padding) | (oval.contains(x, y) & beside)
    unseen = whole & (outside[0] | outside[1])
    inner = ndimage.binary_erosion(whole & ~unseen, iterations=2)
    nearest = ndimage.distance_transform_edt(~inner, return_distances=False, return_indices=True)
    # Out of the picture to the right, the face shows what is as far to the left of its middle.
    places = [np.where(out, 2 * c - a, a)[unseen] for out, c, a in zip(outside, oval.centre, (x, y), strict=True)]
    column, row = (
        np.clip((place + first).astype(int), 0, n - 1)
        for place, first, n in zip(places, before, whole.shape[::-1], strict=True)
    )
    filled = np.pad(rgb, (*padding, (0, 0)), mode="edge")
    filled[unseen] = filled[tuple(nearest[:, row, column])]
    return filled, whole, (int(before[0]), int(before[1]))
