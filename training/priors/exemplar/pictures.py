"""Reads photographs of cut faces: removes the background and evens out the lighting."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from scipy import ndimage
from scipy.spatial import ConvexHull

from engine.errors import InputError
from engine.io.picture_file import open_picture
from training.families import Kind
from training.priors.exemplar.lighting import flatten_light

__all__ = ["Picture", "read_picture", "resolved_share"]

MAX_SIDE = 768
"""Longer side in pixels to which larger pictures are reduced: a solve on 256 voxels uses no more."""

MIN_SIDE = 24
"""Smallest width of a cut face in pixels; below, it holds no 7x7 patches worth copying."""

INVISIBLE_RMS = 1 / 255
"""RMS colour difference that an 8-bit screen cannot show."""

REGIONS = 16
"""Regions across a picture, small enough for a seed to count; the worst region decides."""

BACKGROUND_FLOOR = 0.05
"""Smallest RGB distance from the background that counts: noise and JPEG blocks stay below it."""

MIN_CORNERS = 2
"""Corners of the picture that each background covers at least: a table and the wall behind it have two each. A face
cropped by the border covers none, or the one it lies in."""

MAX_BORDER_SHARE = 0.25
"""Of a face's width, how much of one side of the picture it may lie on. A round face with such a chord lacks 1.6 % of
its width, which nobody sees; a stalk or a crumb at the border is narrower still."""

MIN_SOLIDITY = 0.7
"""Of its convex hull, the least that a cut face fills. The 29 photographs with hand-checked masks fill 0.93 and more;
what is found of a pale face that two sides cut off is its rind, an arc that fills less than half."""

UNSURE = 1.5
"""Pixels by which a found outline may be off: a face that lacks no more lacks nothing. Of a face W pixels wide that is
a chord of sqrt(4 UNSURE W), which in small pictures is more than the share above."""


@dataclass(frozen=True)
class Picture:
    """A photographed cut face and its mask."""

    path: Path
    rgb: NDArray[np.float32]
    """(H, W, 3). Range [0, 1]; outside the mask the nearest colour inside."""
    mask: NDArray[np.bool_]
    """(H, W). The cut face."""


def read_picture(path: str | Path, kind: Kind) -> Picture:
    """Reads a photograph of a cut face of one kind of family.

    The alpha channel, if any, is the mask; otherwise the background is what looks like the picture's border.
    Raises InputError if the file cannot be read or no cut face stands out.
    """
    path = Path(path)
    rgb, alpha = _read(path)
    mask = _largest_component(alpha > 0.5) if alpha is not None else _foreground(rgb, path)
    rows, columns = np.nonzero(mask)
    if len(rows) == 0 or min(np.ptp(rows), np.ptp(columns)) + 1 < MIN_SIDE:
        raise InputError(
            f"{path}: the cut face is smaller than {MIN_SIDE} pixels; give a larger picture, or one where the "
            "cut face stands out from a plain background"
        )
    margin = 2 + round(0.03 * max(np.ptp(rows), np.ptp(columns)))
    mask, rgb = (_crop(a, rows, columns, margin) for a in (mask, rgb))
    return Picture(path, fill_outside(flatten_light(rgb, mask, kind), mask), mask)


def resolved_share(picture: Picture) -> float:
    """The smallest scale at which the cut face keeps its detail: below, some region changes by over INVISIBLE_RMS.

    1 for a sharp picture, less for one that was enlarged, is out of focus or shows little. Range (0, 1].
    """
    rows, columns = np.nonzero(picture.mask)
    longer = max(np.ptp(rows), np.ptp(columns)) + 1
    # Pixels at the edge mix with the background at any scale.
    core = ndimage.binary_erosion(picture.mask, iterations=2, border_value=0)
    share = 1.0
    while share * longer > MIN_SIDE:
        coarser = share / 2**0.25
        wrong = np.where(core, np.square(_resample(picture.rgb, coarser) - picture.rgb).mean(axis=-1), 0)
        if ndimage.uniform_filter(wrong, max(round(longer / REGIONS), 1)).max() > INVISIBLE_RMS**2:
            break
        share = coarser
    return share


def _resample(rgb: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """(H, W, 3). The picture reduced to this scale and enlarged again."""
    height, width = rgb.shape[:2]
    size = max(round(width * share), 1), max(round(height * share), 1)
    channels = (Image.fromarray(np.ascontiguousarray(rgb[..., c])) for c in range(3))
    sharp = Image.Resampling.LANCZOS  # other filters remove detail that the smaller picture could hold
    return np.stack([np.asarray(c.resize(size, sharp).resize((width, height), sharp)) for c in channels], axis=-1)


def fill_outside(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W, 3). The picture with every pixel outside the mask replaced by the nearest one inside.

    The outermost ring of the mask does not count as inside: it is half background.
    """
    core = ndimage.binary_erosion(mask, iterations=1, border_value=0)
    nearest = ndimage.distance_transform_edt(~core, return_distances=False, return_indices=True)
    return rgb[nearest[0], nearest[1]]


