"""Solids over shapes in a face: how tall they are at each pixel, and where its edge is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.distance_transform import depth_in
from training.priors.exemplar.quilting.disc import PIXEL, disc_grid, disc_radius

__all__ = ["depth_of", "form_around", "form_of", "thickest"]

EDGE = 1.5
"""Standard deviation in pixels of the blur of depths: the edge of a shape has steps of whole pixels."""

DIRECTIONS = 180
"""Directions in which the outline of a core in one piece is sampled: about a pixel of a small one's."""


def depth_of(shape: NDArray[np.bool_]) -> NDArray[np.floating]:
    """(P, P). Distance in radii of each pixel from the edge of a shape (P, P), negative outside of it."""
    return ndimage.gaussian_filter(depth_in(shape) - depth_in(~shape), EDGE) * PIXEL


def form_of(shape: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(P, P, 4). The form of a solid over a shape (P, P) that is as tall as it is wide, with half heights in radii.
    Outside it goes on as at the nearest pixel, beyond the edge."""
    within, depth = depth_in(shape), depth_of(shape)
    thick = _thickness(within) * PIXEL
    way = -np.stack(np.gradient(ndimage.gaussian_filter(within, 1.0)), -1)
    way *= (thick / np.maximum(np.linalg.norm(way, axis=-1), 0.05))[..., None]
    if not shape.all():
        nearest = tuple(ndimage.distance_transform_edt(~shape, return_distances=False, return_indices=True))
        thick, way = thick[nearest], way[nearest]
    off = 1 - depth / np.maximum(thick, 1e-6)
    return np.concatenate([thick[..., None], off[..., None], way], -1).astype(np.float32)


def form_around(shape: NDArray[np.bool_], u: float, v: float) -> NDArray[np.float32]:
    """(P, P, 4). The form of a solid whose cuts have this shape (P, P), larger or smaller around the place (u, v)."""
    x, y = disc_grid()
    x, y = x - u, y - v
    away, turn = np.hypot(x, y), np.arctan2(y, x) % (2 * np.pi)
    ends = np.zeros(DIRECTIONS)
    np.maximum.at(ends, (turn[shape] / (2 * np.pi) * DIRECTIONS).astype(int), away[shape])
    known = np.flatnonzero(ends)
    angles = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS * 2 * np.pi
    ends = np.interp(angles, angles[known], ends[known], period=2 * np.pi) + PIXEL / 2
    edge = np.interp(turn, angles, ndimage.gaussian_filter1d(ends, 1.0, mode="wrap"), period=2 * np.pi)
    off = np.minimum(away / edge, 1)
    way = np.stack([x, y], -1) * (edge / np.maximum(away, PIXEL))[..., None]
    return np.concatenate([np.stack([edge * (off < 1), off], -1), way], -1).astype(np.float32)


def thickest(shape: NDArray[np.bool_]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Distances from the middle of a horizontal face at which it shows a shape (P, P), rising, and how thick that is at
    most there, in radii."""
    ring = (disc_radius()[shape] / PIXEL).astype(int)
    thick = np.zeros(ring.max() + 1)
    np.maximum.at(thick, ring, _thickness(depth_in(shape))[shape] * PIXEL)
    shown = np.flatnonzero(thick)
    return (shown + 0.5) * PIXEL, thick[shown]


def _thickness(depth: NDArray[np.floating]) -> NDArray[np.floating]:
    """(H, W). The radius of the largest disc in a shape that holds the pixel, for the depths (H, W) of its pixels
    (local thickness, Hildebrand and Ruegsegger 1997); in corners that of the nearest pixel which one holds."""
    half = int(depth.max()) + 1
    axis = np.arange(-half, half + 1)
    away = np.hypot(axis[:, None], axis)
    out = np.pad(np.zeros_like(depth), half)
    for i, j in np.argwhere((depth > 0) & (depth >= ndimage.maximum_filter(depth, 3) - 0.5)):
        here = out[i : i + 2 * half + 1, j : j + 2 * half + 1]
        np.maximum(here, np.where(away < depth[i, j], depth[i, j], 0), out=here)
    thick = out[half:-half, half:-half]
    corners = (depth > 0) & (thick == 0)
    if corners.any():
        nearest = ndimage.distance_transform_edt(thick == 0, return_distances=False, return_indices=True)
        thick = np.where(corners, thick[tuple(nearest)], thick)
    return thick
