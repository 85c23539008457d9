"""Atoms as the bytes that a graphics card reads."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.scene.atoms import Atoms
from engine.scene.morton import morton_order
from engine.scene.sh import rgb_to_sh

__all__ = ["Cube", "PackedSkin", "pack_skin"]

LEVELS = 127
"""Steps of a signed byte on either side of 0."""

POSITIONS = 65535
"""Steps of a position along the cube: of an object of 300 pitches, two hundred for each."""


@dataclass(frozen=True)
class Cube:
    """The cube that holds an object, in which the page measures."""

    low: NDArray[np.float64]
    """(3,). Its least corner, world units."""
    edge: float
    """World units. Range (0, inf)."""

    @staticmethod
    def of(bounds: NDArray[np.floating]) -> Cube:
        """Around bounds (2, 3), with the same middle."""
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
    """Fours of harmonics."""
    scales: tuple[float, float]
    """The greatest coefficient of degree 0 and of all others: what 127 stands for."""


def pack_skin(atoms: Atoms, cube: Cube) -> PackedSkin:
    """The surface atoms, and the interior ones that show through their holes."""
    skin, inner, n = atoms.surface, atoms.interior, atoms.interior.exposed
    bands = skin.sh.shape[1]
    means = np.concatenate([skin.means, inner.means[:n]])
    scales = np.concatenate([skin.scales, np.repeat(inner.sigmas[:n, None], 3, axis=1)])
    quats = np.concatenate([skin.quats, np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))])
    sh = np.zeros((len(means), bands, 3), np.float32)
    sh[: len(skin)] = skin.sh
    sh[len(skin) :, 0] = rgb_to_sh(inner.rgb[:n])
    greatest = tuple(float(np.abs(part).max(initial=1e-6)) for part in (sh[:, :1], sh[:, 1:]))
    sh[:, :1] /= greatest[0]
    sh[:, 1:] /= greatest[1]
    vectors = -(-3 * bands // 4)
    record = np.zeros(
        len(means), [("mean", "<u2", 3), ("scale", "<f2", 3), ("quat", "i1", 4), ("sh", "i1", 4 * vectors)]
    )
    order = morton_order(means)
    record["mean"] = np.round((means[order] - cube.low) / cube.edge * POSITIONS).clip(0, POSITIONS)
    record["scale"] = scales[order] / cube.edge
    record["quat"] = np.round(quats[order] * LEVELS)
    record["sh"][:, : 3 * bands] = np.round(sh[order].reshape(len(means), -1) * LEVELS)
    planes = np.ascontiguousarray(record.view(np.uint8).reshape(len(means), record.itemsize).T)
    return PackedSkin(
        zlib.compress(planes.tobytes(), 9), len(means), round(bands**0.5) - 1, vectors, (greatest[0], greatest[1])
    )
