"""How well the atoms of a skin cover it, and atoms for its holes."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import KDTree

from engine.scene.atoms import SurfaceAtoms
from engine.scene.grid import Body
from engine.scene.rotations import facing, rotation_matrices
from engine.threads import cores, for_each

__all__ = ["close_holes", "coverage_at", "inward_normals", "project_onto_skin", "sample_skin"]

Float = NDArray[np.float32]

NEIGHBOURS = 24
"""Nearest atoms that may cover a point: more than overlap anywhere on a usual skin."""

NEWTON_STEPS = 3
"""Steps onto the skin. Of the outermost interior atoms of three captures, 51 % are farther than a tenth of a pitch from
it after one step, 16 % after two, and 7 % after three: these lie along creases."""

MIN_SLOPE = 0.5
"""Least slope of the depth in such a step, so that none is longer than twice the depth."""

BEHIND = 0.5
"""Pitches. Distance in front of or behind the skin from which an atom still covers it; the blended layer is thicker."""

DENSITY = 2.0
"""Points per squared pitch of skin that are tested for a hole, and so the most patches that a hole gets."""

CHUNK = 4096
"""Points that one call of the kernel handles."""

PATCH_SIGMA = 0.5
"""Pitches. Kernels of patches at this DENSITY then add up to 3."""

PATCH_THICKNESS = 0.2
"""Pitches. Sigma across the skin: patches are flat like it."""

CLOSED = 0.6
"""Sum of weights below which a point of the skin gets a patch: more than the half from which a pixel of the opaque
image is covered, so that no point between two tested ones falls below that."""

COLOURED_BY = 8
"""Nearest atoms that colour a patch: those around the hole."""


def inward_normals(body: Body, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, 3). Unit directions into the body at points (N, 3); zero on its medial axis."""
    slope = _slope(body, points)
    return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)


def project_onto_skin(body: Body, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, 3). The points of the skin below or above points (N, 3) that are close to it, by Newton's method."""
    feet = points.astype(np.float64)
    for _ in range(NEWTON_STEPS):
        slope = _slope(body, feet)
        squared = np.maximum((slope**2).sum(axis=1, keepdims=True), MIN_SLOPE**2)
        feet -= slope * body.at(feet)[:, None] / squared
    return feet


def _slope(body: Body, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, 3). Gradient of the depth at points (N, 3); its length is 1 except where the depth was smoothed."""
    step = np.eye(3) * body.grid.cell
    rise = np.stack([body.at(points + s) - body.at(points - s) for s in step], axis=1)
    return rise.astype(np.float64) / (2 * body.grid.cell)


def sample_skin(body: Body, spacing: float) -> NDArray[np.float64]:
    """(N, 3). Points on the skin, about one per spacing^2: the outer layer of a lattice, projected onto it."""
    low, high = body.bounds()
    axes = [np.arange(a - spacing / 2, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    parts = [np.zeros((0, 3))]
    for x in axes[0]:  # one layer at a time: memory follows the skin, not the box
        layer = np.stack(np.meshgrid([x], axes[1], axes[2], indexing="ij"), -1).reshape(-1, 3)
        depth = body.at(layer)
        parts.append(layer[(depth > 0) & (depth <= spacing)])
    return project_onto_skin(body, np.concatenate(parts))


def coverage_at(
    surface: SurfaceAtoms, points: NDArray[np.floating], normals: NDArray[np.floating], pitch: float
) -> Float:
    """(N,). Sum of the weights of the atoms at points of the skin (N, 3) with normals (N, 3).

    Atoms are widened by BEHIND across the skin; along it they keep their size, so that gaps show.
    """
    total = np.zeros(len(points), np.float32)
    if not len(surface) or not len(points):
        return total
    count = min(NEIGHBOURS, len(surface))
    rows = KDTree(surface.means).query(points, k=count, workers=cores())[1].reshape(-1, count)
    axes = np.ascontiguousarray(rotation_matrices(surface.quats))
    arrays = points, normals, rows, surface.means, axes, surface.scales
    for_each(_add_weights, -(-len(points) // CHUNK), *arrays, BEHIND * pitch, total)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def _add_weights(chunk, points, normals, rows, means, axes, scales, behind, total):
    """Writes one CHUNK of the sums (N,) of the kernels of the atoms in rows (N, K), widened by `behind` along the
    normals."""
    for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(points))):
        weight = 0.0
        for atom in rows[i]:
            q = 0.0
            for axis in range(3):
                local = across = 0.0
                for k in range(3):
                    local += axes[atom, k, axis] * (points[i, k] - means[atom, k])
                    across += axes[atom, k, axis] * normals[i, k]
                q += local * local / (scales[atom, axis] ** 2 + (behind * across) ** 2)
            weight += math.exp(-0.5 * q)
        total[i] = weight


def close_holes(surface: SurfaceAtoms, body: Body, pitch: float) -> SurfaceAtoms:
    """Flat atoms over holes between the surface atoms, in the colours of the atoms around.

    Where the capture is open (a missing bottom) they are the skin of the caps that close the body.
    """
    points = sample_skin(body, pitch / DENSITY**0.5)
    normals = -inward_normals(body, points)
    open_ = coverage_at(surface, points, normals, pitch) < CLOSED
    points, normals = points[open_], normals[open_]
    n = len(points)
    sigma = np.array([PATCH_SIGMA, PATCH_SIGMA, PATCH_THICKNESS]) * pitch
    sh = np.zeros((n, surface.sh.shape[1], 3), np.float32)
    if n and len(surface):
        count = min(COLOURED_BY, len(surface))
        distance, rows = KDTree(surface.means).query(points, k=count)
        weight = 1 / np.maximum(distance.reshape(n, -1), 1e-3 * pitch) ** 2
        near = surface.sh[rows.reshape(n, -1), 0]
        sh[:, 0] = np.einsum("nk,nkc->nc", weight / weight.sum(1, keepdims=True), near)
    return SurfaceAtoms(
        points.astype(np.float32), np.tile(sigma.astype(np.float32), (n, 1)), facing(normals).astype(np.float32), sh
    )
