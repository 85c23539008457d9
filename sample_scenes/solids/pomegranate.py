"""A pomegranate: leathery rind, pale membranes, chambers packed with red arils that hold small light seeds."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sample_scenes.solids.noise import cell, cells, fbm, mix, noise, smin, step, store
from sample_scenes.solids.shapes import (
    colours_at,
    depths_at,
    round_depth,
    round_depths,
    round_shape,
)
from sample_scenes.solids.solid import Solid

__all__ = ["pomegranate"]

ARILS_PER_UNIT = 6.4
"""Arils per world unit: each is a little under a sixth of the radius, as in the fruit."""

STOREY_HEIGHT = -0.3
"""Height of the membrane between the upper and the lower storey of chambers."""


def pomegranate(seed: int = 0) -> Solid:
    """A pomegranate, 2 units across, with 5 to 7 upper and 3 lower chambers; every seed gives a different one."""
    rng = np.random.default_rng([seed, 5])
    shape = round_shape(
        (1.0, 0.97, 0.93 * rng.uniform(0.97, 1.03)),
        0.03,
        1.6,
        seed + 120,
        taper=-0.02,
        top=(-0.24, 0.23),
        crater=(0.20, 0.10),
        bottom=(0.03, 0.2),
        lobes=(0.015, 6),
    )
    upper = _walls(int(rng.choice([5, 6, 6, 7])), rng)
    lower = _walls(3, rng)
    number = seed * 1000 + 811
    return Solid.of(
        "pomegranate",
        ("horizontal", "radial"),
        lambda points: depths_at(points, round_depths, shape),
        lambda points: colours_at(points, _colours, shape, upper, lower, number),
    )


def _walls(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(count,). Angles of the membranes around the axis, uneven by a fifth."""
    width = rng.uniform(0.8, 1.2, count)
    return rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.cumsum(width) / width.sum()


@njit(cache=True)
def _rind(x: float, y: float, z: float, number: int) -> tuple[float, float, float]:
    """Leather: crimson over ochre, freckled, browner at the crown."""
    blotch = fbm(1.5 * x, 1.5 * y, 1.5 * z, 3, number)
    rgb = mix((0.74, 0.12, 0.13), (0.87, 0.35, 0.24), step(-0.35, 0.6, blotch))
    rgb = mix(rgb, (0.86, 0.55, 0.28), 0.8 * step(0.25, 0.75, fbm(2 * x, 2 * y, 2 * z, 2, number + 1)))
    near, _, name = cells(17 * x, 17 * y, 17 * z, 1.0, number + 2)
    rgb = mix(rgb, (0.50, 0.24, 0.13), 0.55 * step(0.25, 0.1, near) * step(0.5, 0.7, name))
    fine = 0.95 + 0.10 * fbm(12 * x, 12 * y, 12 * z, 2, number + 3)
    rgb = (rgb[0] * fine, rgb[1] * fine, rgb[2] * fine)
    rho = math.sqrt(x * x + y * y)
    if z > 0:
        rgb = mix(rgb, (0.55, 0.25, 0.13), 0.8 * step(0.34, 0.16, rho))
        return mix(rgb, (0.33, 0.20, 0.10), step(0.10, 0.05, rho + 0.03 * noise(8 * x, 8 * y, 0.0, number + 4)))
    return mix(rgb, (0.40, 0.26, 0.13), step(0.09, 0.04, rho))


@njit(cache=True)
def _membrane_distance(x: float, y: float, z: float, walls: NDArray[np.float64], number: int) -> float:
    """Distance to the nearest membrane between chambers; negative inside the membrane."""
    rho = math.sqrt(x * x + y * y)
    bent = (
        math.atan2(y, x)
        + 0.22 * noise(1.3 * rho, 1.2 * z, 3.0, number + 5)
        + 0.10 * noise(2.4 * x, 2.4 * y, 2.4 * z, number + 6)
    )
    room = 9.0
    for n in range(len(walls)):
        turn = abs((bent - walls[n] + math.pi) % (2 * math.pi) - math.pi)
        room = min(room, rho * math.sin(min(turn, math.pi / 2)))
    return room - 0.014 - 0.010 * noise(3 * x, 3 * y, 3 * z, number + 7)


