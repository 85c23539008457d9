"""Seeded noise over 3-D space, one point at a time, for the colour functions of the solids.

All functions are pure, so that a solid is the same wherever and however often it is sampled.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["cell", "cells", "fbm", "mix", "noise", "smin", "step", "store", "unit"]

# Odd 64-bit constants of well-known integer mixers (splitmix64 and the golden ratio); any odd numbers with well-mixed
# bits work.
K1 = np.uint64(0x9E3779B97F4A7C15)
K2 = np.uint64(0xBF58476D1CE4E5B9)
K3 = np.uint64(0x94D049BB133111EB)
K4 = np.uint64(0xD6E8FEB86659FD93)
S30, S27, S31 = np.uint64(30), np.uint64(27), np.uint64(31)
S21, S42 = np.uint64(21), np.uint64(42)
MASK = np.uint64((1 << 21) - 1)
UNIT = 1.0 / (1 << 21)


@njit(cache=True)
def _bits(i: int, j: int, k: int, seed: int) -> np.uint64:
    """64 mixed bits of a lattice point."""
    h = np.uint64(i) * K1 ^ np.uint64(j) * K2 ^ np.uint64(k) * K3 ^ np.uint64(seed) * K4
    h = (h ^ (h >> S30)) * K2
    h = (h ^ (h >> S27)) * K3
    return h ^ (h >> S31)


@njit(cache=True)
def unit(i: int, j: int, k: int, seed: int) -> tuple[float, float, float]:
    """Three numbers in [0, 1) of a lattice point."""
    h = _bits(i, j, k, seed)
    return float(h & MASK) * UNIT, float((h >> S21) & MASK) * UNIT, float((h >> S42) & MASK) * UNIT


@njit(cache=True)
def _corner(i: int, j: int, k: int, seed: int, x: float, y: float, z: float) -> float:
    a, b, c = unit(i, j, k, seed)
    return (2 * a - 1) * x + (2 * b - 1) * y + (2 * c - 1) * z


@njit(cache=True)
def _ease(t: float) -> float:
    """Quintic step: noise keeps two continuous derivatives across lattice planes, so no grid shows."""
    return t * t * t * (t * (t * 6 - 15) + 10)


@njit(cache=True)
def noise(x: float, y: float, z: float, seed: int) -> float:
    """Gradient noise, features about one unit wide. Range about [-0.9, 0.9], mean 0."""
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    i, j, k = int(fx), int(fy), int(fz)
    x, y, z = x - fx, y - fy, z - fz
    u, v, w = _ease(x), _ease(y), _ease(z)
    total = 0.0
    for a in range(2):
        wa = u if a else 1 - u
        for b in range(2):
            wb = wa * (v if b else 1 - v)
            for c in range(2):
                total += wb * (w if c else 1 - w) * _corner(i + a, j + b, k + c, seed, x - a, y - b, z - c)
    return 1.4 * total


@njit(cache=True)
def fbm(x: float, y: float, z: float, octaves: int, seed: int) -> float:
    """Sum of `octaves` noises, each twice as fine and half as strong. Range about [-1, 1]."""
    total, height = 0.0, 0.6
    for octave in range(octaves):
        total += height * noise(x, y, z, seed + 101 * octave)
        x, y, z, height = 2.03 * x + 7.1, 2.03 * y + 3.7, 2.03 * z + 5.3, 0.5 * height
    return total


@njit(cache=True)
def cell(x: float, y: float, z: float, jitter: float, seed: int) -> tuple[float, float, float, float, float, float]:
    """Cells around one jittered centre per lattice cube (Worley noise).

    Returns the squared distances to the nearest and second nearest centre, a number in [0, 1) that identifies the cell,
    and the offset of the point from the cell's centre.
    """
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    first, second, name = 9.0, 9.0, 0.0
    ox, oy, oz = 0.0, 0.0, 0.0
    for a in range(i - 1, i + 2):
        for b in range(j - 1, j + 2):
            for c in range(k - 1, k + 2):
                u, v, w = unit(a, b, c, seed)
                dx = x - a - 0.5 - jitter * (u - 0.5)
                dy = y - b - 0.5 - jitter * (v - 0.5)
                dz = z - c - 0.5 - jitter * (w - 0.5)
                square = dx * dx + dy * dy + dz * dz
                if square < first:
                    second, first = first, square
                    name = (u + 7 * v + 13 * w) % 1.0
                    ox, oy, oz = dx, dy, dz
                elif square < second:
                    second = square
    return first, second, name, ox, oy, oz


@njit(cache=True)
def cells(x: float, y: float, z: float, jitter: float, seed: int) -> tuple[float, float, float]:
    """As `cell`: distances to the nearest and second nearest centre, and the cell's number."""
    first, second, name, _, _, _ = cell(x, y, z, jitter, seed)
    return math.sqrt(first), math.sqrt(second), name


@njit(cache=True)
def step(low: float, high: float, value: float) -> float:
    """Smooth step from 0 at low to 1 at high; falls where high < low."""
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3 - 2 * t)


@njit(cache=True)
def smin(a: float, b: float, k: float) -> float:
    """The smaller of two distances, corners rounded over a width k."""
    h = max(k - abs(a - b), 0.0) / k
    return min(a, b) - h * h * k / 4


@njit(cache=True)
def mix(a: tuple[float, float, float], b: tuple[float, float, float], t: float) -> tuple[float, float, float]:
    """The colour a at t = 0, b at t = 1."""
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t


@njit(cache=True)
def store(out: NDArray[np.float32], i: int, rgb: tuple[float, float, float]) -> None:
    """Writes row i of an array of colours, clipped to [0, 1]."""
    for c in range(3):
        out[i, c] = min(max(rgb[c], 0.0), 1.0)
