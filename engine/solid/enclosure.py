"""Which cells of a grid a shell encloses, where the shell may have holes.

Three rules, each for the cases that the one before leaves open:

1. Flood. Cells that no path reaches from outside without crossing a wall are inside, whatever they hold.
2. Rays. A ball too big for a hole finds the hollow behind it. The hollow is inside if rays from its cells hit walls
   along at least five of the six axes (the paper's rule), mostly an odd number of sheets: the hollow of a cup, whose
   wall has an outer and an inner sheet, has two on every side.
3. Caps. A hole is closed by the surface from which the shell fills half of the sky; for a plane rim, a flat disc.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft, ndimage

from engine.solid.distance_transform import within
from engine.threads import for_spans

__all__ = ["enclosed_cells", "flood"]

Mask = NDArray[np.bool_]

MIN_BALL = 1.5
WIDE_BALL = 12.0
MAX_BALL = 0.55
"""Radii of the balls that close holes; each is twice the one before. The first two are in cells, the last is a share of
the longest side: such a ball fits through no hole, not even the missing bottom of a cake."""

SUBSTANTIAL = 0.1
"""Share of the cells that the largest ball cannot reach. If narrow balls find this many inside, wide ones would only
find gaps between leaves. What a wide ball finds does not count: in a bowl it is the bottom, and a wider ball has to
find the rest."""

MIN_POCKET = 1000
"""Cells. Smallest hollow that a wide ball may close; for a narrow ball it is half of the cube around the ball."""

AXES_HIT = 5
"""Least number of the six axes along which rays hit a wall: one ray may leave through the hole."""

LOCAL_AXES_HIT = 3
"""The same for a single cell of a hollow: just under a hole that faces a diagonal, three rays leave through it."""

ODD_SHARE = 0.4
"""Share of the axes with an odd count from which a hollow is inside. A single sheet gives 1, a wall of two sheets 0;
debris in the hollow pulls both towards 1/2."""

MAX_OPEN_SMALL = 0.19
MAX_OPEN = 0.25
MAX_OPEN_WIDE = 0.45
"""Largest share of a hollow's faces that may be open: for pockets below MIN_POCKET, for larger ones, and for those of
wide balls. A leak opens little. A groove in the skin, where rays graze the walls and miscount, opens at least 0.2, even
if it is dovetailed. Half a sphere has 1/3, a dish 1/2."""


def flood(wall: Mask) -> Mask:
    """(X, Y, Z). Cells that a path of face neighbours joins to the outside of the grid without entering the wall."""
    regions, _ = ndimage.label(np.pad(~wall, 1, constant_values=True))
    return (regions == regions[0, 0, 0])[1:-1, 1:-1, 1:-1]


def enclosed_cells(wall: Mask) -> tuple[Mask, float]:
    """Cells (X, Y, Z) that are not outside, walls included, and the area of the caps in cell faces."""
    inside = ~flood(wall)
    hollow = np.zeros_like(wall)
    largest = MAX_BALL * max(wall.shape)
    substantial = SUBSTANTIAL * np.count_nonzero(~_swept_by_ball(wall, largest))
    narrow = 0  # cells that narrow balls find inside
    radius = MIN_BALL
    while radius < 2 * largest:
        radius = min(radius, largest)
        if radius >= WIDE_BALL and narrow > substantial:
            break
        hollow |= _hollows(~_swept_by_ball(wall, radius) & ~inside, wall, inside, radius)
        inside |= hollow
        if radius < WIDE_BALL:
            narrow = int(np.count_nonzero(inside & ~wall))
        radius *= 2
    if not hollow.any():
        return inside, 0.0
    return _close_holes(wall, inside, hollow)


def _swept_by_ball(wall: Mask, radius: float) -> Mask:
    """(X, Y, Z). Cells that a ball of this radius (cells) covers when it rolls in from outside, around the wall."""
    # A large ball rolls on coarser cells: it only has to find the hollow, whose border is drawn later.
    coarse = 1 if radius < WIDE_BALL else 2 if radius < 2.5 * WIDE_BALL else 4
    margin = int(np.ceil(radius)) + 2
    ends = [(margin, margin + -(n + 2 * margin) % coarse) for n in wall.shape]
    blocks = np.pad(wall, ends)
    shape = [k for n in blocks.shape for k in (n // coarse, coarse)]
    close = within(np.asarray(blocks.reshape(shape).any((1, 3, 5))), radius / coarse)
    covered = within(flood(close), radius / coarse)
    for axis in range(3):
        covered = covered.repeat(coarse, axis)
    covered = covered[tuple(slice(margin, margin + n) for n in wall.shape)]
    if coarse > 1:  # a coarse wall is thicker than the real one
        covered = ndimage.binary_dilation(covered, iterations=coarse + 1, mask=~wall)
    return covered


def _hollows(unreached: Mask, wall: Mask, inside: Mask, radius: float) -> Mask:
    """(X, Y, Z). The cells of those unreached pockets that count as inside by their rays."""
    pockets, count = ndimage.label(unreached)
    sizes = np.bincount(pockets.ravel(), minlength=count + 1)
    good = sizes >= min(0.5 * (2 * radius) ** 3, MIN_POCKET)
    good[0] = False
    if not good.any():
        return np.zeros_like(wall)
    hits, odd = _count_sheets(wall, inside & ~wall)
    votes = np.bincount(pockets.ravel(), (hits >= AXES_HIT).ravel(), count + 1) / np.maximum(sizes, 1)
    shares = np.bincount(pockets.ravel(), (odd / np.maximum(hits, 1)).ravel(), count + 1) / np.maximum(sizes, 1)
    open_shares = _open_shares(pockets, count, wall | inside)
    most = MAX_OPEN_WIDE if radius >= WIDE_BALL else np.where(sizes < MIN_POCKET, MAX_OPEN_SMALL, MAX_OPEN)
    good &= (votes >= 0.5) & (shares >= ODD_SHARE) & (open_shares <= most)
    chosen = good[pockets]
    if not good.any():
        return chosen
    # A pocket may include open cells outside the hole; the rays of each cell tell these apart.
    free = ndimage.uniform_filter((~wall).astype(np.float32), 5)
    local = ndimage.uniform_filter(((hits >= LOCAL_AXES_HIT) & ~wall).astype(np.float32), 5)
    chosen &= local >= 0.5 * free
    # The ball bulges into a wide hole by at most its radius, sqrt(3) times as many faces along a diagonal: cells there
    # that are inside by the paper's rule join the hollow again.
    joining = (hits >= AXES_HIT) & (odd >= AXES_HIT) & ~inside
    return ndimage.binary_dilation(chosen, iterations=int(np.ceil(3**0.5 * radius)), mask=chosen | joining)


def _open_shares(pockets: NDArray[np.int32], count: int, closed: Mask) -> NDArray[np.float64]:
    """(count + 1,). Share of each pocket's faces that is open. Range [0, 1]."""
    faces, open_faces = np.zeros(count + 1), np.zeros(count + 1)
    for axis in range(3):
        a, b = _face_sides(axis)
        for side, other in ((a, b), (b, a)):
            edge = (pockets[side] > 0) & (pockets[other] != pockets[side])
            labels = pockets[side][edge]
            faces += np.bincount(labels, minlength=len(faces))
            open_faces += np.bincount(labels, ~closed[other][edge], minlength=len(faces))
    return open_faces / np.maximum(faces, 1)


