"""The terms of the kernel field on a whole picture of a plane: atom by atom, as a splat on it, not point by point.

A point asks some fifty atoms to find the dozen that reach it; an atom knows which pixels it reaches.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["ROWS", "near_plane"]

ROWS = 16
"""Rows of the picture in a task."""

AIR = 1e-3
"""Pixels by which an atom's box is widened, against rounding."""


@njit(cache=True, nogil=True)
def near_plane(grid, corner, across, down, most, rows, boxes):
    """Finds the atoms of a level that reach a picture's plane: rows (n,) ascending and boxes (n, 4), x0 x1 y0 y1 of the
    pixels they may reach, first to one past last. Returns how many; pixel (x, y) is at corner + x across + y down."""
    xx = across[0] * across[0] + across[1] * across[1] + across[2] * across[2]
    xy = across[0] * down[0] + across[1] * down[1] + across[2] * down[2]
    yy = down[0] * down[0] + down[1] * down[1] + down[2] * down[2]
    det = xx * yy - xy * xy
    c0, c1, c2 = corner[0] - grid.origin[0], corner[1] - grid.origin[1], corner[2] - grid.origin[2]
    count = 0
    for i in range(len(grid.shapes)):
        x, y, z = grid.shapes[i, 0] - c0, grid.shapes[i, 1] - c1, grid.shapes[i, 2] - c2
        least = min(min(grid.shapes[i, 3], grid.shapes[i, 4]), min(grid.shapes[i, 5], most))
        reach = 3.0001 / np.float64(least)
        ax, ay = x * across[0] + y * across[1] + z * across[2], x * down[0] + y * down[1] + z * down[2]
        u, v = (yy * ax - xy * ay) / det, (xx * ay - xy * ax) / det
        left = reach * reach - (x * x + y * y + z * z - u * ax - v * ay)  # what the distance from the plane leaves
        if not left > 0.0:
            continue
        wide, high = math.sqrt(left * yy / det) + AIR, math.sqrt(left * xx / det) + AIR
        rows[count] = i
        boxes[count, 0] = math.ceil(min(max(u - wide, 0.0), 1e9))
        boxes[count, 1] = math.floor(min(max(u + wide, -1.0), 1e9)) + 1
        boxes[count, 2] = math.ceil(min(max(v - high, 0.0), 1e9))
        boxes[count, 3] = math.floor(min(max(v + high, -1.0), 1e9)) + 1
        count += boxes[count, 1] > boxes[count, 0] and boxes[count, 3] > boxes[count, 2]
    return count
