"""Grows a selection to everything that touches it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from engine.scene.gaussians import Gaussians
from engine.scene.rotations import normalised_quats, rotation_matrices
from engine.solid.denoise_capture import HAZE_OPACITY, haze_and_fragments

__all__ = ["grow"]

NEIGHBOURS = 12
"""Nearest centres that are examined: on a surface a Gaussian has about six around it, and as many on its other side if
the surface is a sheet."""

REACH = 2.0
"""Standard deviations to which a Gaussian reaches: there it has 14 % of its opacity left, the faintest skin that a
picture shows."""

BLOCK = 1 << 15
"""Gaussians whose neighbours are looked up at a time, which keeps the memory of that step below 100 MB."""


def grow(gaussians: Gaussians, selected: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,). The selected Gaussians and all that touch them, directly or through others.

    Two Gaussians touch if their ellipsoids of REACH standard deviations meet along the line between their centres. Haze
    and Gaussians fainter than HAZE_OPACITY are carried along by what they touch, but carry nothing along: they reach
    everywhere.
    """
    if not selected.any() or selected.all():
        return selected
    haze, _ = haze_and_fragments(gaussians)
    solid = ~haze & (gaussians.opacities >= HAZE_OPACITY)
    rows = np.flatnonzero(solid)
    if not len(rows):
        return selected
    tree = cKDTree(gaussians.means[rows])
    spread = _covariances(gaussians)
    first, second = [], []
    for start in range(0, len(gaussians), BLOCK):
        block = np.arange(start, min(start + BLOCK, len(gaussians)))
        a, b = _touching(gaussians.means, spread, block, rows, tree)
        faint = ~solid[a]  # leaves of the graph: each hangs on the nearest that it touches
        _, nearest = np.unique(a[faint], return_index=True)
        first += [a[~faint], a[faint][nearest]]
        second += [b[~faint], b[faint][nearest]]
    a, b = np.concatenate(first), np.concatenate(second)
    count = len(gaussians)
    graph = coo_matrix((np.ones(len(a), bool), (a, b)), (count, count))
    _, group = connected_components(graph, directed=False)
    reached = np.zeros(group.max() + 1, bool)
    reached[group[selected & solid]] = True
    return selected | reached[group]


def _touching(
    means: NDArray[np.float32],  # [N, 3]
    spread: NDArray[np.float64],  # [N, 6]
    block: NDArray[np.integer],
    rows: NDArray[np.integer],
    tree: cKDTree,
) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
    """Touching pairs (P,), (P,), one of `block` and one of `rows`, in the order of the block, then of distance."""
    _, near = tree.query(means[block], k=min(NEIGHBOURS + 1, len(rows)))
    near = rows[near.reshape(len(block), -1)]
    a, b = np.repeat(block, near.shape[1]), near.ravel()
    different = a != b
    a, b = a[different], b[different]
    x, y, z = (means[b].astype(np.float64) - means[a]).T
    squares = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], 1)
    # Standard deviations along the line, times its length: |d| <= REACH (s_a + s_b) without a division.
    reach = sum(np.sqrt(np.maximum((squares * spread[rows]).sum(1), 0)) for rows in (a, b))
    meets = x * x + y * y + z * z <= REACH * reach
    return a[meets], b[meets]


def _covariances(gaussians: Gaussians) -> NDArray[np.float64]:
    """(N, 6). xx, yy, zz, xy, xz, yz of each Gaussian's covariance, world units squared."""
    axes = rotation_matrices(normalised_quats(gaussians.quats)) * gaussians.scales[:, None, :]
    x, y, z = axes.transpose(1, 0, 2)
    return np.stack([(a * b).sum(1) for a, b in ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))], 1)
