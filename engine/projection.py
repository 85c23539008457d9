"""EWA projection of a Gaussian (Zwicker et al. 2001, as INRIA's 3DGS and gsplat do it) and its derivative.

Device functions for numba kernels, on scalars and tuples of scalars or on `engine.cpu.lanes`: hence no branches. They
take floats of any width and compute in float64: a projected mean is then right to the last bit that its float32 home
holds, and in scalar code it costs no more than float32.

A Gaussian is handled through its *half axes* A = R_view R(q) diag(s) (3x3, row-major tuple of 9, camera axes): its
covariance in camera space is A A^T, and on the picture C0 = (J A)(J A)^T. Determinants come from cross products of
these rows, so a flat or enormous Gaussian loses no digits by cancellation.

Every forward function that training needs has its `_backward`: given dL/d(output), it returns dL/d(input).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.camera import Camera
from engine.cpu.lanes import maximum, minimum, root, where

__all__ = [
    "CAMERA_SIZE",
    "camera_point",
    "camera_point_backward",
    "conic",
    "conic_backward",
    "half_axes",
    "half_axes_backward",
    "jacobian",
    "jacobian_backward",
    "pack_camera",
    "project_point",
    "project_point_backward",
    "rotation",
    "rotation_backward",
    "screen_axes",
    "screen_axes_backward",
    "screen_covariance",
    "screen_covariance_backward",
]

CAMERA_SIZE = 24
"""Numbers in a packed camera."""

CLAMP_MARGIN = 0.3
"""How far outside the picture, in half widths, the Jacobian still follows a mean; beyond it is held, because the affine
approximation explodes there (INRIA and gsplat use the same number)."""

# Indices into a packed camera: 0..8 the rotation by rows, then
_T, _FX, _FY, _CX, _CY, _X_LOW, _X_HIGH, _Y_LOW, _Y_HIGH, _ORTHO, _NEAR = 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21


def pack_camera(camera: Camera) -> NDArray[np.float64]:
    """(CAMERA_SIZE,) float64. The camera as the kernels read it.

    0..8 rotation world to camera by rows, 9..11 translation, 12..15 fx fy cx cy, 16..19 bounds of x/z and y/z that the
    Jacobian is held within (x low, x high, y low, y high), 20 one if orthographic, 21 near depth (-inf if
    orthographic), 22..23 width and height in pixels.
    """
    packed = np.zeros(CAMERA_SIZE)
    packed[:9] = camera.viewmat[:3, :3].ravel()
    packed[_T : _T + 3] = camera.viewmat[:3, 3]
    packed[_FX : _CY + 1] = camera.fx, camera.fy, camera.cx, camera.cy
    margin_x = CLAMP_MARGIN * 0.5 * camera.width / camera.fx
    margin_y = CLAMP_MARGIN * 0.5 * camera.height / camera.fy
    packed[_X_LOW] = -camera.cx / camera.fx - margin_x
    packed[_X_HIGH] = (camera.width - camera.cx) / camera.fx + margin_x
    packed[_Y_LOW] = -camera.cy / camera.fy - margin_y
    packed[_Y_HIGH] = (camera.height - camera.cy) / camera.fy + margin_y
    packed[_ORTHO] = float(camera.orthographic)
    packed[_NEAR] = -np.inf if camera.orthographic else camera.near
    packed[22:] = camera.width, camera.height
    return packed


@njit(cache=True, error_model="numpy")
def camera_point(cam, x, y, z):  # type: ignore[no-untyped-def]
    """(x, y, z) in camera space of a world point."""
    return (
        cam[0] * x + cam[1] * y + cam[2] * z + cam[9],
        cam[3] * x + cam[4] * y + cam[5] * z + cam[10],
        cam[6] * x + cam[7] * y + cam[8] * z + cam[11],
    )


@njit(cache=True, error_model="numpy")
def camera_point_backward(cam, gx, gy, gz):  # type: ignore[no-untyped-def]
    """dL/d(world point) of `camera_point`: the transposed rotation."""
    return (
        cam[0] * gx + cam[3] * gy + cam[6] * gz,
        cam[1] * gx + cam[4] * gy + cam[7] * gz,
        cam[2] * gx + cam[5] * gy + cam[8] * gz,
    )


@njit(cache=True, error_model="numpy")
def _per_depth(cam, z):  # type: ignore[no-untyped-def]
    """What a picture shrinks by with depth: 1 / z; 1 if orthographic."""
    return 1.0 / (z * (1.0 - cam[_ORTHO]) + cam[_ORTHO])


@njit(cache=True, error_model="numpy")
def project_point(cam, x, y, z):  # type: ignore[no-untyped-def]
    """(u, v) in pixels of a camera-space point; z must not be 0 unless orthographic."""
    per_depth = _per_depth(cam, z)
    return cam[_FX] * x * per_depth + cam[_CX], cam[_FY] * y * per_depth + cam[_CY]


@njit(cache=True, error_model="numpy")
def project_point_backward(cam, x, y, z, gu, gv):  # type: ignore[no-untyped-def]
    """dL/d(camera-space point) of `project_point`."""
    per_depth = _per_depth(cam, z)
    gx = cam[_FX] * gu * per_depth
    gy = cam[_FY] * gv * per_depth
    return gx, gy, -(gx * x + gy * y) * per_depth * (1.0 - cam[_ORTHO])


@njit(cache=True, error_model="numpy")
def jacobian(cam, x, y, z):  # type: ignore[no-untyped-def]
    """(j00, j02, j11, j12) of the local affine projection J = [[j00, 0, j02], [0, j11, j12]], pixels per world unit.

    Pinhole: d(u, v)/d(x, y, z) with x/z and y/z held within the picture and a margin. Orthographic: diag(fx, fy).
    """
    per_depth, pinhole = _per_depth(cam, z), 1.0 - cam[_ORTHO]
    slope_x = minimum(maximum(x * per_depth, cam[_X_LOW]), cam[_X_HIGH])
    slope_y = minimum(maximum(y * per_depth, cam[_Y_LOW]), cam[_Y_HIGH])
    j00, j11 = cam[_FX] * per_depth, cam[_FY] * per_depth
    return j00, -j00 * slope_x * pinhole, j11, -j11 * slope_y * pinhole


@njit(cache=True, error_model="numpy")
def jacobian_backward(cam, x, y, z, g00, g02, g11, g12):  # type: ignore[no-untyped-def]
    """dL/d(camera-space point) of `jacobian`; a slope that is held passes nothing on to x or y."""
    per_depth, pinhole = _per_depth(cam, z), 1.0 - cam[_ORTHO]
    fx2, fy2 = cam[_FX] * per_depth * per_depth * pinhole, cam[_FY] * per_depth * per_depth * pinhole
    slope_x, slope_y = x * per_depth, y * per_depth
    held_x = minimum(maximum(slope_x, cam[_X_LOW]), cam[_X_HIGH])
    held_y = minimum(maximum(slope_y, cam[_Y_LOW]), cam[_Y_HIGH])
    free_x, free_y = where(held_x == slope_x, 1.0, 0.0), where(held_y == slope_y, 1.0, 0.0)
    gz = -(g00 * fx2 + g11 * fy2) + g02 * fx2 * held_x * (1.0 + free_x) + g12 * fy2 * held_y * (1.0 + free_y)
    return -g02 * fx2 * free_x, -g12 * fy2 * free_y, gz


@njit(cache=True, error_model="numpy")
def _per_length(qw, qx, qy, qz):  # type: ignore[no-untyped-def]
    """One over the length of a quaternion; 0 for one of length 0, which so turns nothing."""
    length = root(qw * qw + qx * qx + qy * qy + qz * qz)
    return where(length > 0.0, 1.0 / length, 0.0)


@njit(cache=True, error_model="numpy")
def rotation(qw, qx, qy, qz):  # type: ignore[no-untyped-def]
    """Rotation matrix (9, by rows) of a quaternion wxyz of any length; one of length 0 turns nothing."""
    unit = _per_length(qw, qx, qy, qz)
    w, x, y, z = qw * unit, qx * unit, qy * unit, qz * unit
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@njit(cache=True, error_model="numpy")
def rotation_backward(qw, qx, qy, qz, g):  # type: ignore[no-untyped-def]
    """dL/dq (4,) of `rotation`, given dL/dR (9, by rows). Zero for a quaternion of length 0."""
    unit = _per_length(qw, qx, qy, qz)
    w, x, y, z = qw * unit, qx * unit, qy * unit, qz * unit
    g00, g01, g02, g10, g11, g12, g20, g21, g22 = g
    gw = 2.0 * (x * (g21 - g12) + y * (g02 - g20) + z * (g10 - g01))
    gx = 2.0 * (w * (g21 - g12) + y * (g01 + g10) + z * (g02 + g20)) - 4.0 * x * (g11 + g22)
    gy = 2.0 * (w * (g02 - g20) + x * (g01 + g10) + z * (g12 + g21)) - 4.0 * y * (g00 + g22)
    gz = 2.0 * (w * (g10 - g01) + x * (g02 + g20) + y * (g12 + g21)) - 4.0 * z * (g00 + g11)
    along = gw * w + gx * x + gy * y + gz * z  # the length of q is not seen: only what turns it counts
    return (gw - along * w) * unit, (gx - along * x) * unit, (gy - along * y) * unit, (gz - along * z) * unit


@njit(cache=True, error_model="numpy")
def half_axes(cam, qw, qx, qy, qz, sx, sy, sz):  # type: ignore[no-untyped-def]
    """A = R_view R(q) diag(s) (9, by rows): column k is the k-th principal half axis in camera space."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(qw, qx, qy, qz)
    return (
        (cam[0] * r00 + cam[1] * r10 + cam[2] * r20) * sx,
        (cam[0] * r01 + cam[1] * r11 + cam[2] * r21) * sy,
        (cam[0] * r02 + cam[1] * r12 + cam[2] * r22) * sz,
        (cam[3] * r00 + cam[4] * r10 + cam[5] * r20) * sx,
        (cam[3] * r01 + cam[4] * r11 + cam[5] * r21) * sy,
        (cam[3] * r02 + cam[4] * r12 + cam[5] * r22) * sz,
        (cam[6] * r00 + cam[7] * r10 + cam[8] * r20) * sx,
        (cam[6] * r01 + cam[7] * r11 + cam[8] * r21) * sy,
        (cam[6] * r02 + cam[7] * r12 + cam[8] * r22) * sz,
    )


