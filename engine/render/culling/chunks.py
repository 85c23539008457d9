"""Atoms in spatial chunks: runs of a few hundred along a Morton curve, each with its bounding box.

Culling goes chunk by chunk, then atom by atom, and leaves one list of indices. Within a chunk the atoms are in
bit-reversed order, so that any prefix is spread evenly over the chunk: prefixes are the coarser levels of detail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.culling.backface import SHELL
from engine.scene.morton import morton_order

__all__ = ["CHUNK", "Chunks", "atoms_at_plane", "build", "classify"]

CHUNK = 256
"""Atoms in a chunk. Smaller chunks cull better but cost more per frame; 128 to 512 take the same time."""


@dataclass(frozen=True)
class Chunks:
    """K chunks of N atoms."""

    order: NDArray[np.intp]
    """(N,). Row of each atom in the caller's arrays."""
    first: NDArray[np.int64]
    """(K,). Each chunk's first atom."""
    count: NDArray[np.int64]
    """(K,). Number of atoms in each chunk."""
    middle: NDArray[np.float64]
    """(K, 3). Centre of each box."""
    half: NDArray[np.float64]
    """(K, 3). Half of each box's sides; boxes hold the atoms' centres, not their extents."""
    sigma: NDArray[np.float64]
    """(K,). Largest standard deviation in each chunk."""

    def __len__(self) -> int:
        return len(self.first)

    def distances(self, normal: NDArray[np.float64], offset: float) -> NDArray[np.float64]:
        """(K, 2). Least and largest signed distance of each box to a plane."""
        at = self.middle @ normal + offset
        reach = self.half @ np.abs(normal)
        return np.stack([at - reach, at + reach], 1)


def build(means: NDArray[np.float32], sigmas: NDArray[np.float32]) -> Chunks:
    """Chunks of atoms with centres (N, 3) and largest standard deviations (N,)."""
    n = len(means)
    if n == 0:
        empty = np.zeros(0, np.int64)
        return Chunks(empty.astype(np.intp), empty, empty, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    order = morton_order(means)
    first = np.arange(0, n, CHUNK)
    count = np.minimum(CHUNK, n - first)
    tail = n % CHUNK
    whole = order[: n - tail].reshape(-1, CHUNK)[:, reversal(CHUNK)].ravel()
    order = np.concatenate([whole, order[n - tail :][reversal(tail)]])
    points = means[order].astype(np.float64)
    least = np.minimum.reduceat(points, first)
    most = np.maximum.reduceat(points, first)
    sigma = np.maximum.reduceat(sigmas[order].astype(np.float64), first)
    return Chunks(order, first, count, (least + most) / 2, (most - least) / 2, sigma)


def reversal(n: int) -> NDArray[np.intp]:
    """(n,). The numbers below n ordered by their reversed bits, so that every prefix is spread evenly."""
    bits = max(n - 1, 0).bit_length()
    numbers = np.arange(1 << bits)
    reverse = np.zeros_like(numbers)
    for bit in range(bits):
        reverse |= ((numbers >> bit) & 1) << (bits - 1 - bit)
    return reverse[reverse < n]


@njit(cache=True)
def atoms_at_plane(points, reach, first, count, planes, j):
    """uint32 indices of the atoms in some runs that plane j of planes (P, 4) meets and no other plane removes.

    points (N, 3) and reach (N,), the distance at which an atom ends, are float32. A run is `count` atoms from `first`.
    """
    total = 0
    for k in range(len(first)):
        total += count[k]
    rows = np.empty(total, np.uint32)
    at = 0
    for k in range(len(first)):
        for i in range(first[k], first[k] + count[k]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            r = reach[i]
            kept = abs(planes[j, 0] * x + planes[j, 1] * y + planes[j, 2] * z + planes[j, 3]) <= r
            if kept:
                for m in range(len(planes)):
                    if m != j and planes[m, 0] * x + planes[m, 1] * y + planes[m, 2] * z + planes[m, 3] > r:
                        kept = False
                        break
            if kept:
                rows[at] = i
                at += 1
    return rows[:at]


@njit(cache=True)
def classify(points, reach, first, count, planes, eye, orthographic, cones):
    """uint32 indices of a piece's outside atoms: those no plane touches, those a plane clips, those that face away.

    points (N, 3) and reach (N,), the distance at which an atom ends. A run is `count` atoms from `first`.
    planes (P, 4). eye (3,): its position, or if orthographic the viewing direction. cones: backface.NormalCones.
    Floats are float32.
    """
    total = 0
    for k in range(len(first)):
        total += count[k]
    unclipped = np.empty(total, np.uint32)
    clipped = np.empty(total, np.uint32)
    hidden = np.empty(total, np.uint32)
    unclipped_count = clipped_count = hidden_count = 0
    for k in range(len(first)):
        for i in range(first[k], first[k] + count[k]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            r = reach[i]
            kept, touched, close = True, False, False
            for j in range(len(planes)):
                distance = planes[j, 0] * x + planes[j, 1] * y + planes[j, 2] * z + planes[j, 3]
                if distance > r:
                    kept = False
                    break
                touched = touched or distance > -r
                # Atoms that reach over the rim of a face are part of its outline.
                close = close or distance > np.float32(-1.5) * r
            if not kept:
                continue
            if cones.min_cosine[i] <= 1 and not close:
                dx, dy, dz = eye[0], eye[1], eye[2]
                length = np.float32(1.0)
                if not orthographic:
                    dx, dy, dz = x - dx, y - dy, z - dz
                    length = np.sqrt(dx * dx + dy * dy + dz * dz)
                cosine = dx * cones.axes[i, 0] + dy * cones.axes[i, 1] + dz * cones.axes[i, 2]
                if cosine >= cones.min_cosine[i] * length and enters_clear_of_skin(
                    x, y, z, dx, dy, dz, orthographic, planes, cones
                ):
                    hidden[hidden_count] = i
                    hidden_count += 1
                    continue
            if touched:
                clipped[clipped_count] = i
                clipped_count += 1
            else:
                unclipped[unclipped_count] = i
                unclipped_count += 1
    return unclipped[:unclipped_count], clipped[:clipped_count], hidden[:hidden_count]


@njit(cache=True)
def enters_clear_of_skin(x, y, z, dx, dy, dz, orthographic, planes, cones):
    """Whether the line of sight (dx, dy, dz) to a point crosses every plane in empty space or deep inside the solid."""
    zone, low, cell = cones.zone, cones.low, cones.cell
    for j in range(len(planes)):
        along = planes[j, 0] * dx + planes[j, 1] * dy + planes[j, 2] * dz
        if along >= 0:
            continue
        back = (planes[j, 0] * x + planes[j, 1] * y + planes[j, 2] * z + planes[j, 3]) / along
        if not orthographic and back > 1:  # the plane lies behind the eye
            continue
        a = int(np.floor((x - back * dx - low[0]) / cell))
        b = int(np.floor((y - back * dy - low[1]) / cell))
        c = int(np.floor((z - back * dz - low[2]) / cell))
        if 0 <= a < zone.shape[0] and 0 <= b < zone.shape[1] and 0 <= c < zone.shape[2] and zone[a, b, c] == SHELL:
            return False
    return True
