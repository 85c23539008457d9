"""Atoms as the bytes that a graphics card reads."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.scene.atoms import Atoms
from engine.scene.morton import morton_order

__all__ = ["Cube", "PackedSkin", "pack_skin"]

LEVELS = 127
"""Steps of a signed byte on either side of 0."""

POSITIONS, POSITION_STEP = 65535, 4
"""Range of a position along the cube, and the step that it is rounded to: in an object of 300 pitches, fifty steps to a
pitch."""

COARSE = np.repeat([8, 16, 16], [3, 5, 7])
"""Steps, in `LEVELS`, of the coefficients of degrees 1 to 3: the five and four bits of SPZ."""

CLIPPED = 99.9
"""Per cent of the view-dependent coefficients that are not clipped: else a few mirror-like atoms would set the steps of
all."""

SCALE_STEP = 32
"""Step in the bits of a standard deviation as half float: five bits after the point, steps of 3 %."""


@dataclass(frozen=True)
class Cube:
    """The cube around an object, in whose coordinates the page works."""

    low: NDArray[np.float64]
    """(3,). Its least corner, world units."""
    edge: float
    """World units. Range (0, inf)."""

    @staticmethod
    def of(bounds: NDArray[np.floating]) -> Cube:
        """The cube around bounds (2, 3), with the same middle."""
        low, high = np.asarray(bounds, np.float64)
        edge = max(float((high - low).max()), 1e-12)
        return Cube((low + high - edge) / 2, edge)


@dataclass(frozen=True)
class PackedSkin:
    """What is seen from outside, in Morton order: neighbours have like bytes."""

    data: bytes
    """zlib. The first byte of all records, then the second, and so on. A record is a position in the cube (3 uint16),
    standard deviations in its edges (3 float16), a quaternion wxyz (4 int8), and spherical harmonics (int8), three
    channels each, filled up to whole fours."""
    count: int
    degree: int
    vectors: int
    """Fours of numbers that hold an atom's harmonics."""
    scales: tuple[float, float]
    """What 127 stands for, in degree 0 and in all others."""


def pack_skin(atoms: Atoms, cube: Cube) -> PackedSkin:
    """The surface atoms."""
    skin = atoms.surface
    means, sh, bands = skin.means, skin.sh, skin.sh.shape[1]
    first = float(np.abs(sh[:, 0]).max(initial=1e-6))
    rest = float(max(np.percentile(np.abs(sh[:, 1:]), CLIPPED), 1e-6)) if sh[:, 1:].size else 1.0
    levels = np.zeros((len(means), bands, 3), np.int8)
    levels[:, 0] = np.round(sh[:, 0] / first * LEVELS)
    steps = COARSE[: bands - 1, None]
    levels[:, 1:] = (np.round(sh[:, 1:] / rest * LEVELS / steps) * steps).clip(-LEVELS - 1, LEVELS)
    vectors = -(-3 * bands // 4)
    record = np.zeros(
        len(means), [("mean", "<u2", 3), ("scale", "<f2", 3), ("quat", "i1", 4), ("sh", "i1", 4 * vectors)]
    )
    order = morton_order(means)
    places = (means[order] - cube.low) / cube.edge * (POSITIONS / POSITION_STEP)
    record["mean"] = (np.round(places) * POSITION_STEP).clip(0, POSITIONS)
    bits = (skin.scales[order] / cube.edge).astype("<f2").view("<u2").astype(np.int64)
    record["scale"] = (np.round(bits / SCALE_STEP) * SCALE_STEP).astype("<u2").view("<f2")
    record["quat"] = np.round(skin.quats[order] * LEVELS)
    record["sh"][:, : 3 * bands] = levels[order].reshape(len(means), -1)
    planes = np.ascontiguousarray(record.view(np.uint8).reshape(len(means), record.itemsize).T)
    return PackedSkin(zlib.compress(planes.tobytes(), 9), len(means), round(bands**0.5) - 1, vectors, (first, rest))