@njit(cache=True, error_model="numpy")
def half_axes_backward(cam, qw, qx, qy, qz, sx, sy, sz, g):  # type: ignore[no-untyped-def]
    """((dL/dq, 4), (dL/ds, 3)) of `half_axes`, given dL/dA (9, by rows)."""
    g00, g01, g02, g10, g11, g12, g20, g21, g22 = g
    # B = R_view^T dL/dA: the gradient in world axes.
    b00 = cam[0] * g00 + cam[3] * g10 + cam[6] * g20
    b01 = cam[0] * g01 + cam[3] * g11 + cam[6] * g21
    b02 = cam[0] * g02 + cam[3] * g12 + cam[6] * g22
    b10 = cam[1] * g00 + cam[4] * g10 + cam[7] * g20
    b11 = cam[1] * g01 + cam[4] * g11 + cam[7] * g21
    b12 = cam[1] * g02 + cam[4] * g12 + cam[7] * g22
    b20 = cam[2] * g00 + cam[5] * g10 + cam[8] * g20
    b21 = cam[2] * g01 + cam[5] * g11 + cam[8] * g21
    b22 = cam[2] * g02 + cam[5] * g12 + cam[8] * g22
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(qw, qx, qy, qz)
    scale_gradient = (
        r00 * b00 + r10 * b10 + r20 * b20,
        r01 * b01 + r11 * b11 + r21 * b21,
        r02 * b02 + r12 * b12 + r22 * b22,
    )
    matrix = (b00 * sx, b01 * sy, b02 * sz, b10 * sx, b11 * sy, b12 * sz, b20 * sx, b21 * sy, b22 * sz)
    return rotation_backward(qw, qx, qy, qz, matrix), scale_gradient