@njit(cache=True)
def _aril(x: float, y: float, z: float, room: float, number: int) -> tuple[float, float, float]:
    """A juicy grain around a light seed, pressed flat against its neighbours."""
    wx = 0.10 * noise(3 * x, 3 * y, 3 * z, number + 8)
    wy = 0.10 * noise(3 * x, 3 * y, 3 * z, number + 9)
    wz = 0.10 * noise(3 * x, 3 * y, 3 * z, number + 10)
    first, second, name, u, v, w = cell(
        ARILS_PER_UNIT * (x + wx), ARILS_PER_UNIT * (y + wy), ARILS_PER_UNIT * (z + wz), 0.8, number + 11
    )
    gap = min(math.sqrt(second) - math.sqrt(first), 1.6 * ARILS_PER_UNIT * room)
    rgb = mix((0.56, 0.02, 0.075), (0.76, 0.075, 0.12), name)
    # Juice is clear: towards its edge a grain is thinner and brighter.
    rgb = mix(rgb, (0.88, 0.22, 0.24), 0.6 * step(0.42, 0.10, gap))
    shine = step(
        0.25, 0.75, noise(2.2 * ARILS_PER_UNIT * x, 2.2 * ARILS_PER_UNIT * y, 2.2 * ARILS_PER_UNIT * z, number + 12)
    )
    rgb = mix(rgb, (0.95, 0.45, 0.42), 0.45 * shine)
    rgb = mix(rgb, (0.42, 0.015, 0.05), 0.85 * step(0.10, 0.02, gap))
    # The seed lies in the middle, long towards the axis of the fruit.
    rho = math.sqrt(x * x + y * y) + 1e-9
    along = (u * x + v * y) / rho
    square = u * u + v * v + w * w - along * along
    q = (along / 0.30) ** 2 + square / 0.155**2
    rgb = mix(rgb, (0.50, 0.02, 0.06), 0.4 * step(2.2, 1.2, q))
    return mix(rgb, mix((0.86, 0.60, 0.50), (0.95, 0.84, 0.72), step(0.9, 0.2, q)), 0.9 * step(1.15, 0.85, q))


@njit(cache=True, nogil=True)
def _colours(
    start: int,
    stop: int,
    points: NDArray[np.float64],
    shape: NDArray[np.float64],
    upper: NDArray[np.float64],
    lower: NDArray[np.float64],
    number: int,
    out: NDArray[np.float32],
) -> None:
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d = max(round_depth(x, y, z, shape), 0.0)
        uneven = fbm(2.4 * x, 2.4 * y, 2.4 * z, 3, number + 13)
        rind = d - (0.095 + 0.035 * uneven)
        rho = math.sqrt(x * x + y * y)
        # The spongy middle that the arils grow on, and the crown's pith above it.
        knot = math.sqrt(rho * rho + 0.16 * z * z) - 0.085 - 0.05 * uneven
        crown = math.sqrt(rho * rho + (z - 0.98) ** 2) - 0.28
        height = z - STOREY_HEIGHT - 0.16 * noise(1.6 * x, 1.6 * y, 7.0, number + 14) - 0.12 * (rho - 0.4)
        storey = (
            _membrane_distance(x, y, z, upper, number)
            if height > 0
            else _membrane_distance(x, y, z, lower, number + 40)
        )
        storey = smin(storey, abs(height) - 0.014, 0.05)
        room = smin(smin(smin(storey, rind, 0.09), knot, 0.08), crown, 0.06)
        rgb = mix((0.945, 0.83, 0.56), (0.98, 0.92, 0.74), step(-0.5, 0.5, uneven))
        fine = 0.97 + 0.05 * fbm(9 * x, 9 * y, 9 * z, 2, number + 15)
        rgb = (rgb[0] * fine, rgb[1] * fine, rgb[2] * fine)
        # Juice stains the pith beside the arils.
        rgb = mix(rgb, (0.93, 0.62, 0.45), 0.55 * step(-0.022, 0.0, room))
        if room > -0.006:
            rgb = mix(rgb, _aril(x, y, z, room, number), step(-0.003, 0.004, room))
        if d < 0.06:
            rgb = mix((0.90, 0.62, 0.36), rgb, step(0.018, 0.055, d))
            rgb = mix(_rind(x, y, z, number), rgb, step(0.008, 0.024, d))
        store(out, i, rgb)
