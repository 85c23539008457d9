"""Limits the height of structures that a horizontal picture shows to where radial pictures show them too.

A horizontal picture is reliable at its own height only. Where the radial pictures show the same colour at that height
and radius, they are able to detect the structure, so it is removed at heights where they do not show it: an apple's
carpels end. Where they show nothing there, or cross the structure only by chance, they carry no evidence and the
structure runs through from pole to pole, like an orange's membranes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.cluster.vq import kmeans2

from engine.scene.inside import InsideRecord
from engine.solid.distance_transform import depth_in
from training.priors.exemplar.layering.decompose import Layers
from training.priors.exemplar.outline import UNDER
from training.priors.exemplar.patches import OVER
from training.priors.exemplar.record import RecordReader
from training.priors.exemplar.sampling import read_bilinear

__all__ = ["HeightMask", "make_height_mask"]

COLOURS = 8
"""Clusters of structure colours: edge of the flesh, core, seed, wall, and mixtures of these."""

SAME_COLOUR = 0.14
"""Largest RGB distance between two pixels that show the same kind of structure."""

RADII, HEIGHTS = 48, 96
"""Cells of the (radius, height) map."""

CUT_HEIGHT = 0.15
"""Largest assumed |height| of a horizontal picture, in half heights of the body: people cut fruit in half."""

MIN_DETECTED = 0.5
"""Share of the radial half pictures that must show a colour at the height of the cut to count as a detection; fewer
are chance."""

REACH = 0.12
"""Difference in radius, over the body's largest radius, up to which a structure is assumed equally tall."""

POLAR_HEIGHT = 0.8
"""|height| below which a structure must end to count as one that ends; taller ones run through to the rind."""

EDGE_WIDTH = 0.15
"""Width of the soft edge of the remaining opacity, as a share of the way from a structure's edge to its middle."""

MAX_MISS_CHANCE = 0.2
"""Largest probability of all halves missing an existing structure at which its absence from them still counts as
evidence."""


