"""An apple: streaked skin, cream flesh, a core line, five carpels with brown seeds, a deep hollow at the stalk."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

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

__all__ = ["apple"]

CARPEL_TIP, SEED_TIP = 0.45, 0.6
"""How pointed the chambers of the core and the seeds are (`shapes.teardrop`)."""


def apple(seed: int = 0) -> Solid:
    """An apple, 2 units across; every seed gives a different one."""
    rng = np.random.default_rng([seed, 4])
    shape = round_shape(
        (1.0, 0.98, 0.98 * rng.uniform(0.97, 1.03)),
        0.025,
        1.3,
        seed + 80,
        taper=0.07,
        top=(0.42, 0.36),
        bottom=(0.20, 0.26),
        lobes=(0.028, 5),
    )
    turn = rng.uniform(0, 2 * np.pi)
    chambers, seeds = _core(turn, rng)
    number = seed * 1000 + 617
    return Solid.of(
        "apple",
        ("horizontal", "radial"),
        lambda points: depths_at(points, round_depths, shape),
        lambda points: colours_at(points, _colours, shape, turn, *chambers, *seeds, number),
    )


def _core(turn: float, rng: np.random.Generator) -> tuple[ItemGrid, ItemGrid]:
    """Five chambers around the axis, their tips to it, and one or two seeds in each, tips inward and down."""
    centres, frames, halves = [], [], []
    places, turns, sizes = [], [], []
    for k in range(5):
        angle = turn + 2 * np.pi * k / 5 + rng.normal(0, 0.05)
        out = np.array([math.cos(angle), math.sin(angle), 0.0])
        across = np.array([-math.sin(angle), math.cos(angle), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        centres.append(out * 0.185 + up * rng.normal(0, 0.01))
        frames.append(np.stack([-out, across, up]))
        halves.append(rng.uniform(0.93, 1.07, 3) * [0.155, 0.085, 0.25])
        for side in rng.permutation([-1.0, 1.0])[: 2 if rng.random() < 0.8 else 1]:
            axis = -out - 0.9 * up + rng.normal(0, 0.12, 3)
            places.append(out * rng.uniform(0.18, 0.20) + across * 0.026 * side + up * rng.uniform(-0.03, 0.05))
            turns.append(rotated_frame(axis / np.linalg.norm(axis), angle))
            sizes.append(rng.uniform(0.9, 1.08) * np.array([0.115, 0.062, 0.056]))
    none = np.zeros
    return (
        index_items(np.array(centres), frames, np.array(halves), none(len(centres))),
        index_items(np.array(places), turns, np.array(sizes), none(len(places))),
    )


@njit(cache=True)
def _skin(x: float, y: float, z: float, turn: float, number: int) -> tuple[float, float, float]:
    """Yellow ground under red streaks that run from pole to pole, pale dots, a russet stalk hollow."""
    rho = math.sqrt(x * x + y * y) + 1e-9
    u, v = x / rho, y / rho
    streak = noise(9 * u, 9 * v, 1.1 * z, number) + 0.7 * noise(24 * u, 24 * v, 1.6 * z, number + 1)
    blush = 0.55 * math.cos(math.atan2(y, x) - turn) + 0.5 * fbm(1.3 * x, 1.3 * y, 1.3 * z, 2, number + 2)
    ground = mix((0.87, 0.76, 0.30), (0.77, 0.79, 0.34), step(-0.3, 0.5, fbm(2 * x, 2 * y, 2 * z, 2, number + 3)))
    red = step(-0.75, 0.45, blush + 0.75 * streak)
    rgb = mix(ground, mix((0.86, 0.30, 0.17), (0.66, 0.055, 0.085), step(0.3, 1.0, red)), red)
    near, _, name = cells(15 * x, 15 * y, 15 * z, 1.0, number + 4)
    rgb = mix(rgb, (0.93, 0.80, 0.52), 0.65 * step(0.17, 0.07, near) * step(0.35, 0.5, name))
    hollow = step(0.36, 0.12, rho + 0.05 * noise(5 * u, 5 * v, z, number + 5))
    if z > 0:
        rgb = mix(rgb, mix((0.70, 0.66, 0.28), (0.50, 0.38, 0.15), step(0.2, 0.05, rho)), 0.9 * hollow)
        return mix(rgb, (0.22, 0.13, 0.07), step(0.055, 0.035, rho))
    return mix(rgb, (0.34, 0.24, 0.10), step(0.13, 0.03, rho + 0.02 * noise(9 * u, 9 * v, 0.0, number + 6)))


@njit(cache=True, nogil=True)
def _colours(
    start: int,
    stop: int,
    points: NDArray[np.float64],
    shape: NDArray[np.float64],
    turn: float,
    chambers: NDArray[np.float64],
    chamber_starts: NDArray[np.int64],
    chamber_items: NDArray[np.int64],
    seeds: NDArray[np.float64],
    seed_starts: NDArray[np.int64],
    seed_items: NDArray[np.int64],
    number: int,
    out: NDArray[np.float32],
) -> None:
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d = max(round_depth(x, y, z, shape), 0.0)
        rho = math.sqrt(x * x + y * y) + 1e-9
        mottle = fbm(3 * x, 3 * y, 3 * z, 3, number + 7)
        rgb = mix((0.962, 0.918, 0.755), (0.992, 0.972, 0.868), step(-0.5, 0.5, mottle))
        near, far, name = cells(30 * x, 30 * y, 30 * z, 1.0, number + 8)
        grain = 0.985 + 0.02 * name - 0.02 * step(0.1, 0.0, far - near)
        rgb = (rgb[0] * grain, rgb[1] * grain, rgb[2] * grain)
        # Greener just under the skin; the red bleeds in by a hair.
        rgb = mix((0.90, 0.885, 0.55), rgb, step(0.0, 0.14, d + 0.03 * mottle))
        # The core line: an onion with five soft corners between the chambers.
        bent = math.atan2(y, x) - turn
        wide = 0.43 + 0.035 * math.cos(5 * bent) + 0.02 * noise(2 * x, 2 * y, 2 * z, number + 9)
        line = math.sqrt((rho / wide) ** 2 + ((z + 0.02) / 0.50) ** 2) - 1
        rgb = mix(rgb, (0.95, 0.905, 0.70), 0.6 * step(0.03, -0.05, line))
        rgb = mix(rgb, (0.76, 0.775, 0.42), 0.62 * step(0.028, 0.0, abs(line)))
        # Ten vessel strands run along it.
        strand = abs((bent * 10 / (2 * math.pi) + 0.5) % 1.0 - 0.5) * 2 * math.pi / 10 * rho
        spot = math.sqrt(strand * strand + (0.42 * line) ** 2)
        rgb = mix(rgb, (0.60, 0.66, 0.30), 0.8 * step(0.024, 0.010, spot) * step(0.12, 0.25, rho))
        # Stalk and calyx continue into the flesh as a woody thread.
        thread = rho - 0.012 - 0.02 * step(0.35, 0.62, abs(z))
        rgb = mix(rgb, (0.76, 0.68, 0.42), 0.7 * step(0.02, -0.01, thread) * step(0.26, 0.5, abs(z)))
        q, _ = item_at(x, y, z, CARPEL_TIP, chambers, chamber_starts, chamber_items)
        if q < 1.8:
            q = math.sqrt(q) + 0.05 * noise(6 * x, 6 * y, 6 * z, number + 10)
            rgb = mix(rgb, (0.90, 0.82, 0.58), 0.9 * step(1.25, 1.08, q))  # the parchment wall
            rgb = mix(rgb, mix((0.73, 0.585, 0.34), (0.83, 0.715, 0.47), step(0.9, 0.4, q)), step(1.04, 0.95, q))
        q, _ = item_at(x, y, z, SEED_TIP, seeds, seed_starts, seed_items)
        if q < 1.3:
            coat = mix((0.24, 0.115, 0.05), (0.40, 0.215, 0.09), step(0.8, 0.1, q))
            rgb = mix(rgb, coat, step(1.08, 0.94, q))
        if d < 0.03:
            rgb = mix(_skin(x, y, z, turn, number), rgb, step(0.006, 0.02, d))
        store(out, i, rgb)
