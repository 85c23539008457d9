"""Synthetic 3DGS captures of solids: a closed shell of flat Gaussians, haze, floaters and Gaussians inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from engine.scene import sh
from engine.scene.camera import spread_directions
from engine.scene.gaussians import Gaussians
from engine.scene.rotations import rotation_matrices
from sample_scenes.solids import Solid

__all__ = ["LOOKS", "Look", "shell"]

Array = NDArray[np.float64]

OVERSAMPLE = 24
"""Skin samples per Gaussian: a fifth of its spacing apart, so that hardly any gap between them is missed."""

MAX_GAP = 0.95
"""Largest distance from a skin sample to the nearest nearly opaque Gaussian, in the Gaussian's in-plane standard
deviations: up to 1.18 a Gaussian is above half of its peak."""

NEARLY_OPAQUE = 0.8
"""Opacity from which a Gaussian counts for closing the shell; fainter ones only add to it."""

HAZE, FLOATERS, INSIDE = 0.03, 0.006, 12
"""Numbers of haze and floaters relative to the surface Gaussians, and the number of large Gaussians inside."""

LIGHT = np.array([0.40, -0.35, 0.85]) / np.linalg.norm([0.40, -0.35, 0.85])
"""Direction to the single soft lamp whose reflection the view-dependent colour encodes."""


@dataclass(frozen=True)
class Look:
    """Parameters of a synthetic capture."""

    count: int
    """Surface Gaussians."""
    degree: int
    """Degree of the spherical harmonics."""
    sheen: float
    """Brightness of the lamp's reflection, 0 for a dull skin."""


# A row takes 248 bytes at degree 3, 104 at 1, 68 at 0: with pictures, the three shipped scenes take seven megabytes.
LOOKS: dict[str, Look] = {
    "watermelon": Look(8000, 3, 0.30),
    "orange": Look(13000, 1, 0.16),
    "bread": Look(20000, 0, 0.0),
    "apple": Look(10000, 2, 0.30),
    "pomegranate": Look(12000, 1, 0.12),
    "cake": Look(16000, 0, 0.0),
}
"""How each solid is captured."""


def shell(solid: Solid, look: Look, rng: np.random.Generator) -> Gaussians:
    """The capture of a solid: `look.count` surface Gaussians and about four per cent of haze and floaters."""
    samples, normals, area = _samples(solid, OVERSAMPLE * look.count, rng)
    centres, spacing = _distribute(solid, samples, area, look.count, rng)
    quats, scales = _discs(solid.normals(centres), spacing, rng)
    tail = rng.random(look.count) < 0.12
    opacities = np.where(tail, 0.9 * rng.beta(4, 2, look.count), rng.uniform(0.9, 0.995, look.count))
    firm = opacities >= NEARLY_OPAQUE
    scales[firm] = _close_gaps(samples, centres[firm], quats[firm], scales[firm])
    rgb = _footprint_colour(solid, centres, quats, scales) + rng.normal(0, 0.008, (look.count, 3))
    surface = _gaussians(centres, scales, quats, opacities, rgb, look, solid.normals(centres))
    junk = _add_floaters(solid, samples, normals, float(np.median(spacing)), look, rng)
    order = rng.permutation(len(surface) + len(junk))
    return _concatenate(surface, junk)[order]


