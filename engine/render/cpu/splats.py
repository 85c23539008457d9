"""Splats of the opaque image: projected to the records that the pixel loops read, and the gradients back from them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.projection import (
    camera_point,
    camera_point_backward,
    conic,
    conic_backward,
    half_axes,
    half_axes_backward,
    jacobian,
    jacobian_backward,
    project_point,
    project_point_backward,
    screen_axes,
    screen_axes_backward,
    screen_covariance,
    screen_covariance_backward,
)
from engine.scene.constants import CUTOFF_Q, EDGE_SLOPE, LOW_PASS

__all__ = [
    "DEPTH",
    "DEPTH_EXTENT",
    "DEPTH_LIMIT",
    "DEPTH_X",
    "DEPTH_Y",
    "GRADIENT",
    "RECORD",
    "SHARPNESS",
    "SHEAR",
    "SIGMA_X",
    "SIGMA_Y",
    "TILE",
    "U_FRACTION",
    "V_FRACTION",
    "WEIGHT",
    "WHITEN_X",
    "WHITEN_Y",
    "Splats",
    "U",
    "V",
    "project",
    "project_backward",
]

TILE = 8
"""Edge of a tile in pixels: a row is one vector of floats, and 16 pixels would waste half of a small splat's tile."""

RECORD = 16
"""Numbers in a record, 64 bytes in float32: one cache line. Their places are the constants below."""

U, U_FRACTION, V, V_FRACTION = 0, 1, 2, 3
"""Integer and fractional part of the mean, pixels: together they keep the digits that one float32 would lose."""

WHITEN_X, WHITEN_Y, SHEAR = 4, 5, 6
"""q / 2 = m^2 + n^2 with m = WHITEN_X dx, n = WHITEN_Y (dy + SHEAR dx): squares lose no digits on needles."""

DEPTH, DEPTH_X, DEPTH_Y, DEPTH_LIMIT, DEPTH_EXTENT = 7, 8, 9, 10, 11
"""Depth at the mean; its change per pixel in x and in y; the value that its change is clamped to, and the largest
change within the cutoff. World units."""

WEIGHT, SHARPNESS = 12, 13
"""Weight rho = sqrt(det C0 / det C), and rho times the sharpness of an edge."""

SIGMA_X, SIGMA_Y = 14, 15
"""Standard deviations in x and y, pixels."""

GRADIENT = 10
"""Sums over pixels that a (tile, splat) pair hands back, with p = dL/d(q/2): p dx, p dy, p dx^2, p dx dy, p dy^2; then
the gradients of WEIGHT, SHARPNESS and the three colours."""


class Splats(NamedTuple):
    """N ellipsoids of one float type, contiguous; or their gradients. A named tuple, which numba can read."""

    means: NDArray[np.floating]
    """(N, 3). World units."""
    scales: NDArray[np.floating]
    """(N, 3). Standard deviations, world units."""
    quats: NDArray[np.floating]
    """(N, 4). wxyz, any length."""


@njit(cache=True, error_model="numpy")
def distance_range(cam, plane, u0, u1, v0, v1, z0, z1):
    """Least and greatest signed distance to a camera-space plane (4,) of points at pixels [u0, u1] x [v0, v1] and
    depths [z0, z1]. The distance is affine in each of the three, so its extremes are at the corners."""
    low, high = np.inf, -np.inf
    for k in range(8):
        u = u1 if k & 1 else u0
        v = v1 if k & 2 else v0
        z = z1 if k & 4 else z0
        x, y = (u - cam.cx) / cam.fx, (v - cam.cy) / cam.fy
        if cam.orthographic == 0.0:
            x, y = x * z, y * z
        distance = plane[0] * x + plane[1] * y + plane[2] * z + plane[3]
        low, high = min(low, distance), max(high, distance)
    return low, high


@njit(cache=True, error_model="numpy")
def least_eigenvalue(xx, xy, yy, det):
    """Smaller eigenvalue of [[xx, xy], [xy, yy]], and half the difference of the two."""
    half = 0.5 * (xx - yy)
    radius = math.sqrt(half * half + xy * xy)
    return det / (0.5 * (xx + yy) + radius), radius