@njit(cache=True, error_model="numpy")
def screen_axes(j, a):  # type: ignore[no-untyped-def]
    """B = J A (6, by rows), pixels: the half axes on the picture, from `jacobian` and `half_axes`."""
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
def screen_axes_backward(j, a, g):  # type: ignore[no-untyped-def]
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
def screen_covariance(b, low_pass):  # type: ignore[no-untyped-def]
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
def screen_covariance_backward(b, gxx, gxy, gyy):  # type: ignore[no-untyped-def]
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
def conic(xx, xy, yy, det):  # type: ignore[no-untyped-def]
    """(a, b, c) of the inverse of [[xx, xy], [xy, yy]]: q(dx, dy) = a dx^2 + 2 b dx dy + c dy^2."""
    per_det = 1.0 / det
    return yy * per_det, -xy * per_det, xx * per_det


@njit(cache=True, error_model="numpy")
def conic_backward(a, b, c, ga, gb, gc):  # type: ignore[no-untyped-def]
    """dL/d(xx, xy, yy) of `conic` (xy and b counted once): -K G K with G = [[ga, gb/2], [gb/2, gc]]."""
    h = 0.5 * gb
    ka = a * ga + b * h
    kb = a * h + b * gc
    kc = b * ga + c * h
    kd = b * h + c * gc
    return -(ka * a + kb * b), -(ka * b + kb * c + kc * a + kd * b), -(kc * b + kd * c)
