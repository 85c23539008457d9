"""Kinds of fruit and other things drawn as functions of place, so that every cut through an individual is known.

Each takes places (..., 3) in the unit ball, the axis upwards, and the number of an individual, and gives colours
(..., 3), range [0, 1]. Individuals have other seeds, other places of cores and other grain.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

__all__ = ["KINDS", "Kind", "whole_fruit"]

Values: TypeAlias = NDArray[np.float64]
Kind: TypeAlias = Callable[[Values, int], Values]

GRAIN_CELLS = 24
"""Cells along a side of the block of random numbers that grain repeats."""


def blend(rgb: Values, colour: ArrayLike, share: Values) -> Values:
    """(..., 3). Colours that give way to another one by a share (...), which is clipped to [0, 1]."""
    return rgb + (np.asarray(colour) - rgb) * np.clip(share, 0, 1)[..., None]


def plain(at: Values, colour: ArrayLike) -> Values:
    """(..., 3). One colour everywhere."""
    return np.broadcast_to(np.asarray(colour, float), at.shape).copy()


def whole_fruit(x: Values, y: Values, skin: ArrayLike) -> tuple[Values, NDArray[np.bool_]]:
    """(H, W, 3) and (H, W). A ball with a skin of one colour, lit from the upper left, and where it is seen: where
    places (H, W), (H, W), x to the right and y down, lie in the unit disc."""
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    lit = np.clip((z - 0.5 * x - 0.7 * y) / np.sqrt(1.74), 0, 1)[..., None]
    return np.clip(np.asarray(skin) * (0.3 + 0.7 * lit) + 0.4 * lit**30, 0, 1), z > 0


def grain(at: Values, fine: float, number: int, amount: float) -> Values:
    """(..., 1). Smooth noise of this standard deviation; `fine` is the part of its block that a radius crosses."""
    block = np.random.default_rng(number).standard_normal((GRAIN_CELLS,) * 3)
    places = np.moveaxis((at * fine) % 1 * GRAIN_CELLS, -1, 0)
    return amount * ndimage.map_coordinates(block, places, order=1, mode="wrap")[..., None]


def cylindrical(at: Values) -> tuple[Values, Values, Values, Values]:
    """(...) each. Distance from the axis, height, angle around the axis, and distance from the middle."""
    x, y, z = np.moveaxis(at, -1, 0)
    return np.hypot(x, y), z, np.arctan2(y, x), np.linalg.norm(at, axis=-1)


def ellipsoids(
    rgb: Values, at: Values, middles: Values, axes: ArrayLike, colour: ArrayLike, outwards: Values | None = None
) -> Values:
    """(..., 3). Colours with ellipsoids of these half axes around middles (B, 3): along x, y and z, or with directions
    `outwards` (B,) around the axis, along these, around the axis and along z."""
    half = np.asarray(axes, float)
    for n, middle in enumerate(middles):
        off = at - middle
        near = (np.abs(off) < half.max()).all(-1)
        if near.any():
            some = off[near]
            if outwards is not None:
                c, s = np.cos(outwards[n]), np.sin(outwards[n])
                some = some @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            rgb[near] = blend(rgb[near], colour, (1 - np.linalg.norm(some / half, axis=-1)) * 6)
    return rgb


def on_sphere(count: int, rng: np.random.Generator) -> Values:
    """(count, 3). Random directions."""
    some = rng.normal(size=(count, 3))
    return np.asarray(some / np.linalg.norm(some, axis=1, keepdims=True))


def around_axis(count: int, radii: tuple[float, float], most: float, rng: np.random.Generator) -> tuple[Values, Values]:
    """(count, 3) and (count,). Places between two distances from the axis, up to this height, and their angles."""
    turn, out = rng.uniform(0, 2 * np.pi, count), rng.uniform(*radii, count)
    height = rng.uniform(-most, most, count)
    return np.stack([out * np.cos(turn), out * np.sin(turn), height], -1), turn


def from_walls(angle: Values, out: Values, count: int) -> Values:
    """(...). Distance from the nearest of so many walls around the axis, at these angles and distances from it."""
    turn = (angle / (2 * np.pi) * count) % 1
    return np.minimum(turn, 1 - turn) * 2 * np.pi / count * out


def avocado(at: Values, number: int) -> Values:
    """Flesh whose colour goes by the depth, and a stone that lies low."""
    rng, length = np.random.default_rng(number), np.linalg.norm(at, axis=-1)
    rgb = blend(plain(at, [0.93, 0.88, 0.5]), [0.6, 0.72, 0.3], (length - 0.6) / 0.35)
    middle = np.array([0.03, 0.03, 0.05]) * rng.normal(size=3) - [0, 0, 0.15]
    stone = np.linalg.norm((at - middle) / [0.42, 0.42, 0.45 + 0.04 * rng.normal()], axis=-1)
    rgb = blend(rgb, [0.5, 0.3, 0.15], (1 - stone) * 40)
    return blend(rgb, [0.2, 0.22, 0.1], (length - 0.965) * 80) + grain(at, 0.6, number, 0.012)


def cantaloupe(at: Values, number: int) -> Values:
    """A hollow full of seeds that are paler than the flesh."""
    rng, (_, _, angle, length) = np.random.default_rng(number), cylindrical(at)
    rgb = blend(plain(at, [0.97, 0.65, 0.32]), [0.75, 0.8, 0.45], (length - 0.82) / 0.1)
    hollow = np.linalg.norm(at / [0.36, 0.36, 0.55], axis=-1) + 0.05 * np.sin(6 * angle)
    rgb = blend(rgb, [0.9, 0.5, 0.2], (1 - hollow) * 15)
    places = on_sphere(700, rng) * rng.uniform(0.4, 0.95, (700, 1)) * [0.33, 0.33, 0.5]
    rgb = ellipsoids(rgb, at, places, [0.05, 0.022, 0.03], [0.95, 0.88, 0.65])
    return blend(rgb, [0.6, 0.6, 0.45], (length - 0.965) * 60) + grain(at, 0.6, number, 0.012)


def coconut(at: Values, number: int) -> Values:
    """A large hollow in white flesh, in a shell that is as dark as it."""
    length = np.linalg.norm(at, axis=-1) + grain(at, 0.2, number, 0.01)[..., 0]
    rgb = blend(plain(at, [0.97, 0.96, 0.94]), [0.35, 0.3, 0.27], (0.58 - length) * 60)
    rgb = blend(rgb, [0.45, 0.28, 0.15], (length - 0.85) * 80)
    return blend(rgb, [0.3, 0.18, 0.1], (length - 0.9) * 60) + grain(at, 0.8, number, 0.012)


def dragon_fruit(at: Values, number: int) -> Values:
    """Very many small seeds in white flesh."""
    rng, length = np.random.default_rng(number), np.linalg.norm(at, axis=-1)
    places = on_sphere(1800, rng) * 0.84 * rng.uniform(0.02, 1, (1800, 1)) ** (1 / 3)
    rgb = ellipsoids(plain(at, [0.95, 0.94, 0.93]), at, places, [0.018] * 3, [0.1, 0.1, 0.12])
    rgb = blend(rgb, [0.9, 0.2, 0.55], (length - 0.88) * 60)
    return blend(rgb, [0.8, 0.1, 0.4], (length - 0.95) * 60) + grain(at, 0.6, number, 0.012)


def egg(at: Values, number: int) -> Values:
    """A yolk that is not round and lies beside the middle, in a thin green layer."""
    rng, (_, _, angle, _) = np.random.default_rng(number), cylindrical(at)
    from_yolk = np.linalg.norm(at - rng.normal(size=3) * [0.08, 0.08, 0.1], axis=-1)
    rgb = blend(plain(at, [0.96, 0.95, 0.92]), [0.6, 0.66, 0.45], (0.56 + 0.02 * np.sin(5 * angle) - from_yolk) * 60)
    return blend(rgb, [0.97, 0.78, 0.25], (0.53 - from_yolk) * 40) + grain(at, 0.6, number, 0.012)


def fig(at: Values, number: int) -> Values:
    """A thick pale rind around many small seeds."""
    rng, length = np.random.default_rng(number), np.linalg.norm(at, axis=-1)
    rgb = blend(plain(at, [0.85, 0.35, 0.35]), [0.95, 0.75, 0.6], (length - 0.68) / 0.1)
    rgb = blend(rgb, [0.97, 0.93, 0.82], (length - 0.8) * 30)
    places = on_sphere(1400, rng) * 0.74 * rng.uniform(0.05, 1, (1400, 1)) ** 0.5
    rgb = ellipsoids(rgb, at, places, [0.028] * 3, [0.95, 0.8, 0.45])
    rgb = blend(rgb, [0.6, 0.2, 0.25], (0.22 - np.linalg.norm(at / [1, 1, 1.6], axis=-1)) * 12)
    return blend(rgb, [0.35, 0.2, 0.35], (length - 0.96) * 60) + grain(at, 0.8, number, 0.03)


def geode(at: Values, number: int) -> Values:
    """Bands that follow an uneven shell, around crystals."""
    (_, z, angle, length) = cylindrical(at)
    depth = length + grain(at, 0.25, number, 0.06)[..., 0]
    bands = np.array([0.3, 0.4, 0.65]) + (0.5 + 0.5 * np.sin(60 * depth))[..., None] * [0.55, 0.48, 0.3]
    rgb = blend(plain(at, [0.5, 0.45, 0.42]), [0.75, 0.78, 0.85], (0.88 - depth) * 30)
    rgb = blend(rgb, bands, (0.85 - depth) * 30)
    rgb = blend(rgb, [0.93, 0.92, 0.95], (0.55 - depth) * 20)
    rgb = blend(rgb, [0.45, 0.3, 0.6], (0.42 - depth + 0.04 * np.sin(14 * angle) * np.cos(13 * z)) * 25)
    return rgb + grain(at, 0.9, number, 0.02)


def kiwi(at: Values, number: int) -> Values:
    """Rays and seeds around a pale core that runs along the axis."""
    rng, (out, z, angle, length) = np.random.default_rng(number), cylindrical(at)
    rgb = blend(plain(at, [0.62, 0.75, 0.2]), [0.72, 0.8, 0.35], (length - 0.75) / 0.2)
    rays = 0.5 + 0.5 * np.cos(26 * angle + 2 * np.sin(3 * angle + number))
    rays *= np.clip((out - 0.2) / 0.1, 0, 1) * np.clip((0.75 - out) / 0.1, 0, 1)
    rgb = blend(rgb, [0.8, 0.86, 0.5], 0.5 * rays)
    core = np.hypot(at[..., 0] / 0.2, at[..., 1] / 0.15) / np.sqrt(np.maximum(1 - (z / 0.8) ** 2, 0.001))
    rgb = blend(rgb, [0.93, 0.92, 0.75], (1 - core) * 12 * (np.abs(z) < 0.8))
    places, turns = around_axis(420, (0.28, 0.44), 0.7, rng)
    places[:, :2] *= np.sqrt(1 - places[:, 2:] ** 2)
    rgb = ellipsoids(rgb, at, places, [0.055, 0.026, 0.03], [0.08, 0.06, 0.05], turns)
    return blend(rgb, [0.45, 0.33, 0.18], (length - 0.965) * 80) + grain(at, 0.7, number, 0.015)


def lemon(at: Values, number: int) -> Values:
    """Thin membranes from a core to a thick pale rind."""
    out, _, angle, length = cylindrical(at)
    walls = from_walls(angle + 0.3 * number, out, 9)
    rgb = blend(plain(at, [0.96, 0.88, 0.4]), [0.98, 0.96, 0.75], (0.018 - walls) * 80)
    rgb = blend(rgb, [0.98, 0.97, 0.85], (0.1 - out) * 30)
    rgb = blend(rgb, [0.98, 0.97, 0.82], (length - 0.85) * 40)
    return blend(rgb, [0.95, 0.8, 0.1], (length - 0.95) * 60) + grain(at, 0.9, number, 0.03)


def muffin(at: Values, number: int) -> Values:
    """Large berries, some of which touch, in coarse crumb."""
    rng, length = np.random.default_rng(number), np.linalg.norm(at, axis=-1)
    places = on_sphere(60, rng) * 0.85 * rng.uniform(0.02, 1, (60, 1)) ** (1 / 3)
    rgb = ellipsoids(plain(at, [0.93, 0.82, 0.55]), at, places, [0.1] * 3, [0.2, 0.12, 0.35])
    rgb = ellipsoids(rgb, at, places, [0.075] * 3, [0.4, 0.25, 0.45])
    return blend(rgb, [0.65, 0.4, 0.18], (length - 0.93) * 30) + grain(at, 1.0, number, 0.05)


def onion(at: Values, number: int) -> Values:
    """Uneven shells, of which no two individuals have the same number."""
    _, z, angle, length = cylindrical(at)
    depth = length + 0.03 * np.sin(2 * angle + number) + 0.02 * np.sin(6 * z + number)
    turn = (depth * (7 + number % 2)) % 1
    shells = np.exp(-((np.minimum(turn, 1 - turn) / 0.08) ** 2))
    rgb = blend(plain(at, [0.96, 0.95, 0.9]), [0.75, 0.8, 0.6], 0.9 * shells)
    return blend(rgb, [0.85, 0.6, 0.3], (length - 0.96) * 60) + grain(at, 0.7, number, 0.012)


def papaya(at: Values, number: int) -> Values:
    """A hollow lined with dark seeds that touch."""
    rng, (_, _, angle, length) = np.random.default_rng(number), cylindrical(at)
    rgb = blend(plain(at, [0.97, 0.55, 0.22]), [0.97, 0.7, 0.3], (length - 0.8) / 0.15)
    hollow = np.linalg.norm(at / [0.42, 0.42, 0.62], axis=-1) + 0.05 * np.cos(5 * angle + number)
    rgb = blend(rgb, [0.8, 0.42, 0.18], (1 - hollow) * 15)
    places = on_sphere(320, rng) * [0.36, 0.36, 0.54] * rng.uniform(0.82, 1, (320, 1))
    rgb = ellipsoids(rgb, at, places, [0.06] * 3, [0.12, 0.11, 0.1])
    return blend(rgb, [0.55, 0.6, 0.2], (length - 0.96) * 60) + grain(at, 0.6, number, 0.012)


def passion_fruit(at: Values, number: int) -> Values:
    """Dark seeds in pale ones of juice, in a thick rind."""
    rng, length = np.random.default_rng(number), np.linalg.norm(at, axis=-1)
    places = on_sphere(330, rng) * 0.66 * rng.uniform(0.1, 1, (330, 1)) ** (1 / 3)
    rgb = ellipsoids(plain(at, [0.85, 0.55, 0.1]), at, places, [0.11, 0.1, 0.1], [0.95, 0.7, 0.15])
    rgb = ellipsoids(rgb, at, places, [0.06, 0.045, 0.045], [0.12, 0.1, 0.05])
    rgb = blend(rgb, [0.95, 0.92, 0.85], (length - 0.75) * 40)
    return blend(rgb, [0.45, 0.2, 0.35], (length - 0.93) * 60) + grain(at, 0.8, number, 0.02)


def peach(at: Values, number: int) -> Values:
    """A furrowed stone in a red layer."""
    _, z, angle, length = cylindrical(at)
    rgb = blend(plain(at, [0.97, 0.78, 0.35]), [0.95, 0.6, 0.25], (length - 0.7) / 0.3)
    stone = np.linalg.norm(at / [0.36, 0.28, 0.42], axis=-1) + 0.06 * np.sin(9 * angle + number) * np.cos(21 * z)
    rgb = blend(rgb, [0.75, 0.12, 0.12], 0.9 * np.exp(-(((stone - 1.15) / 0.18) ** 2)))
    rgb = blend(rgb, [0.5, 0.28, 0.15], (1 - stone) * 15)
    return blend(rgb, [0.8, 0.25, 0.2], (length - 0.96) * 60) + grain(at, 0.6, number, 0.015)


def persimmon(at: Values, number: int) -> Values:
    """Eight dark petals around a pale column."""
    out, z, angle, length = cylindrical(at)
    rgb = blend(plain(at, [0.93, 0.5, 0.15]), [0.95, 0.58, 0.2], (length - 0.6) / 0.3)
    off = 1 - 2 * np.abs((angle / (2 * np.pi) * 8 + 0.1 * number) % 1 - 0.5)
    petals = np.linalg.norm(np.stack([(out - 0.33) / 0.25, off / 0.5, z / 0.35], -1), axis=-1)
    rgb = blend(rgb, [0.8, 0.36, 0.08], 0.9 * np.clip((1 - petals) * 6, 0, 1))
    rgb = blend(rgb, [0.97, 0.85, 0.6], (0.07 - out) * 60 * (np.abs(z) < 0.8))
    return blend(rgb, [0.85, 0.35, 0.08], (length - 0.965) * 60) + grain(at, 0.8, number, 0.015)


def pumpkin(at: Values, number: int) -> Values:
    """A hollow of strings and large pale seeds."""
    rng, (_, _, angle, length) = np.random.default_rng(number), cylindrical(at)
    hollow = np.linalg.norm(at / [0.62, 0.62, 0.5], axis=-1) + 0.04 * np.sin(7 * angle + number)
    rgb = blend(plain(at, [0.95, 0.65, 0.2]), [0.75, 0.4, 0.1], (1 - hollow) * 20)
    strings = np.clip(grain(at, 1.3, number, 1.0)[..., 0] - 0.6, 0, 1)
    rgb = blend(rgb, [0.97, 0.75, 0.3], strings * (hollow < 1))
    places, turns = around_axis(220, (0.25, 0.55), 0.36, rng)
    inside = np.linalg.norm(places / [0.62, 0.62, 0.5], axis=1) < 0.9
    rgb = ellipsoids(rgb, at, places[inside], [0.07, 0.035, 0.045], [0.96, 0.93, 0.8], turns[inside])
    return blend(rgb, [0.9, 0.45, 0.1], (length - 0.95) * 60) + grain(at, 0.8, number, 0.02)


def strawberry(at: Values, number: int) -> Values:
    """Pale rays and a core in flesh whose colour goes by the depth."""
    out, z, angle, length = cylindrical(at)
    rgb = blend(plain(at, [0.95, 0.6, 0.5]), [0.85, 0.15, 0.12], (length - 0.35) / 0.45)
    rays = (0.5 + 0.5 * np.cos(19 * angle + number)) * (0.5 + 0.5 * np.cos(16 * np.arctan2(z, out) + number))
    rays = rays**4 * np.clip((length - 0.3) * 5, 0, 1) * np.clip((0.92 - length) * 10, 0, 1)
    rgb = blend(rgb, [0.98, 0.85, 0.8], rays)
    rgb = blend(rgb, [0.98, 0.9, 0.86], (1 - np.linalg.norm(at / [0.16, 0.13, 0.5], axis=-1)) * 5)
    return blend(rgb, [0.75, 0.05, 0.08], (length - 0.93) * 40) + grain(at, 0.8, number, 0.025)


def tomato(at: Values, number: int) -> Values:
    """Thick walls between chambers with seeds."""
    rng, (out, z, angle, length) = np.random.default_rng(number), cylindrical(at)
    walls = from_walls(angle + number, out, 4)
    chambers = (
        np.clip((walls - 0.07) * 40, 0, 1) * np.clip((out - 0.28) * 30, 0, 1) * np.clip((0.8 - length) * 30, 0, 1)
    )
    rgb = blend(plain(at, [0.85, 0.25, 0.15]), [0.8, 0.5, 0.15], chambers)
    seeded = ellipsoids(
        rgb.copy(), at, around_axis(260, (0.35, 0.7), 0.6, rng)[0], [0.05, 0.035, 0.045], [0.93, 0.82, 0.55]
    )
    rgb = np.where(chambers[..., None] > 0.5, seeded, rgb)
    rgb = blend(rgb, [0.93, 0.75, 0.6], 0.8 * np.exp(-((out / 0.15) ** 2)) * (np.abs(z) < 0.7))
    return blend(rgb, [0.8, 0.1, 0.08], (length - 0.96) * 60) + grain(at, 0.5, number, 0.015)


KINDS: dict[str, Kind] = {
    "avocado": avocado,
    "cantaloupe": cantaloupe,
    "coconut": coconut,
    "dragon fruit": dragon_fruit,
    "egg": egg,
    "fig": fig,
    "geode": geode,
    "kiwi": kiwi,
    "lemon": lemon,
    "muffin": muffin,
    "onion": onion,
    "papaya": papaya,
    "passion fruit": passion_fruit,
    "peach": peach,
    "persimmon": persimmon,
    "pumpkin": pumpkin,
    "strawberry": strawberry,
    "tomato": tomato,
}