@njit(cache=True, error_model="numpy", nogil=True)
def project(
    chunk,
    chunk_size,
    cam,
    planes,  # [P, 4] camera space
    plane_range,  # [2] first and end of the planes that bound these splats
    splats,  # Splats
    records,  # out [N, RECORD]
    spans,  # out [N, 6] first and end tile in x and in y; first and end of the planes that may cut it
):
    """Projects one chunk of splats. One that cannot be seen gets an empty span of tiles."""
    means, scales, quats = splats.means, splats.scales, splats.quats
    width, height = cam.width, cam.height
    extent = math.sqrt(CUTOFF_Q)
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(means))):
        spans[i, :] = 0
        x, y, z = camera_point(cam, means[i, 0], means[i, 1], means[i, 2])
        if not z > cam.near:
            continue
        u, v = project_point(cam, x, y, z)
        axes = half_axes(
            cam, quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3], scales[i, 0], scales[i, 1], scales[i, 2]
        )
        flat = screen_axes(jacobian(cam, x, y, z), axes)
        xx, xy, yy, det, det0 = screen_covariance(flat, LOW_PASS)
        if not (det > 0.0 and det < np.inf):
            continue
        sx, sy = math.sqrt(xx), math.sqrt(yy)
        x0, x1 = max(math.ceil(u - extent * sx - 0.5), 0.0), min(math.floor(u + extent * sx + 0.5), width)
        y0, y1 = max(math.ceil(v - extent * sy - 0.5), 0.0), min(math.floor(v + extent * sy + 0.5), height)
        if not (x0 < x1 and y0 < y1):
            continue
        a, b, c = conic(xx, xy, yy, det)
        depth_x = flat[0] * axes[6] + flat[1] * axes[7] + flat[2] * axes[8]
        depth_y = flat[3] * axes[6] + flat[4] * axes[7] + flat[5] * axes[8]
        kx, ky = a * depth_x + b * depth_y, b * depth_x + c * depth_y
        reach = extent * math.sqrt(axes[6] * axes[6] + axes[7] * axes[7] + axes[8] * axes[8])
        # Over the ellipse q <= CUTOFF_Q the affine depth changes by no more than this.
        depth_extent = min(extent * math.sqrt(max(kx * depth_x + ky * depth_y, 0.0)), reach)
        cut = False
        removed = False
        for p in range(plane_range[0], plane_range[1]):
            low, high = distance_range(
                cam, planes[p], x0 + 0.5, x1 - 0.5, y0 + 0.5, y1 - 0.5, z - depth_extent, z + depth_extent
            )
            removed = removed or low > 0.0
            cut = cut or high > 0.0
        if removed:
            continue
        least, _ = least_eigenvalue(xx, xy, yy, det)
        weight = math.sqrt(det0 / det)
        r = records[i]
        r[U], r[V] = math.floor(u), math.floor(v)
        r[U_FRACTION], r[V_FRACTION] = u - math.floor(u), v - math.floor(v)
        r[WHITEN_X], r[WHITEN_Y], r[SHEAR] = 1.0 / math.sqrt(2.0 * xx), math.sqrt(0.5 * c), -xy / xx
        r[DEPTH], r[DEPTH_X], r[DEPTH_Y], r[DEPTH_LIMIT], r[DEPTH_EXTENT] = z, kx, ky, reach, depth_extent
        r[WEIGHT], r[SHARPNESS] = weight, weight * max(1.0, math.sqrt(least) / EDGE_SLOPE)
        r[SIGMA_X], r[SIGMA_Y] = sx, sy
        spans[i, 0], spans[i, 1] = int(x0) // TILE, (int(x1) - 1) // TILE + 1
        spans[i, 2], spans[i, 3] = int(y0) // TILE, (int(y1) - 1) // TILE + 1
        if cut:
            spans[i, 4], spans[i, 5] = plane_range[0], plane_range[1]


