"""A tin loaf: brown crust, pale crumb with pores of every size. Long along x."""

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
)
from sample_scenes.solids.solid import Solid

__all__ = ["bread"]

PORES = 4200
"""Pores big enough to be seen one by one; finer ones are a texture."""

LENGTH, WIDTH, HEIGHT = 1.0, 0.62, 0.60
"""Half sizes of the loaf along x, y and z, world units."""


def bread(seed: int = 0) -> Solid:
    """A loaf, 2 units long; every seed gives a different one."""
    rng = np.random.default_rng([seed, 3])
    rows, starts, items = _pores(rng)
    number = seed * 1000 + 431
    return Solid.of(
        "bread",
        ("parallel", "horizontal"),
        lambda points: depths_at(points, _depths, number),
        lambda points: colours_at(points, _colours, number, rows, starts, items),
    )


def _pores(rng: np.random.Generator) -> ItemGrid:
    """Flattened bubbles of log-normal size all through the loaf: many small, few large."""
    centres = rng.uniform(-1, 1, (PORES, 3)) * [LENGTH, WIDTH, HEIGHT]
    size = np.clip(np.exp(rng.normal(np.log(0.0175), 0.5, PORES)), 0.008, 0.07)
    frames, halves = [], []
    for half in size:
        # Gas rises and the dough spreads: bubbles are wider than high, and lean a little.
        axis = np.array([0, 0, 1.0]) + rng.normal(0, 0.3, 3)
        frames.append(rotated_frame(axis / np.linalg.norm(axis), rng.uniform(0, 2 * np.pi)))
        halves.append(half * np.array([rng.uniform(0.6, 0.9), rng.uniform(1.0, 1.7), rng.uniform(0.9, 1.2)]))
    return index_items(centres, frames, np.array(halves), rng.random(PORES))


@njit(cache=True)
def _box(x: float, y: float, a: float, b: float, r: float) -> float:
    """Signed distance to a rectangle of half sizes a, b with corners of radius r; negative inside."""
    u, v = abs(x) - a + r, abs(y) - b + r
    return math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2) + min(max(u, v), 0.0) - r


@njit(cache=True)
def _level(x: float, y: float, z: float, number: int) -> float:
    """Positive in the loaf, zero on its skin: a rounded box with a domed top that swells over the sides of the tin."""
    swell = 0.012 * noise(1.7 * x, 1.7 * y, 1.7 * z, number)
    # The top sinks a little towards the two ends.
    crown = z + 0.10 * x * x
    lower = _box(y, z + 0.16, 0.545 + 0.03 * z, 0.44, 0.10)
    upper = math.sqrt((y / 0.62) ** 2 + ((crown - 0.16) / 0.40) ** 2)
    slope = math.sqrt((y / 0.62**2) ** 2 + ((crown - 0.16) / 0.40**2) ** 2)
    dome = (upper - 1) * upper / max(slope, 1e-6) if slope > 1e-6 else -0.4
    across = smin(lower, dome, 0.12)
    u, v = across + 0.14, abs(x) - LENGTH + 0.14
    body = math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2) + min(max(u, v), 0.0) - 0.14
    return -body + swell


