"""A picture of a cut face taken apart into what behaves differently along the axis that it does not show.

Ground and its texture, structures that run through (membranes, layers, the rind), and details that end (seeds, pores).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.frames import Frame, Sheet
from training.priors.exemplar.patches import OVER, POLAR

__all__ = ["Detail", "Layers", "decompose", "rind_depth"]

WINDOW = 0.13
"""Half side of the median window that defines the ground, in inradii: wider than half of any seed or membrane."""

BROAD = 0.3
"""The same of a window that sees past an apple's carpels, which fill more than half of the other one."""

LEAST_CONTRAST = 0.08
"""Least colour distance from the ground that makes a detail or a structure and not texture."""

LONGEST_DETAIL = 0.2
"""Half length in inradii over which something is not a detail but a part of the layout."""

MOST_ELONGATED = 4.0


@dataclass(frozen=True)
class Detail:
    """Something that ends: a seed, a pore."""

    x: float
    """Centre in cells."""
    y: float
    half: tuple[float, float]
    """Half lengths along the picture's directions a and b there, in cells."""
    reach: float
    """Radius around the centre that holds all of it, in cells."""
    label: int
    """Its number in `Layers.labels`."""
    ground: NDArray[np.float32]
    """(3,). Colour of what it lies in."""
    pixel: int
    """The sheet's candidate pixel nearest to the centre."""


@dataclass(frozen=True)
class Layers:
    """A sheet in parts; pictures (H, W) with `OVER` pixels to a cell."""

    sheet: Sheet
    rind: float
    """Depth over the body's inradius at which the layers along the skin end."""
    ground: NDArray[np.float32]
    """(H, W, 3). Smooth."""
    texture: NDArray[np.float32]
    """(H, W, 3). What is left of the picture over the ground, with structures and details filled in."""
    structure: NDArray[np.float32]
    """(H, W). Opacity of what runs through."""
    through: NDArray[np.float32]
    """(H, W, 3). Its colours, carried on a little beyond its edges."""
    detail: NDArray[np.float32]
    """(H, W). Opacity of the details."""
    labels: NDArray[np.int32]
    """(H, W). Number of the detail a pixel belongs to, with a rim of two pixels; 0 for none."""
    details: list[Detail]
    thickness: float
    """Typical half thickness of long structures, cells."""
    spread: tuple[float, float, float]
    """Standard deviation of the texture, and of its slope along the directions a and b, per cell."""


def rind_depth(sheet: Sheet) -> float:
    """Depth, over the body's inradius, at which the layers along the skin end.

    From there on the median colour is that of the flesh, a third to a half of the inradius deep.
    """
    step = 0.02
    deep = sheet.rgb[(sheet.depth > 0.33) & (sheet.depth < 0.5)]
    flesh = np.median(deep, axis=0) if len(deep) else np.median(sheet.rgb[sheet.depth > 0], axis=0)
    for i in range(16, -1, -1):
        band = sheet.rgb[(sheet.depth > step * i) & (sheet.depth <= step * (i + 1))]
        if len(band) and np.linalg.norm(np.median(band, axis=0) - flesh) > 0.08:
            return step * (i + 1.5)
    return step


