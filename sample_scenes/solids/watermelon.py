"""A watermelon: striped skin, pale rind, red flesh, black seeds that point to the axis."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.scene.camera import spread_directions
from sample_scenes.solids.noise import cells, fbm, mix, noise, step, store
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

__all__ = ["watermelon"]

SEEDS = 330
"""Number of seeds: about a dozen show on a horizontal cut, as in a seeded melon."""

SPACING = 0.098
"""Least distance between two seeds; they never touch."""

TIP = 0.55
"""How pointed a seed is (`shapes.teardrop`)."""


def watermelon(seed: int = 0) -> Solid:
    """A watermelon, 2 units long; every seed gives a different one."""
    rng = np.random.default_rng([seed, 1])
    stretch = rng.uniform(0.97, 1.03)
    shape = round_shape((0.82 * stretch, 0.8, 1.0), 0.025, 1.4, seed)
    rows, starts, items = _seeds(shape, rng)
    number = seed * 1000 + 17
    return Solid.of(
        "watermelon",
        ("horizontal", "radial"),
        lambda points: depths_at(points, round_depths, shape),
        lambda points: colours_at(points, _colours, shape, rows, starts, items, number),
    )


def _seeds(shape: NDArray[np.float64], rng: np.random.Generator) -> ItemGrid:
    """Seeds in a thick layer at six to eight tenths of the radius, tips to the axis, none near the poles."""
    pool = spread_directions(8000)
    rng.shuffle(pool)
    centres: list[NDArray[np.float64]] = []
    for u in pool:
        if abs(u[2]) > 0.93 or len(centres) == SEEDS:
            continue
        # The seeds of a melon hang in a few lobes; between them they are rare.
        lobes = 0.5 + 0.5 * math.cos(6 * math.atan2(u[1], u[0]) + 1.5 * u[2])
        if rng.random() > 0.7 + 0.3 * lobes:
            continue
        radius = float(round_depth(u[0] * 1e-3, u[1] * 1e-3, u[2] * 1e-3, shape)) + 1e-3
        p = u * radius * rng.choice([rng.uniform(0.53, 0.61), rng.uniform(0.65, 0.76)], p=[0.35, 0.65])
        if all(np.sum((p - c) ** 2) > SPACING**2 for c in centres):
            centres.append(p)
    frames, halves, kinds = [], [], []
    for p in centres:
        axis = -p * [1, 1, 0.45] / np.linalg.norm(p * [1, 1, 0.45]) + rng.normal(0, 0.16, 3)
        frames.append(rotated_frame(axis / np.linalg.norm(axis), rng.uniform(0, 2 * np.pi)))
        white = rng.random() < 0.1
        size = rng.uniform(0.45, 0.65) if white else rng.uniform(0.9, 1.12)
        halves.append(size * np.array([0.056, 0.042, 0.028]))
        kinds.append(float(white))
    return index_items(np.array(centres), frames, np.array(halves), np.array(kinds))


@njit(cache=True)
def _skin(x: float, y: float, z: float, number: int) -> tuple[float, float, float]:
    """Dark stripes with torn edges over a light ground with a fine net of veins."""
    r = math.sqrt(x * x + y * y + z * z) + 1e-9
    u, v, w = x / r, y / r, z / r
    angle = math.atan2(v, u) + 0.16 * fbm(2.2 * u, 2.2 * v, 3.5 * w, 2, number)
    torn = fbm(7 * u, 7 * v, 11 * w, 3, number + 1)
    band = math.cos(9 * angle + 0.5 * noise(1.2 * u, 1.2 * v, 1.2 * w, number + 2))
    # Towards the poles the stripes run together into a dark cap.
    dark = step(-0.12, 0.22, band + 1.1 * torn - 0.15 + 0.9 * step(0.94, 1.0, abs(w)))
    net = abs(fbm(9 * u + torn, 9 * v, 5 * w, 2, number + 3))
    light = mix((0.42, 0.58, 0.27), (0.62, 0.73, 0.40), step(0.0, 0.22, net))
    deep = mix((0.055, 0.17, 0.075), (0.12, 0.28, 0.11), step(-0.3, 0.6, noise(6 * u, 6 * v, 6 * w, number + 4)))
    return mix(light, deep, dark)


@njit(cache=True)
def _flesh(x: float, y: float, z: float, d: float, number: int) -> tuple[float, float, float]:
    """Red with a paler heart, mottled, faint fibres out from the axis, the grain of large juicy cells."""
    rho = math.sqrt(x * x + y * y) + 1e-9
    mottle = fbm(3.1 * x, 3.1 * y, 3.1 * z, 3, number + 5)
    rgb = mix((0.80, 0.115, 0.135), (0.885, 0.215, 0.2), step(-0.5, 0.5, mottle))
    heart = step(0.42, 0.06, rho + 0.10 * mottle) * step(0.8, 0.4, abs(z))
    rgb = mix(rgb, (0.92, 0.33, 0.30), 0.55 * heart)
    u, v = x / rho, y / rho
    fibre = noise(11 * u, 11 * v, 5 * z + 1.6 * rho, number + 6) + 0.6 * noise(
        23 * u, 23 * v, 9 * z + 3 * rho, number + 7
    )
    rgb = mix(rgb, (0.95, 0.42, 0.37), 0.28 * step(0.1, 0.75, fibre) * step(0.12, 0.4, rho))
    # Pale strands where the three carpels of the fruit meet.
    strand = abs(noise(2.3 * x, 2.3 * y, 1.4 * z, number + 8))
    rgb = mix(rgb, (0.95, 0.46, 0.40), 0.22 * step(0.09, 0.0, strand) * step(0.1, 0.3, rho))
    near, far, name = cells(26 * x, 26 * y, 26 * z, 0.9, number + 9)
    grain = 0.94 + 0.07 * name + 0.06 * step(0.0, 0.25, far - near)
    return rgb[0] * grain, rgb[1] * grain, rgb[2] * grain


@njit(cache=True, nogil=True)
def _colours(
    start: int,
    stop: int,
    points: NDArray[np.float64],
    shape: NDArray[np.float64],
    rows: NDArray[np.float64],
    starts: NDArray[np.int64],
    items: NDArray[np.int64],
    number: int,
    out: NDArray[np.float32],
) -> None:
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d = max(round_depth(x, y, z, shape), 0.0)
        if d < 0.2:
            ragged = 0.016 * fbm(5 * x, 5 * y, 5 * z, 4, number + 10)
            t = d + ragged * step(0.02, 0.07, d)
            rgb = mix((0.56, 0.70, 0.36), (0.86, 0.91, 0.70), step(0.010, 0.045, t))
            rgb = mix(rgb, (0.955, 0.93, 0.80), step(0.034, 0.064, t))
            rgb = mix(rgb, (0.94, 0.60, 0.50), step(0.068, 0.086, t))
            if d < 0.03:
                rgb = mix(_skin(x, y, z, number), rgb, step(0.009, 0.02, d))
            if t > 0.07:
                rgb = mix(rgb, _flesh(x, y, z, d, number), step(0.078, 0.112, t))
        else:
            rgb = _flesh(x, y, z, d, number)
        if d > 0.12:
            q, item = item_at(x, y, z, TIP, rows, starts, items)
            if q < 1.8:
                if rows[item, 15] > 0.5:
                    rgb = mix(rgb, (0.965, 0.90, 0.76), step(1.15, 0.9, q))
                else:
                    # The hollow that the seed lies in is darker than the flesh.
                    rgb = mix(rgb, (0.62, 0.07, 0.09), 0.5 * step(1.75, 1.1, q))
                    coat = mix((0.10, 0.055, 0.045), (0.055, 0.032, 0.03), step(0.9, 0.3, q))
                    rgb = mix(rgb, coat, step(1.12, 0.92, q))
        store(out, i, rgb)