def _count_sheets(wall: Mask, solid: Mask) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """(X, Y, Z) twice. Number of the six axes along which a cell sees a wall, and along which an odd number of sheets.

    A run of wall cells is one sheet, or two if there is solid between its sides.
    """
    material = wall.astype(np.int8) + 2 * (solid & ~wall).astype(np.int8)
    hits, odd = np.zeros(wall.shape, np.int8), np.zeros(wall.shape, np.int8)
    for axis in range(3):
        lines = np.ascontiguousarray(np.moveaxis(material, axis, 2))
        for step in (1, -1):
            sheets = np.empty(lines.shape, np.int16)
            for_spans(_sheets_along, len(lines), np.ascontiguousarray(lines[:, :, ::step]), sheets, span=1)
            sheets = np.moveaxis(sheets[:, :, ::step], 2, axis)
            hits += sheets > 0
            odd += sheets % 2 == 1
    return hits, odd


@njit(cache=True, nogil=True)
def _sheets_along(
    start: int,
    stop: int,
    lines: NDArray[np.int8],  # [X, Y, Z] 0 for empty, 1 for wall, 2 for solid
    passed: NDArray[np.int16],  # [X, Y, Z], filled
) -> None:
    """Sheets passed so far along the last axis."""
    for i in range(start, stop):
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


