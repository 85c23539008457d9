"""Rectangles in one texture, and which point of a mesh each of their texels shows."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["packed", "rasterised"]

SIDES = tuple(2**n for n in range(6, 14))
"""Texels along a side of a texture: powers of two, which graphics cards reduce without a seam; 8192 is the largest that
game engines take everywhere."""


def packed(
    sizes: NDArray[np.integer],  # [C, 2]
    gap: int,
) -> tuple[NDArray[np.int64], tuple[int, int]] | None:
    """First column and row (C, 2) of rectangles of these widths and heights, packed in rows, the highest first, and the
    width and height of the smallest texture that holds them with a gap around each; None if the largest does not."""
    order = sorted(range(len(sizes)), key=lambda i: (-int(sizes[i][1]), i))
    best: tuple[NDArray[np.int64], tuple[int, int]] | None = None
    for width in SIDES:
        places, x, y, row = np.zeros((len(sizes), 2), np.int64), gap, gap, 0
        for i in order:
            wide, high = (int(side) for side in sizes[i])
            if x + wide + gap > width and row:
                x, y, row = gap, y + row + gap, 0
            places[i] = x, y
            x, row = x + wide + gap, max(row, high)
        used, height = int((places[:, 0] + sizes[:, 0]).max()) + gap, y + row + gap
        fitting = [side for side in SIDES if side >= height]
        if used > width or not fitting:
            continue
        if best is None or width * fitting[0] < best[1][0] * best[1][1]:
            best = places, (width, fitting[0])
    return best


def rasterised(
    texels: NDArray[np.floating],  # [V, 2] column and row; the centre of texel (i, j) is at (i + 0.5, j + 0.5)
    triangles: NDArray[np.integer],  # [T, 3]
    values: NDArray[np.floating],  # [V, K]
    width: int,
    height: int,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(H, W, K), (H, W). Values at the centres of the texels that triangles cover, and which these are."""
    out = np.zeros((height, width, values.shape[1]))
    covered = np.zeros((height, width), bool)
    _rasterise(
        np.ascontiguousarray(texels, np.float64),
        np.ascontiguousarray(triangles, np.int64),
        np.ascontiguousarray(values, np.float64),
        out,
        covered,
    )
    return out, covered


@njit(cache=True, nogil=True)
def _rasterise(
    texels: NDArray[np.float64],  # [V, 2]
    triangles: NDArray[np.int64],  # [T, 3]
    values: NDArray[np.float64],  # [V, K]
    out: NDArray[np.float64],  # in out [H, W, K]
    covered: NDArray[np.bool_],  # in out [H, W]
) -> None:
    height, width = covered.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay, bx, by = texels[a, 0], texels[a, 1], texels[b, 0], texels[b, 1]
        cx, cy = texels[c, 0], texels[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        left, right = max(int(min(ax, bx, cx) - 0.5), 0), min(int(max(ax, bx, cx) + 0.5), width - 1)
        top, bottom = max(int(min(ay, by, cy) - 0.5), 0), min(int(max(ay, by, cy) + 0.5), height - 1)
        for j in range(top, bottom + 1):
            for i in range(left, right + 1):
                x, y = i + 0.5, j + 0.5
                u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
                v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
                w = 1.0 - u - v
                if u >= -1e-9 and v >= -1e-9 and w >= -1e-9:
                    covered[j, i] = True
                    for k in range(values.shape[1]):
                        out[j, i, k] = u * values[a, k] + v * values[b, k] + w * values[c, k]