def _crop(a: NDArray, rows: NDArray, columns: NDArray, margin: int) -> NDArray:
    """The bounding box of the cut face with a margin of repeated edge pixels (False for a mask)."""
    box = a[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    around = [(margin, margin)] * 2 + [(0, 0)] * (a.ndim - 2)
    return np.pad(box, around, mode="constant" if a.dtype == bool else "edge")


def _read(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """(H, W, 3) colours and, if the picture has real transparency, (H, W) opacity; both in [0, 1]."""
    alpha: NDArray[np.float32] | None = None
    with open_picture(path) as opened:
        image = ImageOps.exif_transpose(opened)
        if image.mode[:1] in "IF":  # 16 and 32 bits of grey
            values = np.nan_to_num(np.asarray(image, np.float64), posinf=0, neginf=0)
            top = 65535.0 if values.max(initial=0) > 255 else max(1.0, float(values.max(initial=0)))
            image = Image.fromarray((np.clip(values / top, 0, 1) * 255 + 0.5).astype(np.uint8))
        if "A" in image.mode or "transparency" in image.info:
            image = image.convert("RGBA")
        if max(image.size) > MAX_SIDE:
            image.thumbnail((MAX_SIDE, MAX_SIDE), Image.Resampling.LANCZOS)
        if min(image.size) < MIN_SIDE:
            raise InputError(f"{path}: only {image.width}x{image.height} pixels; give a larger picture")
        if image.mode == "RGBA":
            alpha = np.asarray(image.getchannel("A"), np.float32) / np.float32(255)
            if (alpha < 0.5).mean() < 0.005:
                alpha = None
        return np.asarray(image.convert("RGB"), np.float32) / np.float32(255), alpha


def _foreground(rgb: NDArray[np.float32], path: Path) -> NDArray[np.bool_]:
    """(H, W). The pixels that do not look like the border of the picture.

    The border's colours are modelled as a smooth surface over the picture (uneven light, a soft shadow) plus a spread,
    with up to two such surfaces (a table and a wall). Otsu's threshold on the distance to them, clipped to sensible
    bounds, decides. The model assumes that the border shows background only. Raises InputError if the foreground
    reaches the border, or if there is none.
    """
    height, width = rgb.shape[:2]
    band = max(2, round(0.03 * min(height, width)))
    border = np.ones((height, width), bool)
    border[band:-band, band:-band] = False
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * y, x * x, y * y], -1)
    smooth = ndimage.gaussian_filter(rgb, (1.0, 1.0, 0))
    # Brightness counts less than hue: a shadow changes a table's brightness more.
    light = smooth.sum(-1, keepdims=True) / 3
    chroma = np.concatenate([0.6 * light, smooth - light], -1)
    distance = np.full((height, width), np.inf)
    unexplained, plain = border.copy(), np.zeros(4, bool)
    for _ in range(2):
        if unexplained.sum() < 0.1 * border.sum():
            break
        surface, spread, is_background = _fit_background(chroma, basis, unexplained)
        corners = _corners(is_background, band)
        if corners.sum() < MIN_CORNERS:
            break
        plain |= corners
        distance = np.minimum(distance, np.linalg.norm(chroma - surface, axis=-1) / max(spread, BACKGROUND_FLOOR / 3))
        unexplained &= ~is_background
    cut_off = InputError(
        f"{path}: the cut face, or something beside it, reaches the picture's border; take all of it with plain "
        "background around it, or cut it out"
    )
    if np.isinf(distance).all():
        raise cut_off
    found = distance > float(np.clip(_otsu(distance), 3.0, 6.0))
    found = ndimage.binary_opening(found, iterations=1)
    found = ndimage.binary_closing(np.pad(found, 8), iterations=max(1, min(height, width) // 150))[8:-8, 8:-8]
    # Edge pixels are half background, and smoothing has moved the edge outwards by another half pixel.
    eroded = ndimage.binary_erosion(found)
    mask = _largest_component(eroded)
    if mask.mean() < 0.02:
        raise InputError(f"{path}: no cut face stands out from the background; use a plain background, or cut it out")
    across = max(np.ptp(places) + 1 for places in np.nonzero(mask))
    if _along_border(eroded, plain) > max(MAX_BORDER_SHARE * across, (4 * UNSURE * across) ** 0.5):
        raise cut_off
    if _solidity(mask) < MIN_SOLIDITY:
        raise cut_off
    return mask


def _solidity(mask: NDArray[np.bool_]) -> float:
    """Part of its convex hull that a mask (H, W), not empty, fills. Range (0, 1]."""
    rims = mask & ~ndimage.binary_erosion(mask)
    corners = np.argwhere(rims)[:, None] + np.array([[0, 0], [0, 1], [1, 0], [1, 1]])  # of pixels, so none is flat
    return float(mask.sum() / ConvexHull(corners.reshape(-1, 2)).volume)


def _corners(is_background: NDArray[np.bool_], band: int) -> NDArray[np.bool_]:
    """(4,). Corners of the picture, squares of side `band`, that mostly belong to `is_background` (H, W); clockwise
    from the top left."""
    first, last = slice(None, band), slice(-band, None)
    places = ((first, first), (first, last), (last, last), (last, first))
    return np.array([is_background[place].mean() > 0.5 for place in places])


def _along_border(found: NDArray[np.bool_], plain: NDArray[np.bool_]) -> int:
    """Pixels of the longest piece of the picture's border between two that are `found` (H, W) and no corner that is
    background, `plain` (4,), between them.

    Of a pale face that the border cuts off only the rind may stand out: it lies at the two ends of this piece.
    """
    # The outermost ring of all is empty, erosion has taken it.
    sides = [found[1, 1:-1], found[1:-1, -2], found[-2, -2:0:-1], found[-2:0:-1, 1]]  # clockwise from the top left
    first = int(np.argmax(plain))  # one at least is background
    pieces: list[NDArray[np.bool_]] = []
    for k in range(4):
        side = sides[(first + k) % 4]
        if plain[(first + k) % 4]:
            pieces.append(side)
        else:
            pieces[-1] = np.concatenate([pieces[-1], side])
    return max(int(np.ptp(np.flatnonzero(piece))) + 1 if piece.any() else 0 for piece in pieces)


def _fit_background(
    chroma: NDArray[np.float32], basis: NDArray[np.float64], where: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float, NDArray[np.bool_]]:
    """The colour surface (H, W, 3) that fits most of the border, its spread, and its inliers (H, W).

    Starts from the most frequent colour, then alternates a least-squares fit with the selection of inliers.
    """
    colours = chroma[where]
    bins = np.round(colours / 0.06).astype(np.int64)
    values, counts = np.unique(bins, axis=0, return_counts=True)
    mode = colours[(np.abs(bins - values[counts.argmax()]) <= 1).all(1)].mean(0)
    surface = np.broadcast_to(mode, chroma.shape).astype(np.float64)
    radius, spread = 0.15, 0.05
    is_background = where
    for terms in (1, 3, 6):
        gap = np.linalg.norm(chroma - surface, axis=-1)
        is_background = where & (gap < radius)
        if is_background.sum() < 20:
            break
        # Ridge regression: unregularised, the curved terms diverge over the middle, where there are no border pixels.
        a = basis[is_background][:, :terms]
        ridge = 1e-2 * len(a) * np.diag([0.0, *[1.0] * (terms - 1)])
        fit = np.linalg.solve(a.T @ a + ridge, a.T @ chroma[is_background])
        surface = basis[..., :terms] @ fit
        spread = float(np.sqrt((np.linalg.norm(chroma[is_background] - surface[is_background], axis=-1) ** 2).mean()))
        radius = float(np.clip(4 * spread, 0.06, 0.15))
    return surface, spread, is_background


def _otsu(values: NDArray[np.floating]) -> float:
    """Otsu's threshold of the values on a logarithmic scale (Otsu 1979)."""
    logs = np.log(np.maximum(values, 1e-2))
    counts, edges = np.histogram(logs, 128)
    middle = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)
    above = below[-1] - below
    sums = np.cumsum(counts * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = below * above * (sums / below - (sums[-1] - sums) / above) ** 2
    between[~np.isfinite(between)] = 0  # one of the two classes is empty
    return float(np.exp(middle[between.argmax()]))


def _largest_component(found: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest connected component with its holes filled: a hole is a dark or white part of the face."""
    parts, count = ndimage.label(found)
    if count == 0:
        return np.zeros_like(found)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    return ndimage.binary_fill_holes(parts == sizes.argmax())
