"""A red velvet cake: four red sponges, three fillings and a coat of cream. Round, its axis upright."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sample_scenes.solids.noise import cells, fbm, mix, noise, step, store
from sample_scenes.solids.shapes import colours_at, depths_at
from sample_scenes.solids.solid import Solid

__all__ = ["cake"]

RADIUS, HALF, ROUND = 0.98, 0.60, 0.09
"""Radius, half height and radius of the edges, world units."""

COAT, FILLING, SPONGES = 0.062, 0.058, 4
"""Thickness of coat and fillings, world units, and how many sponges there are. The cake stands on its lowest sponge."""


def cake(seed: int = 0) -> Solid:
    """A red velvet cake, 2 units across; every seed gives a different one."""
    rng = np.random.default_rng([seed, 6])
    number = seed * 1000 + 1013
    room = 2 * HALF - COAT - 0.012 - FILLING * (SPONGES - 1)
    thick = rng.uniform(0.92, 1.08, SPONGES)
    thick *= room / thick.sum()
    # Lower and upper face of each sponge, from the bottom.
    floors = -HALF + 0.012 + np.concatenate([[0], np.cumsum(thick[:-1] + FILLING)])
    return Solid.of(
        "cake",
        ("radial",),
        lambda points: depths_at(points, _depths, number),
        lambda points: colours_at(points, _colours, floors, floors + thick, number),
    )


@njit(cache=True)
def _depth(x: float, y: float, z: float, number: int) -> float:
    """Depth in a rounded cylinder whose coat was spread by hand."""
    u = math.sqrt(x * x + y * y) - RADIUS + ROUND
    v = abs(z) - HALF + ROUND
    box = math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2) + min(max(u, v), 0.0) - ROUND
    return -box + 0.010 * noise(1.8 * x, 1.8 * y, 2.6 * z, number)


@njit(cache=True, nogil=True)
def _depths(
    start: int,
    stop: int,
    points: NDArray[np.float64],
    number: int,
    out: NDArray[np.float32],
) -> None:
    for i in range(start, stop):
        out[i] = _depth(points[i, 0], points[i, 1], points[i, 2], number)


@njit(cache=True)
def _cream(x: float, y: float, z: float, number: int) -> tuple[float, float, float]:
    soft = fbm(4 * x, 4 * y, 9 * z, 3, number + 1)
    return mix((0.948, 0.905, 0.81), (0.98, 0.952, 0.88), step(-0.6, 0.5, soft))


@njit(cache=True)
def _coat(x: float, y: float, z: float, number: int) -> tuple[float, float, float]:
    """Cream with the marks of the spatula, and red crumbs round the foot and over the middle of the top."""
    rgb = _cream(x, y, z, number)
    rho = math.sqrt(x * x + y * y)
    stroke = noise(2 * x, 2 * y, 17 * z, number + 2) if z < HALF - 0.03 else noise(14 * rho, 2 * x, 2 * y, number + 2)
    rgb = mix(rgb, (0.865, 0.80, 0.68), 0.5 * step(0.1, 0.7, stroke))
    torn = 0.35 * noise(25 * x, 25 * y, 25 * z, number + 12)
    near, _, name = cells(21 * x, 21 * y, 21 * z, 1.0, number + 3)
    near += torn
    crowd = step(-0.36, -0.56, z + 0.1 * noise(3 * x, 3 * y, 0.0, number + 4)) * step(-0.595, -0.57, z)
    if z > HALF - 0.06:
        crowd = step(0.62, 0.30, rho + 0.12 * noise(3 * x, 3 * y, 0.0, number + 5))
    crumb = step(0.42, 0.30, near) * step(1.0 - 0.9 * crowd, 1.02 - 0.9 * crowd, name)
    return mix(rgb, mix((0.42, 0.04, 0.05), (0.62, 0.09, 0.09), name), crumb)


@njit(cache=True)
def _sponge(x: float, y: float, z: float, number: int) -> tuple[float, float, float]:
    """Deep red crumb with fine pores, some larger ones, and lighter crumbs."""
    mottle = fbm(4 * x, 4 * y, 4 * z, 3, number + 6)
    rgb = mix((0.47, 0.05, 0.06), (0.62, 0.10, 0.10), step(-0.5, 0.5, mottle))
    warp = noise(8 * x, 8 * y, 8 * z, number + 7)
    for octave in range(2):
        f = 15.0 + 16.0 * octave
        near, far, name = cells(f * x + 0.5 * warp, f * y - 0.5 * warp, 1.25 * f * z, 1.0, number + 8 + 20 * octave)
        hole = step(0.50, 0.15, near + 0.25 * warp) * step(0.45, 0.7, name)
        rgb = mix(rgb, (0.27, 0.012, 0.03), (0.85 - 0.3 * octave) * hole)
        crumb = step(0.5, 0.2, near) * step(0.25, 0.05, name)
        rgb = mix(rgb, (0.76, 0.19, 0.17), 0.6 * crumb)
        rgb = mix(rgb, (0.70, 0.11, 0.11), 0.3 * step(0.15, 0.0, far - near))
    return rgb


@njit(cache=True, nogil=True)
def _colours(
    start: int,
    stop: int,
    points: NDArray[np.float64],
    floors: NDArray[np.float64],
    tops: NDArray[np.float64],
    number: int,
    out: NDArray[np.float32],
) -> None:
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d = max(_depth(x, y, z, number), 0.0)
        # Every face between sponge and cream has its own waves and a crumbly edge.
        rough = 0.006 * fbm(13 * x, 13 * y, 13 * z, 2, number + 9)
        rho = math.sqrt(x * x + y * y)
        side = RADIUS - rho - COAT - 0.010 * noise(2.5 * x, 2.5 * y, 2.5 * z, number + 10)
        inside = -9.0
        for n in range(len(floors)):
            wave = 0.013 * noise(1.9 * x, 1.9 * y, 11.0 * n, number + 11)
            swell = 0.013 * noise(1.9 * x, 1.9 * y, 11.0 * n + 5.0, number + 11)
            low = z - floors[n] - (wave if n > 0 else 0.0)
            inside = max(inside, min(low, tops[n] + swell - z))
        inside = min(inside, side) + rough
        rgb = _cream(x, y, z, number)
        # A blush of crumbs where the cream was pulled over the sponge.
        rgb = mix(rgb, (0.93, 0.74, 0.68), 0.55 * step(-0.014, 0.0, inside))
        if inside > -0.004:
            rgb = mix(rgb, _sponge(x, y, z, number), step(-0.003, 0.004, inside))
        if d < 0.03:
            rgb = mix(_coat(x, y, z, number), rgb, step(0.006, 0.03, d))
        store(out, i, rgb)