@dataclass(frozen=True)
class HeightMask:
    """Remaining opacity of structures by colour, radius and height."""

    palette: NDArray[np.float32]
    """(K, 3). Mean colours of the clusters."""
    opacity: NDArray[np.float32]
    """(K, RADII, HEIGHTS). Opacity of structures of this colour that run from pole to pole, range [0, 1]."""
    presence: NDArray[np.float32]
    """(K, RADII, HEIGHTS). Presence of a colour within structures that end, range [0, 1]."""
    ends: NDArray[np.float32]
    """(RADII, 2). Lowest and highest point of the structures; 0 and 0 where unknown."""
    main_colour: NDArray[np.intp]
    """(RADII,). Index of the most frequent colour of these structures."""
    enclosed: NDArray[np.bool_]
    """(K, RADII). Colours of what a structure encloses, such as the seeds in a carpel, which contrast with it."""
    enclosed_ends: NDArray[np.float32]
    """(RADII, 2). Lowest and highest point of what is enclosed; 0 and 0 where nothing is."""
    centrality: NDArray[np.float32]
    """(H, W, 2). Position of each pixel of the horizontal picture between the edge (0) and the middle (1) of its
    structure, and of what that structure encloses."""
    explained: NDArray[np.bool_]
    """(RADII, HEIGHTS). Where the radial pictures show sections of an extruded structure."""

    def at(
        self,
        colours: NDArray[np.float32],  # [M, 3]
        x: NDArray[np.floating],  # [M]
        y: NDArray[np.floating],  # [M]
        radius: NDArray[np.floating],
        height: NDArray[np.floating],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M,), (M, 3). Remaining opacity and colours of structures.

        Takes colours (M, 3) of the picture at places in it in cells, radii over the body's largest (M,) and heights
        (M,) in [-1, 1]. A structure closes towards its ends like an ellipsoid. So does an enclosed seed, which is
        replaced by the colour of its structure.
        """
        i, j = _cells(radius, height)
        centrality = read_bilinear(self.centrality, y * OVER, x * OVER)
        kind = ((colours[:, None] - self.palette) ** 2).sum(-1).argmin(1)
        opacity = self.opacity[kind, i, j] * _ellipsoid_opacity(self.ends[i], height, centrality[:, 0])
        presence = np.where(self.ends[i, 1] > self.ends[i, 0], self.presence[kind, i, j], 1)
        presence = np.where(
            self.enclosed[kind, i], _ellipsoid_opacity(self.enclosed_ends[i], height, centrality[:, 1]), presence
        )[:, None]
        mixed = presence * colours + (1 - presence) * self.palette[self.main_colour[i]]
        return opacity.astype(np.float32), mixed.astype(np.float32)

    def explains(self, radius: NDArray[np.floating], height: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(M,). Whether the radial pictures show a structure there that has been extruded already."""
        return self.explained[_cells(radius, height)]

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same mask."""
        return {name: np.asarray(getattr(self, name), dtype) for name, (dtype, _) in self._stored((0, 0)).items()}, {}

    @classmethod
    def restored(cls, record: RecordReader, pixels: tuple[int, int]) -> HeightMask:
        """The mask in a `record`, for a picture of (H, W) pixels. Raises ValueError if the record is not valid."""
        arrays = {name: record.array(name, dtype, shape) for name, (dtype, shape) in cls._stored(pixels).items()}
        if arrays["main_colour"].min() < 0 or arrays["main_colour"].max() >= COLOURS:
            raise ValueError("a wrong main_colour")
        return cls(**arrays)

    @staticmethod
    def _stored(pixels: tuple[int, int]) -> dict[str, tuple[type, tuple[int, ...]]]:
        """Type and shape of each array."""
        return {
            "palette": (np.float32, (COLOURS, 3)),
            "opacity": (np.float32, (COLOURS, RADII, HEIGHTS)),
            "presence": (np.float32, (COLOURS, RADII, HEIGHTS)),
            "ends": (np.float32, (RADII, 2)),
            "main_colour": (np.int64, (RADII,)),
            "enclosed": (np.bool_, (COLOURS, RADII)),
            "enclosed_ends": (np.float32, (RADII, 2)),
            "centrality": (np.float32, (*pixels, 2)),
            "explained": (np.bool_, (RADII, HEIGHTS)),
        }


def _ellipsoid_opacity(
    ends: NDArray[np.float32], height: NDArray[np.floating], centrality: NDArray[np.floating]
) -> NDArray[np.floating]:
    """(M,). Opacity of ellipsoids between ends (M, 2) at heights (M,) and centralities (M,).

    A slice at share u of the way from the middle to an end keeps pixels of centrality over 1 - sqrt(1 - u^2): all of
    them in the middle, only the centre at the end. Structures without known ends stay opaque.
    """
    low, high = ends.T
    known = high > low
    share = np.where(known, np.abs(2 * height - low - high) / np.where(known, high - low, 1), 0)
    edge = 1 - np.sqrt(np.maximum(1 - share * share, 0))
    return np.asarray(np.clip((centrality - edge) / EDGE_WIDTH + 1, 0, 1) * (share < 1))


def _cells(radius: NDArray[np.floating], height: NDArray[np.floating]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    i = np.clip(radius * RADII, 0, RADII - 1).astype(int)
    j = np.clip((height + 1) / 2 * HEIGHTS, 0, HEIGHTS - 1).astype(int)
    return i, j


def make_height_mask(carrier: Layers, radial: Sequence[Layers], rng: np.random.Generator) -> HeightMask | None:
    """The heights at which the radial pictures confirm structures of a horizontal one; None if it shows none."""
    scaled = carrier.source
    pixels = scaled.rgb[(carrier.structure > 0.5) & (scaled.depth > UNDER * carrier.rind)]
    if len(pixels) < 50:
        return None
    sample = pixels[rng.integers(len(pixels), size=4000)].astype(np.float64)
    palette = kmeans2(sample, COLOURS, minit="++", seed=rng)[0].astype(np.float32)
    t, h = np.meshgrid((np.arange(RADII) + 0.5) / RADII, (np.arange(HEIGHTS) + 0.5) / HEIGHTS * 2 - 1, indexing="ij")
    halves, narrow = [], []
    for parts in radial:
        middle, half = parts.source.middle, parts.source.half
        for side in (1, -1):
            detections = parts.source.read(middle[0] + side * t * half[0], middle[1] - h * half[1])
            presence = np.linalg.norm(detections - palette[:, None, None], axis=-1) < SAME_COLOUR
            # Tolerance: another cut shows the same structure a few cells away.
            halves.append(ndimage.binary_dilation(presence, np.ones((1, 5, 9))))
            narrow.append(ndimage.binary_dilation(presence, np.ones((1, 3, 3))))
    detections = np.stack(halves)  # [halves, colours, radii, heights]
    known = detections[..., np.abs(h[0]) < CUT_HEIGHT].any(-1).mean(0) >= MIN_DETECTED
    # A structure that covers few directions is crossed by chance: missing it elsewhere is no evidence.
    known &= (1 - _coverage(carrier, palette)) ** len(halves) < MAX_MISS_CHANCE
    # Colours close to the flesh are edges of other structures and follow those.
    flesh = np.median(scaled.rgb[(carrier.structure < 0.1) & (carrier.detail < 0.1) & (scaled.depth > 0)], axis=0)
    flesh_like = np.linalg.norm(palette - flesh, axis=1) <= 1.5 * SAME_COLOUR
    known &= ~flesh_like[:, None]
    tolerant, sharp = (
        ndimage.gaussian_filter(np.any(a, axis=0).astype(np.float32), (0, 0.7, 1)) for a in (detections, narrow)
    )
    certain = np.where(known[..., None], sharp, 0).max(0) > 0.5
    # A structure detected at some radii extends to the others, up to the height it has there.
    extents = np.array([_nearest_run(row, h[0]) for row in certain])
    in_range = (h >= extents[:, 0].min()) & (h <= extents[:, 1].max())
    things, _ = ndimage.label(in_range & (sharp[known.any(1)].max(0, initial=0) > 0.5))
    complete = certain | np.isin(things, np.unique(things[certain & (things > 0)]))
    ends = np.array([_nearest_run(row, h[0]) for row in complete], np.float32)
    detected = _crosses_cut(ends)
    opacity = np.ones_like(tolerant)
    if (np.abs(ends[detected]) >= POLAR_HEIGHT).any():
        # A structure that reaches the poles does not close; it is only removed where it is not detected.
        opacity = np.where(known[..., None], tolerant, 1)
        detected[:] = False
    # Just beyond the radii of a detection, and for colours too rare to be detected, a structure ends where it does at
    # the nearest radius of a detection.
    source_row, in_reach = np.arange(RADII), detected
    if detected.any():
        distance, nearest = ndimage.distance_transform_edt(~detected, return_indices=True)
        source_row, in_reach = nearest[0], distance <= REACH * RADII
    undetectable = flesh_like | ~detections.any((0, 2, 3))
    presence = np.where(undetectable[:, None, None], 1, sharp)[:, source_row]
    # Averaged over several radii: at some of them seeds cover more than the carpel around them.
    coverage = ndimage.uniform_filter1d(
        np.where(known, _coverage(carrier, palette), 0), round(2 * REACH * RADII), axis=1
    )
    nearest = ndimage.distance_transform_edt(~known.any(0), return_distances=False, return_indices=True)[0]
    main_colour = coverage.argmax(0)[nearest[source_row]]
    distinct = np.linalg.norm(palette[:, None] - palette[main_colour], axis=-1) > np.linalg.norm(
        palette[main_colour] - flesh, axis=-1
    )
    enclosed = distinct & ~undetectable[:, None] & in_reach
    enclosed_ends = np.array(
        [_nearest_run(row, h[0]) for row in ((presence > 0.5) & enclosed[..., None]).any(0)], np.float32
    )
    enclosed &= _crosses_cut(enclosed_ends)
    structure = carrier.structure > 0.5
    kinds = ((scaled.rgb[structure][:, None] - palette) ** 2).sum(-1).argmin(1)
    enclosed_pixels = structure.copy()
    enclosed_pixels[structure] = enclosed.any(1)[kinds]
    inner = scaled.depth > UNDER * carrier.rind
    return HeightMask(
        palette,
        opacity,
        presence,
        np.where(in_reach[:, None], ends[source_row], np.float32(0)),
        main_colour,
        enclosed,
        enclosed_ends,
        np.stack([_centrality(structure, inner), _centrality(enclosed_pixels, inner)], -1),
        ndimage.binary_closing(complete[source_row] & in_reach[:, None], np.ones((5, 9))),
    )


def _centrality(things: NDArray[np.bool_], inner: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W). Position of each pixel from the edge (0) of its structure to the middle (1) of the widest part nearby."""
    inside = depth_in(things)
    widest = ndimage.maximum_filter(inside, size=2 * int(inside[inner].max(initial=0)) + 1)
    return (inside / np.maximum(widest, 1)).astype(np.float32)


