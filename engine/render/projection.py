"""EWA projection of a Gaussian (Zwicker et al. 2001, as INRIA's 3DGS and gsplat do it) and its derivative.

Device functions for numba kernels, on scalars and tuples of scalars or on `lanes`: hence no branches. They take floats
of any width and compute in float64: a projected mean is then right to the last bit of its float32 record, and scalar
code is no slower than in float32.

A Gaussian is represented by its *half axes* A = R_view R(q) diag(s) (3x3, row-major tuple of 9, camera axes): its
covariance in camera space is A A^T, and in the picture C0 = (J A)(J A)^T. Determinants come from cross products of
these rows, so a flat or enormous Gaussian loses no digits by cancellation.

Every forward function that training needs has its `_backward`: given dL/d(output), it returns dL/d(input).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from engine.render.lanes import maximum, minimum, root, where
from engine.scene.camera import Camera
from engine.scene.constants import CLAMP_MARGIN
from engine.scene.rotations import rotation_entries

__all__ = [
    "CameraRecord",
    "camera_point",
    "camera_point_backward",
    "camera_record",
    "conic",
    "conic_backward",
    "half_axes",
    "half_axes_backward",
    "jacobian",
    "jacobian_backward",
    "project_point",
    "project_point_backward",
    "rotation",
    "rotation_backward",
    "screen_axes",
    "screen_axes_backward",
    "screen_covariance",
    "screen_covariance_backward",
    "view_direction",
]


class CameraRecord(NamedTuple):
    """A camera as the kernels read it, all float64. A named tuple, which numba can read."""

    rotation: tuple[float, ...]
    """(9,). World to camera, by rows."""
    translation: tuple[float, ...]
    """(3,). World to camera."""
    fx: float
    """Pixels; for an orthographic camera, pixels per world unit."""
    fy: float
    cx: float
    """Pixels from the left edge."""
    cy: float
    x_low: float
    """x / z and y / z are clamped to these for the Jacobian."""
    x_high: float
    y_low: float
    y_high: float
    orthographic: float
    """1 or 0, so that formulas need no branch."""
    near: float
    """Least depth, world units; -inf if orthographic."""
    width: float
    """Pixels."""
    height: float


def camera_record(camera: Camera) -> CameraRecord:
    """The camera for kernels."""
    margin_x = CLAMP_MARGIN * 0.5 * camera.width / camera.fx
    margin_y = CLAMP_MARGIN * 0.5 * camera.height / camera.fy
    return CameraRecord(
        rotation=tuple(camera.viewmat[:3, :3].astype(np.float64).ravel().tolist()),
        translation=tuple(camera.viewmat[:3, 3].astype(np.float64).tolist()),
        fx=float(camera.fx),
        fy=float(camera.fy),
        cx=float(camera.cx),
        cy=float(camera.cy),
        x_low=-camera.cx / camera.fx - margin_x,
        x_high=(camera.width - camera.cx) / camera.fx + margin_x,
        y_low=-camera.cy / camera.fy - margin_y,
        y_high=(camera.height - camera.cy) / camera.fy + margin_y,
        orthographic=float(camera.orthographic),
        near=-math.inf if camera.orthographic else float(camera.near),
        width=float(camera.width),
        height=float(camera.height),
    )


@njit(cache=True, error_model="numpy")
def camera_point(cam, x, y, z):
    """(x, y, z) in camera space of a world point."""
    return (
        cam.rotation[0] * x + cam.rotation[1] * y + cam.rotation[2] * z + cam.translation[0],
        cam.rotation[3] * x + cam.rotation[4] * y + cam.rotation[5] * z + cam.translation[1],
        cam.rotation[6] * x + cam.rotation[7] * y + cam.rotation[8] * z + cam.translation[2],
    )


@njit(cache=True, error_model="numpy")
def camera_point_backward(cam, gx, gy, gz):
    """dL/d(world point) of `camera_point`: the transposed rotation."""
    return (
        cam.rotation[0] * gx + cam.rotation[3] * gy + cam.rotation[6] * gz,
        cam.rotation[1] * gx + cam.rotation[4] * gy + cam.rotation[7] * gz,
        cam.rotation[2] * gx + cam.rotation[5] * gy + cam.rotation[8] * gz,
    )


@njit(cache=True, error_model="numpy")
def view_direction(cam, eye, x, y, z):
    """(unit direction eye to world point, distance); an orthographic camera has one direction, distance 0."""
    if cam.orthographic != 0.0:
        return cam.rotation[6], cam.rotation[7], cam.rotation[8], 0.0
    dx, dy, dz = x - eye[0], y - eye[1], z - eye[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    per_length = 1.0 / max(length, 1e-12)
    return dx * per_length, dy * per_length, dz * per_length, length


@njit(cache=True, error_model="numpy")
def _per_depth(cam, z):
    """The perspective division: 1 / z; 1 if orthographic."""
    return 1.0 / (z * (1.0 - cam.orthographic) + cam.orthographic)


@njit(cache=True, error_model="numpy")
def project_point(cam, x, y, z):
    """(u, v) in pixels of a camera-space point; z must not be 0 unless orthographic."""
    per_depth = _per_depth(cam, z)
    return cam.fx * x * per_depth + cam.cx, cam.fy * y * per_depth + cam.cy


@njit(cache=True, error_model="numpy")
def project_point_backward(cam, x, y, z, gu, gv):
    """dL/d(camera-space point) of `project_point`."""
    per_depth = _per_depth(cam, z)
    gx = cam.fx * gu * per_depth
    gy = cam.fy * gv * per_depth
    return gx, gy, -(gx * x + gy * y) * per_depth * (1.0 - cam.orthographic)


@njit(cache=True, error_model="numpy")
def jacobian(cam, x, y, z):
    """(j00, j02, j11, j12) of the local affine projection J = [[j00, 0, j02], [0, j11, j12]], pixels per world unit.

    Pinhole: d(u, v)/d(x, y, z) with x/z and y/z clamped to the picture and a margin. Orthographic: diag(fx, fy).
    """
    per_depth, pinhole = _per_depth(cam, z), 1.0 - cam.orthographic
    slope_x = minimum(maximum(x * per_depth, cam.x_low), cam.x_high)
    slope_y = minimum(maximum(y * per_depth, cam.y_low), cam.y_high)
    j00, j11 = cam.fx * per_depth, cam.fy * per_depth
    return j00, -j00 * slope_x * pinhole, j11, -j11 * slope_y * pinhole


@njit(cache=True, error_model="numpy")
def jacobian_backward(cam, x, y, z, g00, g02, g11, g12):
    """dL/d(camera-space point) of `jacobian`; a clamped slope passes no gradient on to x or y."""
    per_depth, pinhole = _per_depth(cam, z), 1.0 - cam.orthographic
    fx2, fy2 = cam.fx * per_depth * per_depth * pinhole, cam.fy * per_depth * per_depth * pinhole
    slope_x, slope_y = x * per_depth, y * per_depth
    clamped_x = minimum(maximum(slope_x, cam.x_low), cam.x_high)
    clamped_y = minimum(maximum(slope_y, cam.y_low), cam.y_high)
    free_x, free_y = where(clamped_x == slope_x, 1.0, 0.0), where(clamped_y == slope_y, 1.0, 0.0)
    gz = -(g00 * fx2 + g11 * fy2) + g02 * fx2 * clamped_x * (1.0 + free_x) + g12 * fy2 * clamped_y * (1.0 + free_y)
    return -g02 * fx2 * free_x, -g12 * fy2 * free_y, gz


@njit(cache=True, error_model="numpy")
def _per_length(qw, qx, qy, qz):
    """One over the length of a quaternion; 0 for length 0, which then gives the identity."""
    length = root(qw * qw + qx * qx + qy * qy + qz * qz)
    return where(length > 0.0, 1.0 / length, 0.0)


_of_unit = njit(cache=True, error_model="numpy")(rotation_entries)


@njit(cache=True, error_model="numpy")
def rotation(qw, qx, qy, qz):
    """Rotation matrix (9, by rows) of a quaternion wxyz of any length; the identity for length 0."""
    unit = _per_length(qw, qx, qy, qz)
    return _of_unit(qw * unit, qx * unit, qy * unit, qz * unit)


@njit(cache=True, error_model="numpy")
def rotation_backward(qw, qx, qy, qz, g):
    """dL/dq (4,) of `rotation`, given dL/dR (9, by rows). Zero for a quaternion of length 0."""
    unit = _per_length(qw, qx, qy, qz)
    w, x, y, z = qw * unit, qx * unit, qy * unit, qz * unit
    g00, g01, g02, g10, g11, g12, g20, g21, g22 = g
    gw = 2.0 * (x * (g21 - g12) + y * (g02 - g20) + z * (g10 - g01))
    gx = 2.0 * (w * (g21 - g12) + y * (g01 + g10) + z * (g02 + g20)) - 4.0 * x * (g11 + g22)
    gy = 2.0 * (w * (g02 - g20) + x * (g01 + g10) + z * (g12 + g21)) - 4.0 * y * (g00 + g22)
    gz = 2.0 * (w * (g10 - g01) + x * (g02 + g20) + y * (g12 + g21)) - 4.0 * z * (g00 + g11)
    along = (
        gw * w + gx * x + gy * y + gz * z
    )  # the length of q is divided out: project its direction out of the gradient
    return (gw - along * w) * unit, (gx - along * x) * unit, (gy - along * y) * unit, (gz - along * z) * unit


@njit(cache=True, error_model="numpy")
def half_axes(cam, qw, qx, qy, qz, sx, sy, sz):
    """A = R_view R(q) diag(s) (9, by rows): column k is the k-th principal half axis in camera space."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(qw, qx, qy, qz)
    return (
        (cam.rotation[0] * r00 + cam.rotation[1] * r10 + cam.rotation[2] * r20) * sx,
        (cam.rotation[0] * r01 + cam.rotation[1] * r11 + cam.rotation[2] * r21) * sy,
        (cam.rotation[0] * r02 + cam.rotation[1] * r12 + cam.rotation[2] * r22) * sz,
        (cam.rotation[3] * r00 + cam.rotation[4] * r10 + cam.rotation[5] * r20) * sx,
        (cam.rotation[3] * r01 + cam.rotation[4] * r11 + cam.rotation[5] * r21) * sy,
        (cam.rotation[3] * r02 + cam.rotation[4] * r12 + cam.rotation[5] * r22) * sz,
        (cam.rotation[6] * r00 + cam.rotation[7] * r10 + cam.rotation[8] * r20) * sx,
        (cam.rotation[6] * r01 + cam.rotation[7] * r11 + cam.rotation[8] * r21) * sy,
        (cam.rotation[6] * r02 + cam.rotation[7] * r12 + cam.rotation[8] * r22) * sz,
    )


