"""Corrects an extruded picture by what radial pictures show at each height."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.inside import InsideRecord
from training.priors.exemplar.frames import ScaledPicture
from training.priors.exemplar.layering.height_mask import HeightMask
from training.priors.exemplar.layering.places import Places, Shape
from training.priors.exemplar.layering.sheet import GROUND, STRUCTURE, TEXTURE, THROUGH, Sheet
from training.priors.exemplar.outline import ANGLES, INSET_STEP, Outline, skin_weight
from training.priors.exemplar.record import MOST_SHEETS, RecordReader, nested
from training.priors.exemplar.sampling import read_bilinear, smoothstep

__all__ = ["RING_SAMPLES", "Correction", "radial_position"]

RINGS, RING_SAMPLES = 64, 1_500_000
"""Rings per slice, and random voxels for their median colours: some hundreds per ring."""

MIN_DIFFERENCE = 0.10
"""RGB distance from which two pixels show different materials rather than different shades."""


@dataclass(frozen=True)
class Correction:
    """Radial pictures, and what the extruded picture shows where they look.

    Each half of each radial picture samples the same map of (direction, depth). Where most halves show a different
    material from the extruded picture's ring there (a layer, the end of a core, thick pith at a pole), their colour
    replaces it; where they agree on a smaller difference, it is added. Seeds and other chance features appear in one
    half at a time. Where all halves cross an apple's carpel, the extrusion has it already and it is left alone.
    """

    sheets: list[Sheet]
    rings: NDArray[np.float32]
    """(L, RINGS, 3). Median colour of the extruded picture at each level and share of the rim."""
    by_depth: NDArray[np.float32]
    """(D, 1, 3). Median colour of the extruded picture at each INSET_STEP of depth under its edge."""

    @classmethod
    def of(
        cls, sheets: list[Sheet], shape: Shape, carrier: ScaledPicture, places: Places, rgb: NDArray[np.float32]
    ) -> Correction:
        """The correction by radial pictures of a carrier that gives these colours (M, 3) to random places of the
        body."""
        by_depth = _median_by_depth(carrier, shape.inradius)
        return cls(sheets, _median_rings(places, rgb, len(shape.rims)), by_depth[:, None].astype(np.float32))

    def reduced(self, n: int) -> Correction:
        """The same correction by pictures with pixels n times as large."""
        return replace(self, sheets=[sheet.reduced(n) for sheet in self.sheets])

    def apply(
        self,
        rgb: NDArray[np.float32],  # in out [M, 3]
        places: Places,
        shape: Shape,
        carrier: Sheet,
        height_mask: HeightMask | None,
    ) -> None:
        """Corrects the colours of points, in place."""
        # The extruded rings, read by depth and share of the rim like the picture itself.
        near = skin_weight(places.depth, carrier.rind)[:, None]
        at_depth = read_bilinear(
            np.repeat(self.by_depth, 2, axis=1), places.depth * shape.inradius / INSET_STEP, np.zeros(len(rgb))
        )
        base = near * at_depth
        base += (1 - near) * read_bilinear(self.rings, places.level - 0.5, places.share * RINGS - 0.5)
        seen = np.empty((2 * len(self.sheets), len(base), 3), np.float32)
        for n, sheet in enumerate(self.sheets):
            for side in (1, -1):
                found = sheet.read(*radial_position(sheet, sheet.rind, places, shape, side), slice(0, THROUGH.stop))
                bare = found[:, GROUND] + found[:, TEXTURE]
                seen[2 * n + (side < 0)] = bare + found[:, STRUCTURE] * (found[:, THROUGH] - bare)
        if height_mask is not None:
            explained = height_mask.explains(places.across, places.height)
            seen[:, explained] = base[explained]
        gap = seen - base
        other = smoothstep(np.linalg.norm(gap, axis=-1), MIN_DIFFERENCE, 1.6 * MIN_DIFFERENCE)
        weight = smoothstep(other.mean(0), 0.45, 0.75)[:, None]
        replaced = (other[..., None] * seen).sum(0) / np.maximum(other.sum(0), 1e-6)[:, None]
        gentle = np.median(gap, axis=0)
        chance = gap.std(axis=0).mean(-1, keepdims=True)
        gentle *= np.clip(1 - chance / np.maximum(np.abs(gentle).mean(-1, keepdims=True), 1e-6), 0, 1)
        rgb += gentle * (1 - weight)
        rgb += weight * (replaced - rgb)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same correction."""
        arrays, facts = nested({str(n): sheet.record() for n, sheet in enumerate(self.sheets)})
        return arrays | {"rings": self.rings, "by_depth": self.by_depth}, facts | {"sheets": len(self.sheets)}

    @classmethod
    def restored(cls, record: RecordReader) -> Correction:
        """The correction in a `record`. Raises ValueError if the record is not valid."""
        return cls(
            [Sheet.restored(record.part(str(n))) for n in range(record.count("sheets", MOST_SHEETS))],
            record.array("rings", np.float32, (None, RINGS, 3)),
            record.array("by_depth", np.float32, (None, 1, 3)),
        )


def radial_position(
    outline: Outline, rind: float, places: Places, shape: Shape, side: int | NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(M,), (M,). Places of points in the right (side 1) or left (-1) half of a radial picture, cells. It is as wide in
    all directions, or the layers of a cake would bend where the body is slim. `rind`: see `Outline.position`."""
    across = places.across * outline.half[0]
    up = places.height * outline.half[1]
    angle = np.arctan2(up, side * across)
    share = np.minimum(np.hypot(across, up) / outline.rim(angle), 1)
    return outline.position(angle, share, places.depth, shape.inradius, rind)


def _median_rings(places: Places, rgb: NDArray[np.float32], levels: int) -> NDArray[np.float32]:
    """(L, RINGS, 3). Median colour of points (M, 3) at each level and share of the rim."""
    level = np.clip(places.level, 0, levels - 1).astype(np.int64)
    share = np.minimum(places.share * RINGS, RINGS - 1).astype(np.int64)
    shape = max(levels, 2), RINGS
    ring = level * RINGS + share
    count = np.bincount(ring, minlength=shape[0] * RINGS)
    middle = np.cumsum(count) - count + count // 2
    middle = np.minimum(middle, len(ring) - 1)
    found = np.stack([rgb[:, c][np.lexsort((rgb[:, c], ring))][middle] for c in range(3)], -1)
    nearest = ndimage.distance_transform_edt(count.reshape(shape) == 0, return_distances=False, return_indices=True)
    return found.reshape(*shape, 3)[nearest[0], nearest[1]]


def _median_by_depth(scaled: ScaledPicture, inradius: float) -> NDArray[np.float32]:
    """(D, 3). Median colour of a picture at each INSET_STEP of depth under its edge."""
    angles = (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi
    levels = np.arange(0, float(scaled.depth.max()) * inradius + INSET_STEP, INSET_STEP)[:, None]
    r = np.maximum(scaled.rim(angles) - scaled.inset(*np.broadcast_arrays(angles, levels)), 0)
    return np.median(scaled.read(scaled.middle[0] + r * np.cos(angles), scaled.middle[1] - r * np.sin(angles)), axis=1)
