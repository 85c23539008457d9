"""Decomposes a picture of a cut face into layers that continue differently along the axis it does not show.

The layers are a smooth ground, its texture, structures that run through (membranes, layers, the rind), and details
that end (seeds, pores).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.distance_transform import depth_in
from training.priors.exemplar.frames import Frame, ScaledPicture
from training.priors.exemplar.layering.closed import RUNS_THROUGH, closed_heights
from training.priors.exemplar.outline import UNDER
from training.priors.exemplar.patches import OVER, POLAR, RADIAL
from training.priors.exemplar.rind import rind_depth
from training.priors.exemplar.sampling import smoothstep

__all__ = ["Detail", "Layers", "decompose"]

WINDOW = 0.13
"""Half side of the median window that defines the ground, in inradii: it must be wider than half of any seed
or membrane."""

WIDE_WINDOW = 0.3
"""Half side of a second, wider window, for structures such as an apple's carpels that fill most of the first."""

MIN_CONTRAST = 0.08
"""Smallest RGB distance from the ground that counts as a detail or structure rather than texture."""

MAX_DETAIL_LENGTH = 0.2
"""Largest half length of a detail in inradii; longer parts are structures."""

MAX_ELONGATION = 4.0

LEAST_MEMBRANE = 0.3
"""Least surety at which a pixel of a membrane has the membrane's colour, without that of its surroundings."""


@dataclass(frozen=True)
class Detail:
    """A small part that ends along every axis: a seed, a pore."""

    x: float
    """Centre in cells."""
    y: float
    half: tuple[float, float]
    """Half lengths along the picture's directions a and b there, in cells."""
    reach: float
    """Radius in cells of a circle around the centre that contains the detail."""
    label: int
    """Its value in `Layers.labels`."""
    ground: NDArray[np.float32]
    """(3,). Colour of the ground around it."""
    pixel: int
    """Row in `ScaledPicture.xy` of the pixel nearest to the centre."""


@dataclass(frozen=True)
class Layers:
    """A decomposed picture; all arrays (H, W) have `OVER` pixels per cell."""

    source: ScaledPicture
    rind: float
    """Thickness of the layers along the skin, over the body's inradius."""
    ground: NDArray[np.float32]
    """(H, W, 3). The smooth ground."""
    texture: NDArray[np.float32]
    """(H, W, 3). Picture minus ground, inpainted under structures and details."""
    structure: NDArray[np.float32]
    """(H, W). Opacity of the structures."""
    through: NDArray[np.float32]
    """(H, W, 3). Colours of the structures, extended a little beyond their edges."""
    heights: NDArray[np.float32]
    """(H, W). Height over the picture's plane up to which the structures reach, in inradii; `RUNS_THROUGH` if they do
    not end."""
    detail: NDArray[np.float32]
    """(H, W). Opacity of the details."""
    labels: NDArray[np.int32]
    """(H, W). Number of the detail that each pixel belongs to, including a margin of two pixels; 0 for none."""
    details: list[Detail]
    thickness: float
    """Typical half thickness of long structures, cells."""
    spread: tuple[float, float, float]
    """Standard deviation of the texture, and of its slope along the directions a and b, per cell."""


