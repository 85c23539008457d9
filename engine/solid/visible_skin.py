"""The body out to the front that its atoms show, so that what fills it ends where it is seen to end."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from engine.scene.atoms import SurfaceAtoms
from engine.scene.constants import CORE_Q
from engine.scene.grid import Body
from engine.scene.rotations import rotation_matrices
from engine.solid.signed_distance import redistance
from engine.solid.skin_cover import inward_normals, project_onto_skin, sample_skin
from engine.threads import cores, for_spans

__all__ = ["front_heights", "out_to_front"]

REACH = 1.5
"""Pitches. How far from the skin its front is looked for: what is farther out is another thing, such as a leaf."""

LAYER = 0.75
"""Pitches. Atoms no deeper than this below the outermost one are the front's layer, whose mean is its height. The
outermost one itself stands out of a layer of tilted discs: by a third of a pitch from the drawn skin of a melon, which
costs cuts 1.2 dB."""

STEPS = 2
"""Steps towards the front: where the skin bends away from it, the first one overshoots. At standard, five captures are
0.12 to 0.41 pitches from it in the mean, 0.05 to 0.25 after one step, 0.03 to 0.15 after two."""

STILL = 0.1
"""Pitches. Mean distance to the front up to which the skin is left as it is. At standard, that of two scanned fruits is
0.01, of the samples' drawn captures 0.09 at most."""

NEIGHBOURS = 48
"""Nearest atoms among which a point's front is looked for. With half as many, 6 % of the points of three captures have
another one than with 192; with these, 1 %."""

AROUND = 12
"""Points around a point of the skin, up to a pitch away, whose median is the height of its front: single atoms stand
out of a skin. With twice as many, faces are as even as with these."""

MIXED = 4
"""Nearest points of the skin between which a cell's height is interpolated."""

BAND = 2.0
"""Cells beyond that reach whose depth follows the moved skin; farther away, it is measured from it anew."""


def out_to_front(body: Body, surface: SurfaceAtoms, pitch: float) -> Body:
    """The body with its skin moved to the front that a picture of the atoms shows.

    The skin of a capture has several layers, and thick Gaussians: the mean of their tangent planes, where the body
    ends, lies below what is seen. In a cut that would be a gap, or a stain in the colours of the layers within. Where
    nothing is seen within REACH, the skin stays, and no part of the body is lost.
    """
    enclosed = body
    for _ in range(STEPS):
        points = sample_skin(body, pitch / np.sqrt(2))
        if not len(points) or not len(surface):
            break
        heights = _smoothed(points, front_heights(surface, points, -inward_normals(body, points), pitch))
        if np.abs(heights).mean() <= STILL * pitch:
            break
        body = _moved(body, points, heights, pitch)
    return body if body is enclosed else _joined(enclosed, body.depth)


def _joined(body: Body, depth: NDArray[np.float32]) -> Body:
    """The body and what another depth (X, Y, Z) adds to it, without what does not touch it: thin parts do not crumble,
    and nothing hangs in the air."""
    level = np.maximum(body.depth, depth)
    regions, _ = ndimage.label(level > 0)
    touching = np.zeros(regions.max() + 1, bool)
    touching[regions[body.inside]] = True
    return Body(body.grid, np.where(touching[regions] | (level <= 0), level, -level))


def front_heights(
    surface: SurfaceAtoms, points: NDArray[np.float64], normals: NDArray[np.float64], pitch: float
) -> NDArray[np.float64]:
    """(N,). Height of the front over points (N, 3), world units: of the LAYER below the outermost atom, within REACH on
    either side, that a line of sight against the unit normal (N, 3) meets near its mean (CORE_Q). nan where it meets
    none."""
    count = min(NEIGHBOURS, len(surface))
    rows = KDTree(surface.means).query(points, k=count, workers=cores())[1].reshape(-1, count)
    axes = np.ascontiguousarray(rotation_matrices(surface.quats))
    heights = np.full(len(points), np.nan)
    arrays = points, normals, rows, surface.means, axes, surface.scales
    for_spans(_find_fronts, len(points), *arrays, REACH * pitch, LAYER * pitch, heights)
    return heights


@njit(cache=True, nogil=True, error_model="numpy")
def _find_fronts(start, stop, points, normals, rows, means, axes, scales, reach, layer, heights):
    """Fills a span of `front_heights` from the atoms in rows (N, K)."""
    height, q = np.empty(rows.shape[1]), np.empty(rows.shape[1])
    for i in range(start, stop):
        best = -np.inf
        count = 0
        for atom in rows[i]:
            # Products of the normal and of the way from the atom's mean to the point, in its standard deviations.
            nn = nd = dd = 0.0
            for axis in range(3):
                n = d = 0.0
                for k in range(3):
                    n += axes[atom, k, axis] * normals[i, k]
                    d += axes[atom, k, axis] * (points[i, k] - means[atom, k])
                sigma = max(scales[atom, axis], 1e-3 * reach)
                nn += (n / sigma) ** 2
                nd += (n / sigma) * (d / sigma)
                dd += (d / sigma) ** 2
            height[count] = -nd / nn  # where the line comes closest to the atom's mean
            q[count] = dd - nd * nd / nn
            if abs(height[count]) <= reach:
                if q[count] <= CORE_Q:
                    best = max(best, height[count])
                count += 1
        if best > -np.inf:
            total = weights = 0.0
            for k in range(count):
                if height[k] >= best - layer:
                    weight = math.exp(-0.5 * q[k])
                    weights += weight
                    total += weight * height[k]
            heights[i] = total / weights


def _smoothed(points: NDArray[np.float64], heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,). Medians of the heights (N,) around points (N, 3), without those that are nan; 0 where all are."""
    count = min(AROUND, len(points))
    around = KDTree(points).query(points, k=count, workers=cores())[1].reshape(-1, count)
    near = np.sort(heights[around], axis=1)  # nan comes last
    known = np.isfinite(near).sum(axis=1)
    middle = np.take_along_axis(near, np.maximum(known - 1, 0)[:, None] // 2, axis=1)[:, 0]
    return np.where(known > 0, middle, 0.0)


def _moved(body: Body, points: NDArray[np.float64], heights: NDArray[np.float64], pitch: float) -> Body:
    """The body with the points (N, 3) of its skin moved outwards by heights (N,)."""
    cell = body.grid.cell
    near = np.abs(body.depth) < REACH * pitch + BAND * cell
    centres = body.grid.centres_of(near)
    feet = project_onto_skin(body, centres)
    count = min(MIXED, len(points))
    away, rows = (found.reshape(-1, count) for found in KDTree(points).query(feet, k=count, workers=cores()))
    weight = 1 / (away + 0.1 * pitch)
    # Measured from the foot: the depth of a body is not as steep as a distance everywhere.
    distance = np.linalg.norm(centres - feet, axis=1)
    level = body.depth.copy()
    level[near] = np.where(body.depth[near] > 0, distance, -distance) + np.average(heights[rows], 1, weight)
    return Body(body.grid, redistance(level / np.float32(cell)) * np.float32(cell))