def _samples(solid: Solid, count: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Skin points (M, 3), their normals and the area each stands for (M,)."""
    rays = spread_directions(count)
    # A cone of solid angle w meets a skin at slant cosine c in area w r^2 / c; more rays where that is more, so that
    # the far corners of a loaf are sampled as densely as its sides.
    points = solid.skin_points(rays)
    area = (points**2).sum(1) / np.maximum((rays * solid.normals(points)).sum(1), 0.15)
    total = np.cumsum(area)
    rays = rays[np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])]
    rays += rng.normal(0, 1.5 / np.sqrt(count), (count, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = solid.skin_points(rays)
    return points, solid.normals(points), np.full(count, 4 * np.pi * area.mean() / count)


def _distribute(solid: Solid, samples: Array, area: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Centres (N, 3) on the skin, denser where its colour changes, and the width (N,) of the area each covers.

    This imitates training, which splits Gaussians where pictures have detail. Two rounds of weighted k-means space
    the centres evenly.
    """
    colours = solid.colour(samples).astype(np.float64)
    tree = cKDTree(samples)
    around = tree.query(samples, 9)[1]
    detail = colours[around].std(axis=1).mean(axis=1)
    weight = area * (0.6 + np.minimum(detail / detail.mean(), 3.0))
    # Stratified sampling, one draw in each of `count` equal parts of the total: no clumps along the spiral of samples.
    steps = (np.arange(count) + rng.random(count)) / count * weight.sum()
    centres = samples[np.minimum(np.searchsorted(np.cumsum(weight), steps), len(samples) - 1)]
    for _ in range(2):
        owner = cKDTree(centres).query(samples)[1]
        total = np.maximum(np.bincount(owner, weight, count), 1e-12)
        mean = np.stack([np.bincount(owner, weight * samples[:, c], count) for c in range(3)], axis=1) / total[:, None]
        mean = np.where((np.bincount(owner, minlength=count) > 0)[:, None], mean, centres)
        centres = solid.skin_points(mean / np.linalg.norm(mean, axis=1, keepdims=True))
    owner = cKDTree(centres).query(samples)[1]
    return centres, np.sqrt(np.maximum(np.bincount(owner, area, count), np.median(area)))


def _discs(normals: Array, spacing: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Quaternions (N, 4) and scales (N, 3) of flat Gaussians on the skin, turned at random, a little tilted."""
    n = len(normals)
    tilted = normals + rng.normal(0, 0.06, (n, 3))
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    helper = np.where(np.abs(tilted[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    e1 = np.cross(tilted, helper)
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    e2 = np.cross(tilted, e1)
    turn = rng.uniform(0, 2 * np.pi, (n, 1))
    axes = np.stack([np.cos(turn) * e1 + np.sin(turn) * e2, np.cos(turn) * e2 - np.sin(turn) * e1, tilted], axis=-1)
    stretch = np.exp(rng.normal(0, 0.22, n))
    size = 0.45 * spacing * np.exp(rng.normal(0, 0.15, n))
    thin = 0.10 * spacing * np.exp(rng.normal(0, 0.35, n))
    quats = Rotation.from_matrix(axes).as_quat(canonical=True, scalar_first=True)
    return quats, np.stack([size * stretch, size / stretch, thin], axis=1)


def _distance(samples: Array, centres: Array, quats: Array, scales: Array) -> tuple[Array, NDArray[np.intp]]:
    """In-plane standard deviations (M,) from each sample to the best of its 16 nearest Gaussians, and which it is."""
    near = cKDTree(centres).query(samples, 16)[1]
    best, which = np.full(len(samples), np.inf), np.zeros(len(samples), np.intp)
    axes = rotation_matrices(quats)
    for column in near.T:
        local = np.einsum("ni,nij->nj", samples - centres[column], axes[column])
        d = np.hypot(local[:, 0] / scales[column, 0], local[:, 1] / scales[column, 1])
        which = np.where(d < best, column, which)
        best = np.minimum(best, d)
    return best, which


def _close_gaps(samples: Array, centres: Array, quats: Array, scales: Array) -> Array:
    """Scales (N, 3), with the discs nearest to uncovered samples grown in-plane until they reach them."""
    for _ in range(10):
        distance, which = _distance(samples, centres, quats, scales)
        samples, which, distance = samples[distance > MAX_GAP], which[distance > MAX_GAP], distance[distance > MAX_GAP]
        if not len(samples):
            break
        grow = np.ones(len(centres))
        np.maximum.at(grow, which, distance / MAX_GAP)
        # At most by half per round, as a growing neighbour may cover the sample as well.
        scales = scales * np.minimum(grow, 1.5)[:, None] ** [1, 1, 0]
    return scales


def _footprint_colour(solid: Solid, centres: Array, quats: Array, scales: Array) -> Array:
    """(N, 3). Mean colour of the skin under each disc, from five points projected onto the skin."""
    axes = rotation_matrices(quats)
    total = 2.0 * solid.colour(centres)
    for axis in (0, 1):
        for side in (-0.5, 0.5):
            point = centres + side * scales[:, axis, None] * axes[:, :, axis]
            depth = solid.depth(point).astype(np.float64)
            total = total + solid.colour(point + depth[:, None] * solid.normals(point))
    return np.asarray(total, np.float64) / 6


def _gaussians(
    means: Array, scales: Array, quats: Array, opacities: Array, rgb: Array, look: Look, normals: Array | None
) -> Gaussians:
    """Gaussians with the lamp's reflection in the bands above degree 0, which keeps the skin's own colour."""
    coefficients = np.zeros((len(means), (look.degree + 1) ** 2, 3))
    coefficients[:, 0] = sh.rgb_to_sh(np.clip(rgb, 0.004, 0.996))
    if normals is not None and look.degree > 0:
        views = spread_directions(600)  # eye to Gaussian
        mirrored = views[None] - 2 * np.einsum("dk,nk->nd", views, normals)[..., None] * normals[:, None]
        glint = np.maximum(mirrored @ LIGHT, 0) ** 6 * np.clip(-4 * np.einsum("dk,nk->nd", views, normals), 0, 1)
        fit = np.linalg.pinv(sh.basis(views, look.degree))
        rest = np.einsum("kd,nd->nk", fit, glint)[:, 1:]
        # Warm white, weak enough that a dark skin does not become negative on the far side.
        coefficients[:, 1:] = look.sheen * rest[..., None] * np.array([1.0, 0.98, 0.92])
    arrays = (means, scales, quats, opacities, coefficients)
    return Gaussians(*(np.ascontiguousarray(a, np.float32) for a in arrays))


def _add_floaters(
    solid: Solid, samples: Array, normals: Array, spacing: float, look: Look, rng: np.random.Generator
) -> Gaussians:
    """Haze around the skin, floaters off it, and a few large Gaussians inside that no camera saw."""
    haze, floaters = int(HAZE * look.count), int(FLOATERS * look.count)
    at = rng.integers(len(samples), size=haze + floaters + INSIDE)
    lift = np.concatenate(
        [rng.uniform(-0.06, 0.03, haze), rng.uniform(0.04, 0.4, floaters), -rng.uniform(0.3, 0.55, INSIDE)]
    )
    size = np.concatenate(
        [
            spacing * np.exp(rng.normal(0.9, 0.35, haze)),
            spacing * np.exp(rng.normal(-1.0, 0.4, floaters)),
            rng.uniform(0.08, 0.16, INSIDE),
        ]
    )
    opacities = np.concatenate(
        [rng.uniform(0.02, 0.1, haze), rng.uniform(0.05, 0.5, floaters), rng.uniform(0.3, 0.9, INSIDE)]
    )
    grey = np.concatenate([np.full(haze, 0.1), np.full(floaters, 0.6), np.full(INSIDE, 0.3)])[:, None]
    rgb = solid.colour(samples[at]) * (1 - grey) + grey * rng.uniform(0.2, 0.8, (len(at), 1))
    scales = size[:, None] * np.exp(rng.normal(0, 0.3, (len(at), 3)))
    quats = rng.normal(size=(len(at), 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return _gaussians(samples[at] + lift[:, None] * normals[at], scales, quats, opacities, rgb, look, None)


def _concatenate(a: Gaussians, b: Gaussians) -> Gaussians:
    return Gaussians(
        np.concatenate([a.means, b.means]),
        np.concatenate([a.scales, b.scales]),
        np.concatenate([a.quats, b.quats]),
        np.concatenate([a.opacities, b.opacities]),
        np.concatenate([a.sh, b.sh]),
    )