def _crosses_cut(ends: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(R,). Which runs of heights (R, 2) the plane of the horizontal picture crosses."""
    return (ends[:, 1] > ends[:, 0]) & (ends[:, 0] < CUT_HEIGHT) & (ends[:, 1] > -CUT_HEIGHT)


def _nearest_run(row: NDArray[np.bool_], heights: NDArray[np.floating]) -> tuple[float, float]:
    """Lowest and highest value of the run nearest to height 0; 0 and 0 if there is none."""
    runs, count = ndimage.label(row)
    if count == 0:
        return 0.0, 0.0
    levels = heights[runs == runs[row][np.abs(heights[row]).argmin()]]
    return float(levels.min()), float(levels.max())


def _coverage(carrier: Layers, palette: NDArray[np.floating]) -> NDArray[np.floating]:
    """(K, RADII). Share of the directions in which a horizontal picture shows structures of each colour at a radius."""
    scaled = carrier.source
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)[:, None]
    radius = (np.arange(RADII) + 0.5) / RADII * scaled.rim(angle)
    x, y = scaled.middle[0] + radius * np.cos(angle), scaled.middle[1] - radius * np.sin(angle)
    runs = ndimage.map_coordinates(carrier.structure, np.stack([y, x]) * OVER, order=1) > 0.5
    presence = runs & (np.linalg.norm(scaled.read(x, y) - palette[:, None, None], axis=-1) < SAME_COLOUR)
    return ndimage.binary_dilation(presence, np.ones((1, 1, 5))).mean(axis=1)
