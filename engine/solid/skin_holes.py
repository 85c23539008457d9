"""Where the atoms of a skin leave holes, and patches over them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from engine.scene.atoms import SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.scene.rotations import matrices

__all__ = ["coverage_at", "inwards", "patches", "skin_points"]

Float = NDArray[np.float32]

NEIGHBOURS = 24
"""Nearest atoms that are asked whether they cover a point: more than overlap anywhere on a usual skin."""

BEHIND = 0.5
"""Pitches. An atom covers a point of the skin from as far before or behind it: the layer that is blended is thicker."""

DENSITY = 2.0
"""Points of the skin a squared pitch at which holes are looked for, and so the most patches that a hole gets."""

PATCH_SIGMA = 0.5
"""Pitches. Patches DENSITY apart then overlap to a sum of 3."""

PATCH_THICKNESS = 0.2
"""Pitches. Flat, as the skin is."""

COVERED = 0.7
"""Greatest weight of an atom at a point of the skin from which it shows no hole: a pixel has its depth from atoms that
are half their height there (CORE_Q), and the points asked stand apart. Several faint ones may add up to
a colour, but what stands behind them would show through."""


def inwards(body: Body, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, 3). Unit direction into the body at points (N, 3); zero on its medial axis."""
    step = np.eye(3) * body.grid.cell
    slope = np.stack([body.at(points + s) - body.at(points - s) for s in step], axis=1).astype(np.float64)
    return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)


def skin_points(body: Body, spacing: float) -> NDArray[np.float64]:
    """(N, 3). Points on the skin, about one on each spacing^2 of it: the feet of a lattice's outer layer."""
    low, high = body.bounds()
    axes = [np.arange(a - spacing / 2, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    parts = [np.zeros((0, 3))]
    for x in axes[0]:  # one layer at a time: memory follows the skin, not the box
        layer = np.stack(np.meshgrid([x], axes[1], axes[2], indexing="ij"), -1).reshape(-1, 3)
        depth = body.at(layer)
        parts.append(layer[(depth > 0) & (depth <= spacing)])
    points = np.concatenate(parts)
    for _ in range(2):
        points = points - inwards(body, points) * body.at(points)[:, None]
    return points


def coverage_at(
    surface: SurfaceAtoms, points: NDArray[np.floating], normals: NDArray[np.floating], pitch: float
) -> Float:
    """(N,). Greatest weight of an atom at points of the skin (N, 3) with normals (N, 3), seen along the normals.

    Across the skin an atom counts as BEHIND thicker than it is; along it as large as it is, so that gaps show.
    """
    if not len(surface) or not len(points):
        return np.zeros(len(points), np.float32)
    count = min(NEIGHBOURS, len(surface))
    rows = KDTree(surface.means).query(points, k=count)[1].reshape(-1, count)
    axes = matrices(surface.quats)
    most = np.zeros(len(points), np.float32)
    for neighbour in rows.T:
        frame = axes[neighbour]
        across = np.einsum("nij,ni->nj", frame, normals)
        local = np.einsum("nij,ni->nj", frame, points - surface.means[neighbour])
        variance = surface.scales[neighbour] ** 2 + (BEHIND * pitch * across) ** 2
        most = np.maximum(most, np.exp(-0.5 * (local**2 / variance).sum(1)).astype(np.float32))
    return most


def patches(
    surface: SurfaceAtoms,
    gaussians: Gaussians,
    body: Body,
    pitch: float,
    opacity: Float,  # opacity field of the Gaussians on the body's grid
    least: float,
) -> SurfaceAtoms:
    """Flat atoms over the holes of the skin where the capture itself has one, at least `least` opaque.

    Where it has none (an open bottom) nothing is added. A patch has the mean colour of the Gaussians around it.
    """
    points = skin_points(body, pitch / DENSITY**0.5)
    normals = -inwards(body, points)
    around = [body.grid.sample(opacity, points + step * body.grid.cell * normals) for step in (-1, 0, 1)]
    there = np.max(around, axis=0) >= least
    points, normals = points[there], normals[there]
    bare = coverage_at(surface, points, normals, pitch) < COVERED
    points, normals = points[bare], normals[bare]
    n = len(points)
    # The half turn about the middle between z and the normal takes one to the other.
    half = normals + np.where(normals[:, 2:] < -0.999, [1.0, 0, 1], [0.0, 0, 1])
    quats = np.column_stack([np.zeros(n), half / np.linalg.norm(half, axis=1, keepdims=True)])
    sigma = np.array([PATCH_SIGMA, PATCH_SIGMA, PATCH_THICKNESS]) * pitch
    sh = np.zeros((n, surface.sh.shape[1], 3), np.float32)
    if n and len(gaussians):
        count = min(NEIGHBOURS, len(gaussians))
        distance, rows = KDTree(gaussians.means).query(points, k=count)
        distance, rows = distance.reshape(n, -1), rows.reshape(n, -1)
        reach = gaussians.scales[rows].max(-1) + pitch / 2
        weight = gaussians.opacities[rows] * np.exp(-0.5 * (distance / reach) ** 2) + 1e-9
        sh[:, 0] = np.einsum("nk,nkc->nc", weight / weight.sum(1, keepdims=True), gaussians.sh[rows, 0])
    return SurfaceAtoms(
        points.astype(np.float32), np.tile(sigma.astype(np.float32), (n, 1)), quats.astype(np.float32), sh
    )
