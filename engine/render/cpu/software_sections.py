"""Sections of atoms with a plane, in software: where the plane cuts an ellipsoid, a Gaussian in the plane."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.projection import CameraRecord, rotation
from engine.scene.constants import CUTOFF_Q
from engine.scene.sh import C0

__all__ = ["BAND", "SECTION", "AtomBatch", "SectionView", "bin_bands", "sections"]

BAND = 8
"""Rows of the picture in a task."""

SECTION = 10
"""Numbers in a record: 0 1 centre s, t; 2 3 4 conic, q / 2 = r2 ds^2 + r3 ds dt + r4 dt^2; 5 q / 2 at which it ends;
6 weight, 7 8 9 weight times RGB."""


class AtomBatch(NamedTuple):
    """Atoms chosen from a store. A named tuple, which numba can read."""

    rows: NDArray[np.uint32]
    """(N,). Which of the store's A atoms."""
    geometry: NDArray[np.float32]
    """(A, 10): mean, scales, quat; or (A, 4): mean, sigma."""
    colours: NDArray[np.float32]
    """(A, 3) RGB, or (A, C > 3) coefficients of spherical harmonics, three channels each."""
    enlarge: float
    """Factor on the standard deviations."""


class SectionView(NamedTuple):
    """A plane and the camera that sees it. A named tuple, which numba can read."""

    plane: NDArray[np.float64]
    """(4,). Object space."""
    e1: NDArray[np.float64]
    """(3,). Unit vectors in the plane."""
    e2: NDArray[np.float64]
    matrix: NDArray[np.float64]
    """(4, 4). Object space to camera."""
    cam: CameraRecord


@njit(cache=True, error_model="numpy", nogil=True)
def sections(
    chunk,
    chunk_size,
    atoms,  # AtomBatch
    view,  # SectionView
    records,  # out [N, SECTION]
    boxes,  # out [N, 4] first and end pixel in x and in y
):
    """The sections of some atoms with a plane, and the pixels that they can touch; an empty box if there are none."""
    rows, geometry, colours, enlarge = atoms.rows, atoms.geometry, atoms.colours, atoms.enlarge
    plane, e1, e2, matrix, cam = view.plane, view.e1, view.e2, view.matrix, view.cam
    orthographic, near, width, height = cam.orthographic != 0.0, cam.near, int(cam.width), int(cam.height)
    per_pixel = 1.0 / math.sqrt(cam.fx * cam.fy)
    coefficient, ball = colours.shape[1] > 3, geometry.shape[1] == 4
    identity = rotation(1.0, 0.0, 0.0, 0.0)
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(rows))):
        g = geometry[rows[i]]
        boxes[i, :] = 0
        x, y, z = float(g[0]), float(g[1]), float(g[2])
        distance = plane[0] * x + plane[1] * y + plane[2] * z + plane[3]
        fx, fy, fz = x - distance * plane[0], y - distance * plane[1], z - distance * plane[2]
        deep = matrix[2, 0] * fx + matrix[2, 1] * fy + matrix[2, 2] * fz + matrix[2, 3]
        least = 0.5 * per_pixel * (1.0 if orthographic else max(deep, near))
        aa, ab, bb, ad, bd, dd, weight = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
        axes = identity if ball else rotation(g[6], g[7], g[8], g[9])
        for k in range(3):
            sigma = g[3 if ball else 3 + k] * enlarge
            used = max(sigma, least)
            weight *= sigma / used
            a = (axes[k] * e1[0] + axes[3 + k] * e1[1] + axes[6 + k] * e1[2]) / used
            b = (axes[k] * e2[0] + axes[3 + k] * e2[1] + axes[6 + k] * e2[2]) / used
            d = -distance * (axes[k] * plane[0] + axes[3 + k] * plane[1] + axes[6 + k] * plane[2]) / used
            aa += a * a
            ab += a * b
            bb += b * b
            ad += a * d
            bd += b * d
            dd += d * d
        det = aa * bb - ab * ab
        if not det > 0.0:
            continue
        ms, mt = (ab * bd - bb * ad) / det, (ab * ad - aa * bd) / det
        nn = max(dd + ms * ad + mt * bd, 0.0)
        left = CUTOFF_Q - nn
        if not left > 0.0:
            continue
        s = e1[0] * x + e1[1] * y + e1[2] * z + ms
        t = e2[0] * x + e2[1] * y + e2[2] * z + mt
        reach_s, reach_t = math.sqrt(left * bb / det), math.sqrt(left * aa / det)
        x0, x1, y0, y1, unbounded = np.inf, -np.inf, np.inf, -np.inf, False
        for corner in range(4):
            cs = s + (reach_s if corner & 1 else -reach_s)
            ct = t + (reach_t if corner & 2 else -reach_t)
            px = cs * e1[0] + ct * e2[0] - plane[3] * plane[0]
            py = cs * e1[1] + ct * e2[1] - plane[3] * plane[1]
            pz = cs * e1[2] + ct * e2[2] - plane[3] * plane[2]
            cx = matrix[0, 0] * px + matrix[0, 1] * py + matrix[0, 2] * pz + matrix[0, 3]
            cy = matrix[1, 0] * px + matrix[1, 1] * py + matrix[1, 2] * pz + matrix[1, 3]
            cz = matrix[2, 0] * px + matrix[2, 1] * py + matrix[2, 2] * pz + matrix[2, 3]
            over = 1.0 if orthographic else cz
            if not over > 1e-9:
                unbounded = True  # beside or behind the eye: it may be anywhere in the picture
                continue
            u, v = cam.fx * cx / over + cam.cx, cam.fy * cy / over + cam.cy
            x0, x1, y0, y1 = min(x0, u), max(x1, u), min(y0, v), max(y1, v)
        if unbounded:
            x0, x1, y0, y1 = 0.0, float(width), 0.0, float(height)
        # Right before the eye, a point may be farther out of the picture than an integer can say.
        x0, x1 = min(max(math.floor(x0), 0.0), width), max(min(math.ceil(x1) + 1.0, width), 0.0)
        y0, y1 = min(max(math.floor(y0), 0.0), height), max(min(math.ceil(y1) + 1.0, height), 0.0)
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = int(x0), int(x1), int(y0), int(y1)
        if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
            boxes[i, :] = 0
            continue
        weight *= math.exp(-0.5 * nn)
        r = records[i]
        r[0], r[1], r[2], r[3], r[4], r[5], r[6] = s, t, 0.5 * aa, ab, 0.5 * bb, 0.5 * left, weight
        for c in range(3):
            value = float(colours[rows[i], c])
            r[7 + c] = weight * (max(0.5 + C0 * value, 0.0) if coefficient else value)


@njit(cache=True, error_model="numpy", nogil=True)
def bin_bands(boxes, bands):
    """(band_starts (bands + 1,), section_ids (pairs,)): the sections that touch each band of rows, ascending."""
    band_starts = np.zeros(bands + 1, np.int64)
    for i in range(len(boxes)):
        if boxes[i, 3] > boxes[i, 2]:
            for band in range(boxes[i, 2] // BAND, (boxes[i, 3] - 1) // BAND + 1):
                band_starts[band + 1] += 1
    for band in range(bands):
        band_starts[band + 1] += band_starts[band]
    section_ids = np.empty(band_starts[bands], np.int32)
    cursor = band_starts[:-1].copy()
    for i in range(len(boxes)):
        if boxes[i, 3] > boxes[i, 2]:
            for band in range(boxes[i, 2] // BAND, (boxes[i, 3] - 1) // BAND + 1):
                section_ids[cursor[band]] = i
                cursor[band] += 1
    return band_starts, section_ids