@njit(cache=True, error_model="numpy")
def half_axes_backward(cam, qw, qx, qy, qz, sx, sy, sz, g):
    """((dL/dq, 4), (dL/ds, 3)) of `half_axes`, given dL/dA (9, by rows)."""
    g00, g01, g02, g10, g11, g12, g20, g21, g22 = g
    # B = R_view^T dL/dA: the gradient in world axes.
    b00 = cam.rotation[0] * g00 + cam.rotation[3] * g10 + cam.rotation[6] * g20
    b01 = cam.rotation[0] * g01 + cam.rotation[3] * g11 + cam.rotation[6] * g21
    b02 = cam.rotation[0] * g02 + cam.rotation[3] * g12 + cam.rotation[6] * g22
    b10 = cam.rotation[1] * g00 + cam.rotation[4] * g10 + cam.rotation[7] * g20
    b11 = cam.rotation[1] * g01 + cam.rotation[4] * g11 + cam.rotation[7] * g21
    b12 = cam.rotation[1] * g02 + cam.rotation[4] * g12 + cam.rotation[7] * g22
    b20 = cam.rotation[2] * g00 + cam.rotation[5] * g10 + cam.rotation[8] * g20
    b21 = cam.rotation[2] * g01 + cam.rotation[5] * g11 + cam.rotation[8] * g21
    b22 = cam.rotation[2] * g02 + cam.rotation[5] * g12 + cam.rotation[8] * g22
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(qw, qx, qy, qz)
    scale_gradient = (
        r00 * b00 + r10 * b10 + r20 * b20,
        r01 * b01 + r11 * b11 + r21 * b21,
        r02 * b02 + r12 * b12 + r22 * b22,
    )
    matrix = (b00 * sx, b01 * sy, b02 * sz, b10 * sx, b11 * sy, b12 * sz, b20 * sx, b21 * sy, b22 * sz)
    return rotation_backward(qw, qx, qy, qz, matrix), scale_gradient