def decompose(scaled: ScaledPicture, kind: Frame, membranes: NDArray[np.float32] | None = None) -> Layers:
    """Splits a picture into layers. Details and structures both contrast with the ground; details are compact.

    `membranes` (H, W): how surely each pixel shows a membrane, which is a structure however faint it is. Range [0, 1].
    """
    rind = followed = rind_depth(scaled.rgb, scaled.depth, OVER, goes_around=True)
    if kind == RADIAL:
        # What lies along the skin stays as it is, such as a cake's coat, but its top layer does not follow the sides.
        rind = rind_depth(scaled.rgb, scaled.depth, OVER, goes_around=False)
    core = scaled.depth > rind
    inradius = float(depth_in(scaled.depth > 0).max())  # pixels
    picture = _fill_mirrored(scaled.rgb, core)
    median = _wide_median(picture, WINDOW * inradius)
    contrast = np.linalg.norm(picture - median, axis=-1) * core
    high = max(MIN_CONTRAST, 3.5 * float(np.median(contrast[core]))) if core.any() else 1.0
    absorbed = near_absorbed = np.zeros_like(core)
    if kind == POLAR:
        median, absorbed = _without_medium_structures(picture, median, core, inradius, high)
        contrast = np.linalg.norm(picture - median, axis=-1) * core
    contrast = contrast.astype(np.float32)
    # Opacity is contrast relative to the strongest contrast nearby, which separates a black seed from the pale strand
    # it lies on.
    peak = ndimage.maximum_filter(contrast, size=2 * max(2, round(0.03 * inradius)) + 1)
    opacity = smoothstep(contrast / np.maximum(peak, 0.5 * high), 0.25, 0.65)
    if absorbed.any():
        # Within such a structure all pixels that differ from the ground belong to it, seeds included.
        typical = max(high, float(np.median(contrast[absorbed])))
        near_absorbed = ndimage.binary_dilation(absorbed, iterations=round(WINDOW * inradius))
        opacity = np.where(near_absorbed, smoothstep(contrast / typical, 0.25, 0.65), opacity)
    parts, count = ndimage.label((contrast > 0.5 * high) & (opacity > 0.4))
    numbers = np.arange(count + 1)
    strong = ndimage.maximum(contrast, parts, numbers) > high
    strong[0] = False
    # At the edge of a wide structure the median itself changes; a part found there is that edge, hence a structure.
    deviation = _local_deviation(median, 0.06 * inradius)
    edges = strong & (ndimage.mean(deviation, parts, numbers) > 0.4 * ndimage.mean(contrast, parts, numbers))
    compact, long = _classify(parts, count, strong & ~edges, inradius)
    if kind == POLAR:
        # A part on the axis is the core, not a seed.
        middle = (round(scaled.middle[1] * OVER), round(scaled.middle[0] * OVER))
        reach = round(0.06 * inradius)
        box = parts[middle[0] - reach : middle[0] + reach + 1, middle[1] - reach : middle[1] + reach + 1]
        for numbers_there in (np.unique(box), np.unique(parts[absorbed])):
            edges[numbers_there] |= strong[numbers_there]
        compact &= ~edges
    runs = long | edges
    structure = opacity * ndimage.binary_dilation(runs[parts], iterations=1) if count else np.zeros_like(contrast)
    if membranes is not None:
        structure = np.maximum(structure, membranes * core)
    reach, owner = ndimage.distance_transform_edt(~compact[parts], return_indices=True)
    labels = np.where(reach <= 2.5, (parts * compact[parts])[owner[0], owner[1]], 0).astype(np.int32)
    detail = opacity * (labels > 0) * (structure < 0.5)
    rim = 1 - smoothstep(scaled.depth, 0.85 * rind, rind)
    structure = np.maximum(structure, rim).astype(np.float32)
    clean = core & (structure < 0.05) & ~ndimage.binary_dilation(labels > 0, iterations=1)
    clean &= ~ndimage.binary_dilation(strong[parts] | (contrast > high), iterations=2) & ~near_absorbed
    if not clean.any():
        clean = core if core.any() else scaled.depth > 0
    # Unlike a mean, the median keeps the edges of wide areas and ignores details and structures.
    ground = ndimage.gaussian_filter(median, (0.02 * inradius, 0.02 * inradius, 0))
    texture = _fill_mirrored(picture - ground, clean)
    # Thin structures are smoothed by half a voxel, or cuts along them would show the grid; their colours extend as far.
    solid = structure > 0.7
    if membranes is not None:
        solid |= (membranes > LEAST_MEMBRANE) & core
    nearest = ndimage.distance_transform_edt(~solid, return_distances=False, return_indices=True)
    thin = ndimage.gaussian_filter(structure, 0.6 * OVER)
    heights = np.full(core.shape, RUNS_THROUGH, np.float32)
    if kind == POLAR:
        heights = closed_heights(structure, core, (scaled.middle[1] * OVER, scaled.middle[0] * OVER))
        if membranes is not None:
            heights[ndimage.grey_dilation(membranes, size=(5, 5)) > 0] = RUNS_THROUGH
    return Layers(
        scaled,
        followed,
        ground,
        texture,
        np.maximum(thin, structure * (1 - smoothstep(scaled.depth, rind, UNDER * rind))).astype(np.float32),
        scaled.rgb[nearest[0], nearest[1]] if solid.any() else scaled.rgb,
        heights,
        detail.astype(np.float32),
        labels,
        _details(scaled, parts, compact, labels, ground),
        _thickness(long[parts]),
        _spread(scaled, picture - ground, clean),
    )