def _close_holes(wall: Mask, inside: Mask, hollow: Mask) -> tuple[Mask, float]:
    """The inside with caps in place of the rough openings of the hollows, and the number of cap faces.

    The winding number u of the shell solves the Poisson equation Laplace u = div(s), where s is the jump of the inside
    across faces on the wall, and 0 across the openings. u is 0 outside, 1 behind the shell and 1/2 on a flat hole.
    """
    near = ndimage.binary_dilation(wall)
    level = inside.astype(np.float32)
    for _ in range(2):  # the faces of the rim settle in the second pass
        source = np.zeros(inside.shape, np.float32)
        for axis in range(3):
            a, b = _face_sides(axis)
            jump = (level[b] - level[a]) * (near[a] | near[b])
            source[a] += jump
            source[b] -= jump
        winding = _solve_poisson(source)
        level = np.where(hollow | ~inside, winding >= 0.5, True).astype(np.float32)
    capped = level > 0.5
    cap_faces = 0.0
    for axis in range(3):
        a, b = _face_sides(axis)
        cap_faces += float(np.count_nonzero((capped[a] != capped[b]) & ~(near[a] | near[b])))
    return capped, cap_faces


def _face_sides(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Indices of the cells on the low and on the high side of all faces across an axis."""
    low = tuple(slice(None, -1) if i == axis else slice(None) for i in range(3))
    high = tuple(slice(1, None) if i == axis else slice(None) for i in range(3))
    return low, high


def _solve_poisson(source: NDArray[np.float32]) -> NDArray[np.float32]:
    """Solves (seven-point Laplace u) = source for u, with u = 0 far outside the grid, by sine transforms.

    Solved on cells of twice the size with a wide margin: a border nearby would pull u down in wide holes.
    """
    sizes = [fft.next_fast_len(2 * (n // 2 + max(source.shape) // 2 + 1)) // 2 - 1 for n in source.shape]
    linear = []
    for n, m in zip(source.shape, sizes, strict=True):
        at = (m - n // 2) // 2 + (np.arange(n) - 0.5) / 2  # the fine centres among the coarse ones
        low = np.floor(at).astype(int)
        weights = np.zeros((n, m), np.float32)
        weights[np.arange(n), low], weights[np.arange(n), low + 1] = low + 1 - at, at - low
        linear.append(weights)
    # The transpose of the interpolation moves sources onto coarse cells and keeps their sums and moments: a jump off by
    # half a cell would fill another part of the sky. On cells twice as large the second difference is four times as
    # large, and the mean is an eighth of the sum: together the factor 1/2.
    coarse = _apply_along_axes(source, [w.T for w in linear]) / 2
    waves = [
        (2 * np.cos(np.pi * np.arange(1, m + 1) / (m + 1)) - 2).reshape([m if i == axis else 1 for i in range(3)])
        for axis, m in enumerate(sizes)
    ]
    spectrum = fft.dstn(coarse, type=1, workers=-1) / (waves[0] + waves[1] + waves[2]).astype(np.float32)
    return _apply_along_axes(fft.idstn(spectrum, type=1, workers=-1), linear)


def _apply_along_axes(grid: NDArray[np.float32], matrices: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """One matrix applied along each axis of a grid."""
    for axis, matrix in enumerate(matrices):
        grid = np.moveaxis(np.tensordot(matrix, grid, (1, axis)), 0, axis)
    return np.ascontiguousarray(grid)