@njit(cache=True, error_model="numpy")
def screen_axes(j, a):
    """B = J A (6, by rows), pixels: the half axes in the picture, from `jacobian` and `half_axes`."""
    j00, j02, j11, j12 = j
    return (
        j00 * a[0] + j02 * a[6],
        j00 * a[1] + j02 * a[7],
        j00 * a[2] + j02 * a[8],
        j11 * a[3] + j12 * a[6],
        j11 * a[4] + j12 * a[7],
        j11 * a[5] + j12 * a[8],
    )


@njit(cache=True, error_model="numpy")
def screen_axes_backward(j, a, g):
    """((dL/dj, 4), (dL/dA, 9)) of `screen_axes`, given dL/dB (6)."""
    j00, j02, j11, j12 = j
    return (
        (
            g[0] * a[0] + g[1] * a[1] + g[2] * a[2],
            g[0] * a[6] + g[1] * a[7] + g[2] * a[8],
            g[3] * a[3] + g[4] * a[4] + g[5] * a[5],
            g[3] * a[6] + g[4] * a[7] + g[5] * a[8],
        ),
        (
            j00 * g[0],
            j00 * g[1],
            j00 * g[2],
            j11 * g[3],
            j11 * g[4],
            j11 * g[5],
            j02 * g[0] + j12 * g[3],
            j02 * g[1] + j12 * g[4],
            j02 * g[2] + j12 * g[5],
        ),
    )


