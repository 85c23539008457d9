"""Which cells of a grid a shell encloses, where the shell may have holes.

Three rules, each for what the one before cannot decide (DESIGN, section 4, item 3):

1. Flood. What cannot be reached from outside without crossing a wall is inside, whatever else is in there.
2. Rays. A hollow that is only open through a hole is found by a ball that is too big for the hole. It is inside if its
   cells meet walls along at least five of the six axes (the paper's rule), mostly an odd number of sheets:
   the hollow of a cup, whose wall has an outer and an inner sheet, counts two on every side.
3. Caps. A hole is closed where the shell around it fills half of the sky. For a plane rim that is the flat disc.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import fft, ndimage

from engine.solid.distance_transform import nearest

__all__ = ["enclosed", "flood"]

Mask = NDArray[np.bool_]

SMALLEST_BALL = 1.5
WIDE_BALL = 12.0
LARGEST_BALL = 0.55
"""Radii of the balls that close holes, doubling: the first and the wide ones in cells, the last as a share of the
longest side. It cannot fall into any hole: a cake without a bottom is as open as can be."""

SUBSTANTIAL = 0.1
"""Of what the largest ball cannot reach. Once so much is inside, wide balls would only find room between leaves."""

LEAST_POCKET = 1000
"""Cells. Smallest hollow that a wide ball may close; for narrow ones it is half of the ball's own cube."""

AXES_HIT = 5
"""Of the six axes: one may leave through the hole."""

LOCAL_AXES_HIT = 3
"""At a single cell of a hollow: just under a hole that faces a diagonal, three axes leave through it."""

ODD_SHARE = 0.4
"""Share of the axes with an odd count from which a hollow counts as inside. A single sheet gives 1, a wall of two
sheets 0, and debris in the hollow pulls either towards 1/2."""

SMALL_MOUTH = 0.19
MOUTH = 0.25
WIDE_MOUTH = 0.45
"""Of a hollow's border: the most that may be opening, for pockets under LEAST_POCKET, others, and those of wide balls.
A leak opens little; a groove of the skin, where rays graze the walls and count badly, opens 0.2 (if it is dovetailed)
or more. Half a sphere has 1/3, a dish 1/2."""


def flood(wall: Mask) -> Mask:
    """Cells that a path of face neighbours joins to the outside of the grid without entering the wall."""
    regions, _ = ndimage.label(np.pad(~wall, 1, constant_values=True))
    return (regions == regions[0, 0, 0])[1:-1, 1:-1, 1:-1]


def enclosed(wall: Mask) -> tuple[Mask, float]:
    """Cells (X, Y, Z) that are not outside, the walls included, and the area of the caps in cell faces."""
    inside = ~flood(wall)
    hollow = np.zeros_like(wall)
    largest = LARGEST_BALL * max(wall.shape)
    substantial = SUBSTANTIAL * np.count_nonzero(~_reached(wall, largest))
    radius = SMALLEST_BALL
    while radius < 2 * largest:
        radius = min(radius, largest)
        if radius >= WIDE_BALL and np.count_nonzero(inside & ~wall) > substantial:
            break
        hollow |= _hollows(~_reached(wall, radius) & ~inside, wall, inside, radius)
        inside |= hollow
        radius *= 2
    if not hollow.any():
        return inside, 0.0
    return _capped(wall, inside, hollow)


