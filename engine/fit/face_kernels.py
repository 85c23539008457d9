"""The kernel field at fixed points, and its gradient in the atoms, over fixed lists of atoms per point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.projection import rotation, rotation_backward

__all__ = ["POINTS", "FieldAtoms", "FieldPoints", "field_backward", "field_sums", "transpose"]

POINTS = 2048
"""Points, or atoms, per task."""


class FieldPoints(NamedTuple):
    """Points of the field. A named tuple, which numba can read."""

    places: NDArray[np.floating]
    """(K, 3)."""
    least: NDArray[np.floating]
    """(K,). Least standard deviation that an atom has there, world units."""


class FieldAtoms(NamedTuple):
    """The atoms of the field, or gradients in them. A named tuple, which numba can read."""

    means: NDArray[np.floating]
    """(N, 3)."""
    scales: NDArray[np.floating]
    """(N, 3)."""
    quats: NDArray[np.floating]
    """(N, 4)."""
    colours: NDArray[np.floating]
    """(N, 3)."""


@njit(cache=True, error_model="numpy")
def _offset(point, least, mean, scale, turn):
    """Offset d (3) from the mean, d along the axes in deviations u (3), the deviations (3), and the weight w."""
    d = point[0] - mean[0], point[1] - mean[1], point[2] - mean[2]
    s0, s1, s2 = max(scale[0], least), max(scale[1], least), max(scale[2], least)
    u0 = (turn[0] * d[0] + turn[3] * d[1] + turn[6] * d[2]) / s0
    u1 = (turn[1] * d[0] + turn[4] * d[1] + turn[7] * d[2]) / s1
    u2 = (turn[2] * d[0] + turn[5] * d[1] + turn[8] * d[2]) / s2
    gain = (scale[0] / s0) * (scale[1] / s1) * (scale[2] / s2)
    return d, (u0, u1, u2), (s0, s1, s2), math.exp(-0.5 * (u0 * u0 + u1 * u1 + u2 * u2)) * gain


@njit(cache=True, error_model="numpy", nogil=True)
def field_sums(task, at, offsets, listed, atoms, total, density):
    """Fills total (K, 3) = sum w c and density (K,) = sum w at some FieldPoints, of the FieldAtoms that are listed.

    Point p lists atoms listed[offsets[p]:offsets[p + 1]].
    """
    points, least = at.places, at.least
    means, scales, quats, colours = atoms.means, atoms.scales, atoms.quats, atoms.colours
    for p in range(task * POINTS, min((task + 1) * POINTS, len(points))):
        red, green, blue, weight = 0.0, 0.0, 0.0, 0.0
        for e in range(offsets[p], offsets[p + 1]):
            i = listed[e]
            turn = rotation(quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3])
            _, _, _, w = _offset(points[p], least[p], means[i], scales[i], turn)
            weight += w
            red += w * colours[i, 0]
            green += w * colours[i, 1]
            blue += w * colours[i, 2]
        density[p] = weight
        total[p, 0], total[p, 1], total[p, 2] = red, green, blue


@njit(cache=True, error_model="numpy", nogil=True)
def field_backward(task, at, first, entries, atoms, d_total, d_density, d_atoms):
    """Fills the gradients of some FieldAtoms from those of `field_sums`.

    Atom i reaches points entries[first[i]:first[i + 1]]. A deviation clamped to `least` has a gradient through the
    weight's volume only.
    """
    points, least = at.places, at.least
    means, scales, quats, colours = atoms.means, atoms.scales, atoms.quats, atoms.colours
    d_means, d_scales, d_quats, d_colours = d_atoms.means, d_atoms.scales, d_atoms.quats, d_atoms.colours
    g_scale, turned = np.empty(3), np.empty(9)
    for i in range(task * POINTS, min((task + 1) * POINTS, len(means))):
        turn = rotation(quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3])
        gx, gy, gz, red, green, blue = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        g_scale[:] = 0.0
        turned[:] = 0.0
        for e in range(first[i], first[i + 1]):
            p = entries[e]
            d, u, s, w = _offset(points[p], least[p], means[i], scales[i], turn)
            g = d_density[p]
            for c in range(3):
                g += d_total[p, c] * colours[i, c]
            red += w * d_total[p, 0]
            green += w * d_total[p, 1]
            blue += w * d_total[p, 2]
            for k in range(3):
                pull = g * w * u[k] / s[k]  # -dL/d(d along axis k)
                gx += pull * turn[k]
                gy += pull * turn[3 + k]
                gz += pull * turn[6 + k]
                if scales[i, k] > least[p]:
                    g_scale[k] += g * w * u[k] * u[k] / s[k]
                elif w > 0.0:  # an atom without extent has weight 0, and its gradient stays 0 too
                    g_scale[k] += g * w / scales[i, k]
                for row in range(3):
                    turned[3 * row + k] -= pull * d[row]
        d_means[i, 0], d_means[i, 1], d_means[i, 2] = gx, gy, gz
        for k in range(3):
            d_scales[i, k] = g_scale[k]
        matrix = (
            turned[0], turned[1], turned[2], turned[3], turned[4], turned[5], turned[6], turned[7], turned[8],
        )  # fmt: skip
        quat = rotation_backward(quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3], matrix)
        for k in range(4):
            d_quats[i, k] = quat[k]
        d_colours[i, 0], d_colours[i, 1], d_colours[i, 2] = red, green, blue


@njit(cache=True, nogil=True)
def transpose(offsets, atoms, count):
    """first (count + 1,) and rows (E,): for each column, the rows that hold it, ascending."""
    first = np.zeros(count + 1, np.int64)
    for atom in atoms:
        first[atom + 1] += 1
    for i in range(count):
        first[i + 1] += first[i]
    cursor = first[:-1].copy()
    rows = np.empty(len(atoms), np.int32)
    for row in range(len(offsets) - 1):
        for e in range(offsets[row], offsets[row + 1]):
            rows[cursor[atoms[e]]] = row
            cursor[atoms[e]] += 1
    return first, rows