@njit(cache=True, error_model="numpy", nogil=True)
def project_backward(
    chunk,
    chunk_size,
    cam,
    splats,  # Splats
    first_rows,  # [N + 1]
    rows,  # [pairs, GRADIENT]
    d_splats,  # out Splats
    d_colours,  # out [N, 3]
):
    """Sums the rows of each splat of one chunk in order and takes them back through the projection.

    Depth, clipping and the choice of fragments are treated as constants.
    """
    means, scales, quats = splats.means, splats.scales, splats.quats
    d_means, d_scales, d_quats = d_splats.means, d_splats.scales, d_splats.quats
    sums = np.empty(GRADIENT)
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(means))):
        d_means[i, :] = 0
        d_scales[i, :] = 0
        d_quats[i, :] = 0
        d_colours[i, :] = 0
        sums[:] = 0.0
        for row in range(first_rows[i], first_rows[i + 1]):
            for k in range(GRADIENT):
                sums[k] += rows[row, k]
        touched = False
        for k in range(GRADIENT):
            touched = touched or sums[k] != 0.0
        if not touched:
            continue
        x, y, z = camera_point(cam, means[i, 0], means[i, 1], means[i, 2])
        qw, qx, qy, qz = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        axes = half_axes(cam, qw, qx, qy, qz, scales[i, 0], scales[i, 1], scales[i, 2])
        j = jacobian(cam, x, y, z)
        flat = screen_axes(j, axes)
        xx, xy, yy, det, det0 = screen_covariance(flat, LOW_PASS)
        a, b, c = conic(xx, xy, yy, det)
        gu, gv = -(a * sums[0] + b * sums[1]), -(b * sums[0] + c * sums[1])
        gxx, gxy, gyy = conic_backward(a, b, c, 0.5 * sums[2], sums[3], 0.5 * sums[4])

        weight = math.sqrt(det0 / det)
        least, radius = least_eigenvalue(xx, xy, yy, det)
        sharp = math.sqrt(least) / EDGE_SLOPE
        g_weight = sums[5] + sums[6] * max(1.0, sharp)
        if sharp > 1.0:
            g_least = sums[6] * weight / (2.0 * math.sqrt(least) * EDGE_SLOPE)
            slant = 0.5 * (xx - yy) / radius if radius > 0.0 else 0.0
            gxx += g_least * 0.5 * (1.0 - slant)
            gyy += g_least * 0.5 * (1.0 + slant)
            gxy -= g_least * xy / radius if radius > 0.0 else 0.0
        # rho = |r1 x r2| / sqrt(det) with r1, r2 the rows of `flat`.
        g_det = -0.5 * weight / det * g_weight
        gxx += g_det * yy
        gyy += g_det * xx
        gxy -= 2.0 * g_det * xy
        g0, g1, g2, g3, g4, g5 = screen_covariance_backward(flat, gxx, gxy, gyy)
        area = math.sqrt(det0)
        if area > 0.0:
            n0 = (flat[1] * flat[5] - flat[2] * flat[4]) / area
            n1 = (flat[2] * flat[3] - flat[0] * flat[5]) / area
            n2 = (flat[0] * flat[4] - flat[1] * flat[3]) / area
            g_area = g_weight / math.sqrt(det)
            g0 += g_area * (flat[4] * n2 - flat[5] * n1)
            g1 += g_area * (flat[5] * n0 - flat[3] * n2)
            g2 += g_area * (flat[3] * n1 - flat[4] * n0)
            g3 += g_area * (n1 * flat[2] - n2 * flat[1])
            g4 += g_area * (n2 * flat[0] - n0 * flat[2])
            g5 += g_area * (n0 * flat[1] - n1 * flat[0])
        gj, g_axes = screen_axes_backward(j, axes, (g0, g1, g2, g3, g4, g5))
        cx, cy, cz = jacobian_backward(cam, x, y, z, gj[0], gj[1], gj[2], gj[3])
        px, py, pz = project_point_backward(cam, x, y, z, gu, gv)
        d_means[i, 0], d_means[i, 1], d_means[i, 2] = camera_point_backward(cam, cx + px, cy + py, cz + pz)
        g_quat, g_scale = half_axes_backward(cam, qw, qx, qy, qz, scales[i, 0], scales[i, 1], scales[i, 2], g_axes)
        for k in range(4):
            d_quats[i, k] = g_quat[k]
        for k in range(3):
            d_scales[i, k] = g_scale[k]
            d_colours[i, k] = sums[7 + k]