def _reached(wall: Mask, radius: float) -> Mask:
    """Cells that a ball of this radius (cells), coming from outside, covers somewhere on its way around the wall."""
    # A large ball rolls on coarser cells: it finds the hollow, whose border is drawn later.
    coarse = 1 if radius < WIDE_BALL else 2 if radius < 2.5 * WIDE_BALL else 4
    margin = int(np.ceil(radius)) + 2
    ends = [(margin, margin + -(n + 2 * margin) % coarse) for n in wall.shape]
    blocks = np.pad(wall, ends)
    shape = [k for n in blocks.shape for k in (n // coarse, coarse)]
    clearance, _ = nearest(np.asarray(blocks.reshape(shape).any((1, 3, 5))))
    covered = nearest(flood(clearance <= radius / coarse))[0] <= radius / coarse
    for axis in range(3):
        covered = covered.repeat(coarse, axis)
    covered = covered[tuple(slice(margin, margin + n) for n in wall.shape)]
    if coarse > 1:  # a coarse wall is thicker than the true one
        covered = ndimage.binary_dilation(covered, iterations=coarse + 1, mask=~wall)
    return covered


def _hollows(unreached: Mask, wall: Mask, inside: Mask, radius: float) -> Mask:
    """The cells of those pockets, among the ones that the ball did not reach, that the rays hold to be inside."""
    pockets, count = ndimage.label(unreached)
    sizes = np.bincount(pockets.ravel(), minlength=count + 1)
    good = sizes >= min(0.5 * (2 * radius) ** 3, LEAST_POCKET)
    good[0] = False
    if not good.any():
        return np.zeros_like(wall)
    hits, odd = _rays(wall, inside & ~wall)
    votes = np.bincount(pockets.ravel(), (hits >= AXES_HIT).ravel(), count + 1) / np.maximum(sizes, 1)
    shares = np.bincount(pockets.ravel(), (odd / np.maximum(hits, 1)).ravel(), count + 1) / np.maximum(sizes, 1)
    mouths = _mouths(pockets, count, wall | inside)
    widest = WIDE_MOUTH if radius >= WIDE_BALL else np.where(sizes < LEAST_POCKET, SMALL_MOUTH, MOUTH)
    good &= (votes >= 0.5) & (shares >= ODD_SHARE) & (mouths <= widest)
    chosen = good[pockets]
    if not good.any():
        return chosen
    # Open places beside the hole may hang on the same pocket: their own rays cut them off.
    free = ndimage.uniform_filter((~wall).astype(np.float32), 5)
    local = ndimage.uniform_filter(((hits >= LOCAL_AXES_HIT) & ~wall).astype(np.float32), 5)
    chosen &= local >= 0.5 * free
    # The ball bulges into a wide hole: what the paper's rule says of the cells there joins the hollow again.
    joining = (hits >= AXES_HIT) & (odd >= AXES_HIT) & ~inside
    return ndimage.binary_propagation(chosen, mask=chosen | joining)


def _mouths(pockets: NDArray[np.int32], count: int, closed: Mask) -> NDArray[np.float64]:
    """(count + 1,). The open share of the faces of each pocket."""
    faces, mouths = np.zeros(count + 1), np.zeros(count + 1)
    for axis in range(3):
        a, b = _faces(axis)
        for own, other in ((a, b), (b, a)):
            edge = (pockets[own] > 0) & (pockets[other] != pockets[own])
            labels = pockets[own][edge]
            faces += np.bincount(labels, minlength=len(faces))
            mouths += np.bincount(labels, ~closed[other][edge], minlength=len(faces))
    return mouths / np.maximum(faces, 1)


def _rays(wall: Mask, solid: Mask) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Per cell: along how many of the six axes there is a wall, and along how many an odd number of sheets.

    A run of wall cells is one sheet; two if there is solid between its sides.
    """
    material = wall.astype(np.int8) + 2 * (solid & ~wall).astype(np.int8)
    hits, odd = np.zeros(wall.shape, np.int8), np.zeros(wall.shape, np.int8)
    for axis in range(3):
        lines = np.ascontiguousarray(np.moveaxis(material, axis, 2))
        for way in (1, -1):
            sheets = _sheets(lines[:, :, ::way])
            sheets = np.moveaxis(sheets[:, :, ::way], 2, axis)
            hits += sheets > 0
            odd += sheets % 2 == 1
    return hits, odd


@njit(cache=True, parallel=True)
def _sheets(lines: NDArray[np.int8]) -> NDArray[np.int16]:
    """(X, Y, Z). Sheets passed on the way along the last axis; lines hold 0 for empty, 1 for wall, 2 for solid."""
    passed = np.zeros(lines.shape, np.int16)
    for i in prange(lines.shape[0]):
        for j in range(lines.shape[1]):
            count, run = 0, 0
            for k in range(lines.shape[2]):
                kind = lines[i, j, k]
                if kind > run:
                    count += 1 if run or kind == 1 else 2
                    run = kind
                elif kind == 0:
                    run = 0
                passed[i, j, k] = count
    return passed


def _capped(wall: Mask, inside: Mask, hollow: Mask) -> tuple[Mask, float]:
    """Replaces the rough openings of the hollows by caps, and counts their faces.

    The winding number of the shell solves Laplace u = div(s), s the jump of the inside across faces that lie on the
    wall, and 0 across the openings. Outside u is 0, behind the shell 1, and on a flat hole it passes 1/2.
    """
    near = ndimage.binary_dilation(wall)
    level = inside.astype(np.float32)
    for _ in range(2):  # the rim's own faces settle in the second
        source = np.zeros(inside.shape, np.float32)
        for axis in range(3):
            a, b = _faces(axis)
            jump = (level[b] - level[a]) * (near[a] | near[b])
            source[a] += jump
            source[b] -= jump
        winding = _laplace(source)
        level = np.where(hollow | ~inside, winding >= 0.5, True).astype(np.float32)
    capped = level > 0.5
    outside_faces = 0.0
    for axis in range(3):
        a, b = _faces(axis)
        outside_faces += float(np.count_nonzero((capped[a] != capped[b]) & ~(near[a] | near[b])))
    return capped, outside_faces


def _faces(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Index of the cells on the low and on the high side of all faces across an axis."""
    low = tuple(slice(None, -1) if i == axis else slice(None) for i in range(3))
    high = tuple(slice(1, None) if i == axis else slice(None) for i in range(3))
    return low, high


def _laplace(source: NDArray[np.float32]) -> NDArray[np.float32]:
    """u with (seven-point Laplace u) = source, u = 0 far outside of the grid; by sine transforms.

    Solved on cells of twice the size, with room around: a border nearby would pull u down in wide holes.
    """
    sizes = [fft.next_fast_len(2 * (n // 2 + max(source.shape) // 2 + 1)) // 2 - 1 for n in source.shape]
    linear = []
    for n, m in zip(source.shape, sizes, strict=True):
        at = (m - n // 2) // 2 + (np.arange(n) - 0.5) / 2  # the fine centres among the coarse ones
        low = np.floor(at).astype(int)
        weights = np.zeros((n, m), np.float32)
        weights[np.arange(n), low], weights[np.arange(n), low + 1] = low + 1 - at, at - low
        linear.append(weights)
    # The transpose of the interpolation moves sources onto coarse cells and keeps their sums and moments: half a cell
    # of error in a jump's place would be an error in the sky that it fills. Twice the edge makes the second difference
    # four times as large, of a mean that is an eighth of the sum.
    coarse = _along_axes(source, [w.T for w in linear]) / 2
    waves = [
        (2 * np.cos(np.pi * np.arange(1, m + 1) / (m + 1)) - 2).reshape([m if i == axis else 1 for i in range(3)])
        for axis, m in enumerate(sizes)
    ]
    spectrum = fft.dstn(coarse, type=1, workers=-1) / (waves[0] + waves[1] + waves[2]).astype(np.float32)
    return _along_axes(fft.idstn(spectrum, type=1, workers=-1), linear)


def _along_axes(grid: NDArray[np.float32], matrices: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """One matrix applied along each axis of a grid."""
    for axis, matrix in enumerate(matrices):
        grid = np.moveaxis(np.tensordot(matrix, grid, (1, axis)), 0, axis)
    return np.ascontiguousarray(grid)