@njit(cache=True, error_model="numpy")
def screen_covariance(b, low_pass):
    """(xx, xy, yy, det, det0) of C = B B^T + low_pass I, px^2; det0 is the determinant without the low-pass."""
    xx = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    xy = b[0] * b[3] + b[1] * b[4] + b[2] * b[5]
    yy = b[3] * b[3] + b[4] * b[4] + b[5] * b[5]
    c0 = b[1] * b[5] - b[2] * b[4]
    c1 = b[2] * b[3] - b[0] * b[5]
    c2 = b[0] * b[4] - b[1] * b[3]
    det0 = c0 * c0 + c1 * c1 + c2 * c2
    return xx + low_pass, xy, yy + low_pass, det0 + low_pass * (xx + yy) + low_pass * low_pass, det0


@njit(cache=True, error_model="numpy")
def screen_covariance_backward(b, gxx, gxy, gyy):
    """dL/dB (6) of the entries xx, xy, yy of `screen_covariance` (xy counted once)."""
    return (
        2.0 * gxx * b[0] + gxy * b[3],
        2.0 * gxx * b[1] + gxy * b[4],
        2.0 * gxx * b[2] + gxy * b[5],
        2.0 * gyy * b[3] + gxy * b[0],
        2.0 * gyy * b[4] + gxy * b[1],
        2.0 * gyy * b[5] + gxy * b[2],
    )


@njit(cache=True, error_model="numpy")
def conic(xx, xy, yy, det):
    """(a, b, c) of the inverse of [[xx, xy], [xy, yy]]: q(dx, dy) = a dx^2 + 2 b dx dy + c dy^2."""
    per_det = 1.0 / det
    return yy * per_det, -xy * per_det, xx * per_det


@njit(cache=True, error_model="numpy")
def conic_backward(a, b, c, ga, gb, gc):
    """dL/d(xx, xy, yy) of `conic` (xy and b counted once): -K G K with G = [[ga, gb/2], [gb/2, gc]]."""
    h = 0.5 * gb
    ka = a * ga + b * h
    kb = a * h + b * gc
    kc = b * ga + c * h
    kd = b * h + c * gc
    return -(ka * a + kb * b), -(ka * b + kb * c + kc * a + kd * b), -(kc * b + kd * c)