def decompose(sheet: Sheet, kind: Frame) -> Layers:
    """Takes a sheet apart. Details are compact and stand out; structures stand out and are long."""
    rind = rind_depth(sheet)
    core = sheet.depth > rind
    inradius = float(ndimage.distance_transform_edt(sheet.depth > 0).max())  # pixels
    picture = _mirrored(sheet.rgb, core)
    median = _wide_median(picture, WINDOW * inradius)
    contrast = np.linalg.norm(picture - median, axis=-1) * core
    high = max(LEAST_CONTRAST, 3.5 * float(np.median(contrast[core]))) if core.any() else 1.0
    swallowed = beside = np.zeros_like(core)
    if kind == POLAR:
        median, swallowed = _without_middling(picture, median, core, inradius, high)
        contrast = np.linalg.norm(picture - median, axis=-1) * core
    contrast = contrast.astype(np.float32)
    # A pixel is as opaque as its contrast to the ground is a share of the strongest one nearby; so a black seed and the
    # pale strand that it lies on come apart.
    peak = ndimage.maximum_filter(contrast, size=2 * max(2, round(0.03 * inradius)) + 1)
    opacity = _smoothstep(0.25, 0.65, contrast / np.maximum(peak, 0.5 * high))
    if swallowed.any():
        # Here all that differs from the ground is one thing, the seeds in it included.
        typical = max(high, float(np.median(contrast[swallowed])))
        beside = ndimage.binary_dilation(swallowed, iterations=round(WINDOW * inradius))
        opacity = np.where(beside, _smoothstep(0.25, 0.65, contrast / typical), opacity)
    parts, count = ndimage.label((contrast > 0.5 * high) & (opacity > 0.4))
    numbers = np.arange(count + 1)
    strong = ndimage.maximum(contrast, parts, numbers) > high
    strong[0] = False
    # At the edge of a wide thing the median itself turns: what stands out there is that edge, and runs through.
    turning = _turning(median, 0.06 * inradius)
    edges = strong & (ndimage.mean(turning, parts, numbers) > 0.4 * ndimage.mean(contrast, parts, numbers))
    compact, long = _classify(parts, count, strong & ~edges, inradius)
    if kind == POLAR:
        # What stands on the axis is the core and not a seed.
        middle = (round(sheet.middle[1] * OVER), round(sheet.middle[0] * OVER))
        reach = round(0.06 * inradius)
        box = parts[middle[0] - reach : middle[0] + reach + 1, middle[1] - reach : middle[1] + reach + 1]
        for held in (np.unique(box), np.unique(parts[swallowed])):
            edges[held] |= strong[held]
        compact &= ~edges
    runs = long | edges
    structure = opacity * ndimage.binary_dilation(runs[parts], iterations=1) if count else np.zeros_like(contrast)
    reach, owner = ndimage.distance_transform_edt(~compact[parts], return_indices=True)
    labels = np.where(reach <= 2.5, (parts * compact[parts])[owner[0], owner[1]], 0).astype(np.int32)
    detail = opacity * (labels > 0) * (structure < 0.5)
    rim = 1 - _smoothstep(0.85 * rind, rind, sheet.depth)
    structure = np.maximum(structure, rim).astype(np.float32)
    clean = core & (structure < 0.05) & ~ndimage.binary_dilation(labels > 0, iterations=1)
    clean &= ~ndimage.binary_dilation(strong[parts] | (contrast > high), iterations=2) & ~beside
    if not clean.any():
        clean = core if core.any() else sheet.depth > 0
    # The median keeps the edges of wide things where a mean would spread them; details and structures are not in it.
    ground = ndimage.gaussian_filter(median, (0.02 * inradius, 0.02 * inradius, 0))
    texture = _mirrored(picture - ground, clean)
    # Thin sheets are smoothed by half a voxel, or cuts along them would show the grid; their colours reach as far.
    solid = structure > 0.7
    nearest = ndimage.distance_transform_edt(~solid, return_distances=False, return_indices=True)
    thin = ndimage.gaussian_filter(structure, 0.6 * OVER)
    return Layers(
        sheet,
        rind,
        ground,
        texture,
        np.maximum(thin, structure * (1 - _smoothstep(rind, 1.2 * rind, sheet.depth))).astype(np.float32),
        sheet.rgb[nearest[0], nearest[1]] if solid.any() else sheet.rgb,
        detail.astype(np.float32),
        labels,
        _details(sheet, parts, compact, labels, ground),
        _thickness(long[parts]),
        _spread(sheet, picture - ground, clean),
    )


def _without_middling(
    picture: NDArray[np.float32], median: NDArray[np.float32], core: NDArray[np.bool_], inradius: float, high: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(H, W, 3), (H, W). The ground with the things of middling size taken out that it had swallowed, and where.

    Those are runs of the median that stand out from one over a wider window. Along the axis they run through.
    """
    broad = _wide_median(picture, BROAD * inradius)
    swallowed = (np.linalg.norm(median - broad, axis=-1) > high) & core
    near = ndimage.distance_transform_edt(~swallowed) / (WINDOW * inradius) if swallowed.any() else np.inf
    weight = 1 - _smoothstep(0.5, 1, np.broadcast_to(near, core.shape))[..., None]
    return (median + weight * (broad - median)).astype(np.float32), swallowed


def _wide_median(picture: NDArray[np.float32], half: float) -> NDArray[np.float32]:
    """The median over a square window, computed on a coarser picture where the window is large."""
    step = max(1, int(half / 7))
    small = picture[step // 2 :: step, step // 2 :: step]
    size = 2 * max(1, round(half / step)) + 1
    small = np.stack([ndimage.median_filter(small[..., c], size=size, mode="nearest") for c in range(3)], -1)
    at = [(np.arange(n) - step // 2) / step for n in picture.shape[:2]]
    grid = np.stack(np.meshgrid(*at, indexing="ij"))
    return np.stack(
        [ndimage.map_coordinates(small[..., c], grid, order=1, mode="nearest", output=np.float32) for c in range(3)], -1
    )


def _classify(
    parts: NDArray[np.int32], count: int, strong: NDArray[np.bool_], inradius: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(count + 1,), (count + 1,). Which parts are compact details, and which are long structures."""
    compact, long = np.zeros(count + 1, bool), np.zeros(count + 1, bool)
    for number, box in enumerate(ndimage.find_objects(parts), start=1):
        if not strong[number]:
            continue
        rows, columns = np.nonzero(parts[box] == number)
        area = len(rows)
        if area < 5:
            continue
        small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(np.stack([rows, columns]))), 0.05)) * 2
        filled = area / (np.pi * small * large)
        if large < LONGEST_DETAIL * inradius and large < MOST_ELONGATED * small and filled > 0.5:
            compact[number] = True
        elif large > 0.1 * inradius:
            long[number] = True
    return compact, long


