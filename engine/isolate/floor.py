"""Finds the plane that the object of a capture stands on or leans against: a table, a mat, a wall.

`engine.solid.up_axis.support_plane` finds it as evidence of which way is up, from points and not from Gaussians: the
plane here is to cut the floor off, so it is where the floor ends.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from engine.scene.gaussians import Gaussians
from engine.scene.plane import Plane, frame
from engine.scene.rotations import normalised_quats, rotation_matrices
from engine.solid.denoise_capture import HAZE_OPACITY, haze_and_fragments

__all__ = ["BAND", "best_plane", "find_floor", "sample_skin"]

SAMPLES = 6000
"""Points of the skin, spread by area: a share of 5 % is then known to 0.3 %."""

CANDIDATES = 600
"""Planes that are tried, half of them along flat Gaussians, half through three points. A floor with a fifth of the
skin contains 0.8 % of all triples and a fifth of all Gaussians: it is met some sixty times."""

BAND = 0.012
"""Half the thickness of a floor, in sizes of the capture: mats and cloths are that uneven."""

LEAST_FLOOR = 0.06
LEAST_OBJECT = 0.01
"""Least shares of the skin on the plane and above it. With less on it, the plane is a foot. An object on a table eight
times as wide has 3 %; with less above, the plane is the object, as with a lone leaf or mat."""

MOST_BELOW = 0.1
"""Most skin below a floor, as a share: table legs, the underside of a mat."""

NEAR = 0.2
"""Height above the plane, in sizes of the capture, within which the object's foot is sought."""

SECTORS = 16
"""Directions around the middle of the floor in which its edge is examined."""

EDGE = 0.8
"""Share of the floor's radius in a direction beyond which its edge lies."""

COVERED = 0.2
"""Skin above the edge, relative to the floor's own there, from which the object covers it: the side of a box or a pot
has several times as much, specks above a table a hundredth."""

FREE = 0.25
"""Least share of the edge that is free around a floor: half of it in the corner of a room, none around the foot of a
pot."""

LIFT = 4.0
"""Robust standard deviations of the floor's Gaussians by which the plane is raised, so that it contains them: at 2.5
specks of a printed mat stay, at 6 nothing more goes but the foot of the object."""


def find_floor(gaussians: Gaussians) -> Plane | None:
    """The plane just above a capture's floor, with n.x + d <= 0 on the floor and below it; None if there is no floor.

    The floor is the plane with the most skin on it that leaves nearly all the rest on one side and that reaches beyond
    the foot of what stands on it: every object has a flat base or a broad side, but only a floor has a free edge. A
    wall that the object leans against counts too. The same capture gives the same plane, whatever its units.
    """
    haze, fragments = haze_and_fragments(gaussians)
    plain = replace(gaussians, sh=gaussians.sh[:, :1])  # a large capture's colours need not be copied
    skin = plain[~haze & ~fragments & (gaussians.opacities >= HAZE_OPACITY)]
    if len(skin) < 100:
        return None
    rng = np.random.default_rng(0)
    points, flats = sample_skin(skin, rng)
    size = float((np.percentile(points, 95, axis=0) - np.percentile(points, 5, axis=0)).max())
    if not size > 0:
        return None
    band = BAND * size
    plane = best_plane(points, flats, band, rng)
    for _ in range(5):  # least squares through what is on it
        if plane is None:
            return None
        near = np.abs(plane.distance(points)) <= band
        plane = _fitted(points[near], plane.normal)
    if plane is None or not _is_floor(points, plane, band, size):
        return None
    heights = plane.distance(points)
    spread = 1.4826 * float(np.median(np.abs(heights[np.abs(heights) <= 2 * band])))
    return Plane(plane.normal, plane.offset - min(LIFT * spread, 2 * band))


def sample_skin(skin: Gaussians, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (SAMPLES, 3) drawn by area, and the normals (SAMPLES, 3) of their Gaussians: the thinnest axes."""
    sizes = np.sort(skin.scales.astype(np.float64), axis=1)
    area = sizes[:, 1] * sizes[:, 2] * skin.opacities
    area = np.minimum(area, np.percentile(area, 99))  # a few huge ones must not stand for all
    rows = rng.choice(len(skin), SAMPLES, p=area / area.sum())
    axes = rotation_matrices(normalised_quats(skin.quats[rows]))
    normals = np.take_along_axis(axes, skin.scales[rows].argmin(1)[:, None, None], 2)[..., 0]
    return skin.means[rows].astype(np.float64), np.asarray(normals, np.float64)


def best_plane(
    points: NDArray[np.float64], normals: NDArray[np.float64], band: float, rng: np.random.Generator
) -> Plane | None:
    """Of the candidates with nearly all other points on one side, the one with the most points on it, or None."""
    half = CANDIDATES // 2
    single = rng.choice(len(points), half, replace=False)
    triples = points[rng.choice(len(points), (half, 3))]
    across = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(across, axis=1)
    proper = length > 1e-12 * np.abs(points).max() ** 2
    normal = np.concatenate([normals[single], across[proper] / length[proper, None]])
    foot = np.concatenate([points[single], triples[proper, 0]])
    heights = points @ normal.T - (foot * normal).sum(1)  # [samples, candidates]
    on = (np.abs(heights) <= band).mean(0)
    above, below = (heights > band).mean(0), (heights < -band).mean(0)
    on[np.minimum(above, below) > MOST_BELOW] = 0.0
    best = int(on.argmax())
    if on[best] < LEAST_FLOOR:
        return None
    up = normal[best] if above[best] >= below[best] else -normal[best]
    return Plane.through(foot[best], up)


def _fitted(points: NDArray[np.float64], up: tuple[float, float, float]) -> Plane | None:
    """The least-squares plane through points (N, 3), its normal towards `up`; None for fewer than three."""
    if len(points) < 3:
        return None
    centre = points.mean(0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    return Plane.through(centre, normal if normal @ np.asarray(up) >= 0 else -normal)


def _is_floor(points: NDArray[np.float64], plane: Plane, band: float, size: float) -> bool:
    """Whether the plane carries an object and extends around its foot."""
    heights = plane.distance(points)
    on = np.abs(heights) <= band
    foot = (heights > 2 * band) & (heights <= NEAR * size)
    shares = on.mean() >= LEAST_FLOOR and (heights > band).mean() >= LEAST_OBJECT
    if not shares or (heights < -band).mean() > MOST_BELOW or foot.sum() < 20:
        return False
    e1, e2, _ = frame(plane.normal)
    flat = np.stack([points @ e1, points @ e2], 1)
    flat -= flat[on].mean(0)
    radius = np.linalg.norm(flat, axis=1)
    sector = ((np.arctan2(flat[:, 1], flat[:, 0]) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    free = 0
    for direction in range(SECTORS):
        here = sector == direction
        if (here & on).any():
            edge = here & (radius > EDGE * np.percentile(radius[here & on], 95))
            free += (edge & foot).sum() < COVERED * (edge & on).sum()
    return bool(free >= FREE * SECTORS)