def _without_medium_structures(
    picture: NDArray[np.float32], median: NDArray[np.float32], core: NDArray[np.bool_], inradius: float, high: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(H, W, 3), (H, W). The ground without structures of medium size that the median had absorbed, and their mask.

    They are the areas where the median differs from one over a wider window, and run through along the axis.
    """
    wide = _wide_median(picture, WIDE_WINDOW * inradius)
    absorbed = (np.linalg.norm(median - wide, axis=-1) > high) & core
    near = depth_in(~absorbed) / (WINDOW * inradius) if absorbed.any() else np.inf
    weight = 1 - smoothstep(np.broadcast_to(near, core.shape), 0.5, 1)[..., None]
    return (median + weight * (wide - median)).astype(np.float32), absorbed


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
        if large < MAX_DETAIL_LENGTH * inradius and large < MAX_ELONGATION * small and filled > 0.5:
            compact[number] = True
        elif large > 0.1 * inradius:
            long[number] = True
    return compact, long


def _details(
    scaled: ScaledPicture,
    parts: NDArray[np.int32],
    compact: NDArray[np.bool_],
    labels: NDArray[np.int32],
    ground: NDArray[np.float32],
) -> list[Detail]:
    """The compact parts, measured along the picture's directions a and b."""
    found = []
    boxes = ndimage.find_objects(labels)
    for number in np.flatnonzero(compact):
        if number > len(boxes) or boxes[number - 1] is None:
            continue
        rows, columns = np.nonzero(parts == number)
        x, y = columns.mean() / OVER, rows.mean() / OVER
        pixel = int(((scaled.xy - [x, y]) ** 2).sum(1).argmin())
        offsets = np.stack([columns / OVER - x, rows / OVER - y], -1)
        a, b = scaled.ab[pixel, :2], scaled.ab[pixel, 2:]
        half = tuple(2 * float(np.sqrt(((offsets @ d) ** 2).mean() + 0.03)) for d in (a, b))
        reach = float(np.linalg.norm(offsets, axis=1).max()) + 2.5 / OVER
        under = ground[rows, columns].mean(0)
        found.append(Detail(float(x), float(y), (half[0], half[1]), reach, int(number), under, pixel))
    return found


def _local_deviation(median: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """(H, W). Local standard deviation of a picture's colours around each pixel."""
    mean = ndimage.gaussian_filter(median, (sigma, sigma, 0))
    square = ndimage.gaussian_filter(median**2, (sigma, sigma, 0))
    return np.sqrt(np.maximum(square - mean**2, 0).sum(-1))


def _thickness(long: NDArray[np.bool_]) -> float:
    """Half thickness in cells of long parts: the pixels of a ribbon lie a quarter of its width from its edge on
    average."""
    depth = depth_in(long)[long]
    return float(np.clip(2 * depth.mean() / OVER, 0.5, 2.5)) if len(depth) else 1.0


def _fill_mirrored(texture: NDArray[np.float32], clean: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Texture with masked pixels filled in by reflection about the nearest clean pixel."""
    row, column = ndimage.distance_transform_edt(~clean, return_distances=False, return_indices=True)
    here = np.indices(clean.shape)
    r = np.clip(2 * row - here[0], 0, clean.shape[0] - 1)
    c = np.clip(2 * column - here[1], 0, clean.shape[1] - 1)
    fine = clean[r, c]
    return texture[np.where(fine, r, row), np.where(fine, c, column)]


def _spread(
    scaled: ScaledPicture, texture: NDArray[np.float32], clean: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """Standard deviation of the clean texture and of its slopes along a and b, per cell."""
    inner = ndimage.binary_erosion(clean, iterations=2)
    grey = ndimage.gaussian_filter(texture.mean(-1), 0.5 * OVER)
    column, row = (scaled.xy * OVER + 0.5).astype(int).T
    keep = inner[row, column]
    if keep.sum() < 50:
        return 1e-3, 1e-3, 1e-3
    gy, gx = np.gradient(grey)
    slope = np.stack([gx[row, column], gy[row, column]], -1)[keep] * OVER
    a, b = scaled.ab[keep, :2], scaled.ab[keep, 2:]
    return (
        float(grey[row, column][keep].std()) + 1e-6,
        float((slope * a).sum(1).std()) + 1e-6,
        float((slope * b).sum(1).std()) + 1e-6,
    )
