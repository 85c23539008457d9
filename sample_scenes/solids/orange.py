"""An orange: pored peel, white pith, segments in thin membranes, long juice sacs, a white core and a few seeds."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sample_scenes.solids.noise import cells, fbm, mix, noise, smin, step, store
from sample_scenes.solids.shapes import (
    ItemGrid,
    colours_at,
    depths_at,
    index_items,
    item_at,
    rotated_frame,
    round_depth,
    round_depths,
    round_shape,
)
from sample_scenes.solids.solid import Solid

__all__ = ["orange"]

TIP = 0.6
"""How pointed a seed is (`shapes.teardrop`)."""

PEEL = 0.026
"""Thickness of the coloured peel, world units."""

MEMBRANE = 0.008
"""Half thickness of the wall between two segments, world units."""


def orange(seed: int = 0) -> Solid:
    """An orange, 2 units across, with 9 to 11 segments; every seed gives a different one."""
    rng = np.random.default_rng([seed, 2])
    shape = round_shape(
        (1.0, 0.98, 0.93 * rng.uniform(0.97, 1.03)),
        0.018,
        1.5,
        seed + 40,
        top=(0.05, 0.22),
        bottom=(0.018, 0.16),
    )
    count = int(rng.choice([9, 10, 10, 11]))
    width = rng.uniform(0.78, 1.22, count)
    walls = -np.pi + 2 * np.pi * np.cumsum(width) / width.sum() - rng.uniform(0, 0.6)
    rows, starts, items = _seeds(walls, rng)
    number = seed * 1000 + 211
    return Solid.of(
        "orange",
        ("horizontal", "radial"),
        lambda points: depths_at(points, round_depths, shape),
        lambda points: colours_at(points, _colours, shape, walls, rows, starts, items, number),
    )


def _seeds(walls: NDArray[np.float64], rng: np.random.Generator) -> ItemGrid:
    """One or two seeds in about half of the segments, beside the core, tips to it."""
    centres, frames, halves = [], [], []
    for i, wall in enumerate(walls):
        span = (walls[(i + 1) % len(walls)] - wall) % (2 * np.pi)
        for side in (-1.0, 1.0):
            if rng.random() > 0.42:
                continue
            angle = wall + span * (0.5 + 0.08 * rng.normal())
            rho, z = rng.uniform(0.25, 0.32), side * rng.uniform(0.02, 0.28)
            out = np.array([math.cos(angle), math.sin(angle), 0.0])
            axis = -out + np.array([0, 0, -0.9 * side]) + rng.normal(0, 0.1, 3)
            centres.append(out * rho + [0, 0, z])
            frames.append(rotated_frame(axis / np.linalg.norm(axis), angle))
            halves.append(rng.uniform(0.85, 1.1) * np.array([0.095, 0.05, 0.045]))
    return index_items(np.reshape(centres, (-1, 3)), frames, np.reshape(halves, (-1, 3)), np.zeros(len(centres)))


@njit(cache=True)
def _peel(x: float, y: float, z: float, number: int) -> tuple[float, float, float]:
    """Glossy orange, mottled, with a pit over every oil gland and a small brown-green button at the top."""
    rgb = mix((0.93, 0.44, 0.035), (0.985, 0.58, 0.09), step(-0.5, 0.5, fbm(2.2 * x, 2.2 * y, 2.2 * z, 3, number)))
    near, _, name = cells(30 * x, 30 * y, 30 * z, 0.85, number + 1)
    rgb = mix(rgb, (0.84, 0.35, 0.02), (0.25 + 0.3 * name) * step(0.48, 0.12, near))
    rho = math.sqrt(x * x + y * y)
    if z > 0:
        rgb = mix(rgb, (0.62, 0.52, 0.12), 0.6 * step(0.22, 0.06, rho + 0.03 * noise(9 * x, 9 * y, 0.0, number + 2)))
        rgb = mix(rgb, (0.34, 0.30, 0.13), step(0.062, 0.045, rho + 0.012 * noise(20 * x, 20 * y, 0.0, number + 3)))
    else:
        rgb = mix(rgb, (0.74, 0.40, 0.08), 0.7 * step(0.06, 0.02, rho))
    return rgb


@njit(cache=True)
def _pulp(rho: float, angle: float, z: float, number: int, segment: float) -> tuple[float, float, float]:
    """Juice sacs: long cells that run from the core to the pith and fan out towards the poles, each of its own tint."""
    fan = z / (rho + 0.55)
    warp = 0.5 * noise(4 * rho, 7 * angle, 7 * fan, number + 4)
    near, far, name = cells(
        3.0 * rho + warp + 5 * segment, 11.5 * angle + 0.7 * warp, 13 * fan - warp + 17 * segment, 1.0, number + 5
    )
    rgb = mix((0.96, 0.51, 0.06), (0.99, 0.645, 0.14), name)
    rgb = mix(rgb, (0.94, 0.45, 0.035), 0.5 * step(0.6, 0.1, near))
    # The wall of a sac catches the light, more in some places than in others.
    shine = 0.3 + 0.35 * step(-0.5, 0.5, noise(6 * rho, 9 * angle, 9 * fan, number + 13))
    rgb = mix(rgb, (1.0, 0.78, 0.34), shine * step(0.17, 0.0, far - near))
    cloud = fbm(3 * rho, 5 * angle, 5 * fan, 2, number + 6)
    return mix(rgb, (0.985, 0.70, 0.25), 0.35 * step(0.0, 0.8, cloud))


@njit(cache=True, nogil=True)
def _colours(
    start: int,
    stop: int,
    points: NDArray[np.float64],
    shape: NDArray[np.float64],
    walls: NDArray[np.float64],
    rows: NDArray[np.float64],
    starts: NDArray[np.int64],
    items: NDArray[np.int64],
    number: int,
    out: NDArray[np.float32],
) -> None:
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d = max(round_depth(x, y, z, shape), 0.0)
        rho = math.sqrt(x * x + y * y) + 1e-9
        # Pith: thicker at the poles, uneven everywhere.
        uneven = fbm(2.5 * x, 2.5 * y, 2.5 * z, 2, number + 7)
        pole = (abs(z) / math.sqrt(rho * rho + z * z + 1e-12)) ** 6
        pith = d - (0.082 + 0.10 * pole + 0.014 * uneven)
        # The core is a pith column, wider towards the poles, not quite straight.
        cx = 0.03 * noise(1.5 * z, 0.0, 0.0, number + 8)
        cy = 0.03 * noise(1.5 * z, 9.0, 0.0, number + 9)
        dx, dy = x - cx, y - cy
        inner = math.sqrt(dx * dx + dy * dy)
        core = inner - (0.055 + 0.05 * abs(z) + 0.015 * noise(3 * x, 3 * y, 3 * z, number + 10))
        # Walls fan out from the core; they bend a little with height and radius.
        angle = math.atan2(dy, dx)
        bent = (
            angle
            + 0.07 * noise(0.9 * inner, 1.1 * z, 4.0, number + 11)
            + 0.035 * noise(2.6 * x, 2.6 * y, 2.6 * z, number + 12)
        )
        wall, segment = 9.0, 0
        for n in range(len(walls)):
            turn = abs((bent - walls[n] + math.pi) % (2 * math.pi) - math.pi)
            reach = inner * math.sin(min(turn, math.pi / 2))
            wall = min(wall, reach)
            ahead = (bent - walls[n]) % (2 * math.pi)
            if ahead < (walls[(n + 1) % len(walls)] - walls[n]) % (2 * math.pi):
                segment = n
        # Rounded where wall, pith and core meet: a segment has no sharp corners.
        room = smin(smin(wall - MEMBRANE, pith, 0.075), core, 0.05)
        rgb = mix((0.985, 0.90, 0.70), (0.99, 0.955, 0.86), step(-0.4, 0.5, uneven))
        rgb = mix(rgb, (0.995, 0.83, 0.52), step(0.022, 0.0, -room) * step(0.14, 0.10, -pith) * 0.65)
        if room > -0.006:
            rgb = mix(rgb, _pulp(inner, angle, z, number, float(segment)), step(-0.003, 0.004, room))
            rgb = mix(rgb, (0.995, 0.72, 0.28), 0.45 * step(0.022, 0.003, room) * step(-0.003, 0.003, room))
            q, _ = item_at(x, y, z, TIP, rows, starts, items)
            if q < 1.5 and room > 0:
                rgb = mix(rgb, (0.86, 0.50, 0.10), 0.5 * step(1.5, 1.05, q))
                rgb = mix(rgb, mix((0.90, 0.80, 0.55), (0.975, 0.93, 0.78), step(0.95, 0.5, q)), step(1.1, 0.95, q))
        if d < PEEL + 0.03:
            glands, _, _ = cells(30 * x, 30 * y, 30 * z, 0.85, number + 1)
            zest = mix((0.97, 0.60, 0.10), (0.93, 0.47, 0.04), step(0.45, 0.2, glands))
            zest = mix(_peel(x, y, z, number), zest, step(0.004, 0.012, d))
            rgb = mix(zest, rgb, step(PEEL - 0.006, PEEL + 0.010, d + 0.006 * uneven - 0.008 * step(0.4, 0.15, glands)))
        store(out, i, rgb)