@njit(cache=True)
def _depth(x: float, y: float, z: float, number: int) -> float:
    """Depth in the loaf: level / |gradient|, the distance to first order at the skin."""
    e = 1e-4
    here = _level(x, y, z, number)
    a = _level(x + e, y, z, number) - here
    b = _level(x, y + e, z, number) - here
    c = _level(x, y, z + e, number) - here
    # Deep inside, where sides are equally far, the gradient vanishes or jumps: there the level has to do.
    return here / min(max(math.sqrt(a * a + b * b + c * c) / e, 0.6), 1.15)


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
def _crust(x: float, y: float, z: float, number: int) -> tuple[float, float, float]:
    """Outside: deep brown on the dome, golden where the loaf tore open along the top, paler on the sides of the tin."""
    blotch = fbm(2.6 * x, 2.6 * y, 2.6 * z, 3, number + 1)
    fine = fbm(11 * x, 11 * y, 11 * z, 2, number + 2)
    top = step(0.05, 0.32, z + 0.08 * blotch)
    rgb = mix((0.80, 0.56, 0.28), (0.55, 0.29, 0.10), top)
    rgb = mix(rgb, (0.40, 0.19, 0.065), 0.75 * step(0.05, 0.7, blotch + 0.3 * top))
    rgb = mix(rgb, (0.86, 0.64, 0.34), 0.35 * step(0.15, 0.7, fine))
    tear = abs(y - 0.05 * noise(1.6 * x, 0.0, 0.0, number + 3)) + 0.03 * noise(7 * x, 7 * y, 0.0, number + 4)
    open_ = step(0.115, 0.06, tear) * step(0.94, 0.78, abs(x)) * step(0.2, 0.35, z)
    torn = mix((0.85, 0.62, 0.32), (0.95, 0.80, 0.52), step(-0.3, 0.5, fbm(5 * x, 16 * y, 5 * z, 3, number + 5)))
    return mix(rgb, torn, 0.85 * open_)


@njit(cache=True, nogil=True)
def _colours(
    start: int,
    stop: int,
    points: NDArray[np.float64],
    number: int,
    rows: NDArray[np.float64],
    starts: NDArray[np.int64],
    items: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d = max(_depth(x, y, z, number), 0.0)
        mottle = fbm(3.2 * x, 3.2 * y, 3.2 * z, 3, number + 6)
        rgb = mix((0.925, 0.845, 0.69), (0.975, 0.925, 0.805), step(-0.5, 0.5, mottle))
        # Crumb: thin bright walls round small dim bubbles, flattened like the big ones.
        warp = noise(7 * x, 7 * y, 7 * z, number + 7)
        for octave in range(2):
            f = 16.0 + 15.0 * octave
            near, far, name = cells(f * x + 0.5 * warp, f * y - 0.5 * warp, 1.4 * f * z, 1.0, number + 9 + 20 * octave)
            hole = step(0.5, 0.1, near + 0.15 * warp) * step(0.3, 0.7, name)
            rgb = mix(rgb, (0.80, 0.67, 0.475), (0.5 - 0.08 * octave) * hole)
            rgb = mix(rgb, (0.995, 0.965, 0.88), 0.22 * step(0.2, 0.0, far - near))
        # Pores stay small near the crust, where the dough set first.
        q, item = item_at(x, y, z, 0.0, rows, starts, items)
        if q < 5:
            size = step(0.02, 0.10, d)
            torn = noise(13 * x, 13 * y, 13 * z, number + 10) + 0.6 * noise(29 * x, 29 * y, 29 * z, number + 12)
            q = math.sqrt(q) + 0.34 * torn + 0.6 * (1 - size)
            shade = rows[item, 15]
            # A hole is darkest under its upper rim: light falls in from above.
            under = min(max(0.5 + 0.5 * (z - rows[item, 2]) / rows[item, 12], 0.0), 1.0)
            deep = mix((0.67, 0.505, 0.31), (0.80, 0.665, 0.47), 0.75 * shade + 0.35 * (1 - under))
            rgb = mix(rgb, (0.985, 0.95, 0.86), 0.45 * step(1.2, 1.05, q))  # the skin of the bubble
            rgb = mix(rgb, mix((0.85, 0.735, 0.55), deep, step(0.97, 0.55, q)), step(1.04, 0.93, q))
        if d < 0.16:
            # Thicker on the dome than on the sides of the tin; browning fades inwards.
            thick = 0.030 + 0.016 * step(-0.1, 0.35, z) + 0.008 * noise(3 * x, 3 * y, 3 * z, number + 11)
            rgb = mix((0.90, 0.77, 0.55), rgb, step(thick + 0.005, thick + 0.085, d))
            rgb = mix((0.80, 0.585, 0.33), rgb, step(thick * 0.6, thick + 0.03, d))
            rgb = mix((0.60, 0.35, 0.145), rgb, step(thick * 0.3, thick * 1.1, d))
            rgb = mix(_crust(x, y, z, number), rgb, step(0.004, 0.6 * thick, d))
        store(out, i, rgb)