def _details(
    sheet: Sheet,
    parts: NDArray[np.int32],
    compact: NDArray[np.bool_],
    labels: NDArray[np.int32],
    ground: NDArray[np.float32],
) -> list[Detail]:
    """The compact parts, measured along the picture's own directions."""
    found = []
    boxes = ndimage.find_objects(labels)
    for number in np.flatnonzero(compact):
        if number > len(boxes) or boxes[number - 1] is None:
            continue
        rows, columns = np.nonzero(parts == number)
        x, y = columns.mean() / OVER, rows.mean() / OVER
        pixel = int(((sheet.xy - [x, y]) ** 2).sum(1).argmin())
        offsets = np.stack([columns / OVER - x, rows / OVER - y], -1)
        a, b = sheet.ab[pixel, :2], sheet.ab[pixel, 2:]
        half = tuple(2 * float(np.sqrt(((offsets @ d) ** 2).mean() + 0.03)) for d in (a, b))
        reach = float(np.linalg.norm(offsets, axis=1).max()) + 2.5 / OVER
        under = ground[rows, columns].mean(0)
        found.append(Detail(float(x), float(y), (half[0], half[1]), reach, int(number), under, pixel))
    return found


def _turning(median: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """(H, W). How much a picture changes around each pixel: the standard deviation of its colours."""
    mean = ndimage.gaussian_filter(median, (sigma, sigma, 0))
    square = ndimage.gaussian_filter(median**2, (sigma, sigma, 0))
    return np.sqrt(np.maximum(square - mean**2, 0).sum(-1))


def _thickness(long: NDArray[np.bool_]) -> float:
    """Half thickness in cells of what is long: a ribbon's pixels lie a quarter of its width under its edge."""
    depth = ndimage.distance_transform_edt(long)[long]
    return float(np.clip(2 * depth.mean() / OVER, 0.5, 2.5)) if len(depth) else 1.0


def _mirrored(texture: NDArray[np.float32], clean: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Texture everywhere: an unclean pixel takes what lies as far on the other side of the nearest clean one."""
    row, column = ndimage.distance_transform_edt(~clean, return_distances=False, return_indices=True)
    here = np.indices(clean.shape)
    r = np.clip(2 * row - here[0], 0, clean.shape[0] - 1)
    c = np.clip(2 * column - here[1], 0, clean.shape[1] - 1)
    fine = clean[r, c]
    return texture[np.where(fine, r, row), np.where(fine, c, column)]


def _spread(sheet: Sheet, texture: NDArray[np.float32], clean: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Standard deviation of the clean texture and of its slopes along a and b, per cell."""
    inner = ndimage.binary_erosion(clean, iterations=2)
    grey = ndimage.gaussian_filter(texture.mean(-1), 0.5 * OVER)
    column, row = (sheet.xy * OVER + 0.5).astype(int).T
    keep = inner[row, column]
    if keep.sum() < 50:
        return 1e-3, 1e-3, 1e-3
    gy, gx = np.gradient(grey)
    slope = np.stack([gx[row, column], gy[row, column]], -1)[keep] * OVER
    a, b = sheet.ab[keep, :2], sheet.ab[keep, 2:]
    return (
        float(grey[row, column][keep].std()) + 1e-6,
        float((slope * a).sum(1).std()) + 1e-6,
        float((slope * b).sum(1).std()) + 1e-6,
    )


def _smoothstep(low: float, high: float, value: NDArray[np.floating]) -> NDArray[np.floating]:
    """0 under `low`, 1 over `high`."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
