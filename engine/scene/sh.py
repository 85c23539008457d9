"""Spherical harmonics as 3DGS uses them: real, degree 0..3, colour = 0.5 + sum, clamped below at 0."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = [
    "BANDS",
    "C0",
    "C1",
    "C2",
    "C3",
    "basis",
    "colours",
    "direction_gradient",
    "fill_basis",
    "rgb_to_sh",
    "sh_to_rgb",
]

C0 = 0.28209479177387814  # 1 / (2 sqrt(pi)), the constant function's normalisation
C1 = 0.4886025119029199  # sqrt(3 / (4 pi))
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def band_1(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """The basis functions of degree 1 in a unit direction, eye to Gaussian, in INRIA's order and signs.

    Takes numbers, arrays or tensors; numba compiles it, as it does the other two.
    """
    return -C1 * y, C1 * z, -C1 * x


def band_2(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any, Any, Any]:
    """The basis functions of degree 2."""
    xx, yy, zz = x * x, y * y, z * z
    return C2[0] * x * y, C2[1] * y * z, C2[2] * (2.0 * zz - xx - yy), C2[3] * x * z, C2[4] * (xx - yy)


def band_3(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any, Any, Any, Any, Any]:
    """The basis functions of degree 3."""
    xx, yy, zz = x * x, y * y, z * z
    return (
        C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        C3[2] * y * (4.0 * zz - xx - yy),
        C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        C3[4] * x * (4.0 * zz - xx - yy),
        C3[5] * z * (xx - yy),
        C3[6] * x * (xx - 3.0 * yy),
    )


BANDS = (band_1, band_2, band_3)


def basis(directions: NDArray[np.floating], degree: int) -> NDArray[np.floating]:
    """(N, (degree+1)^2). The basis functions in unit directions (N, 3)."""
    assert directions.ndim == 2 and directions.shape[1] == 3, directions.shape
    x, y, z = directions.T
    rows = [np.full_like(x, C0)]
    for band in BANDS[:degree]:
        rows += band(x, y, z)
    return np.stack(rows, axis=1)


_band_1, _band_2, _band_3 = (njit(cache=True, error_model="numpy")(band) for band in BANDS)


@njit(cache=True, error_model="numpy")
def fill_basis(x, y, z, bands, out):
    """Writes the first `bands` basis functions in one unit direction into out (16,)."""
    out[0] = C0
    if bands > 1:
        out[1], out[2], out[3] = _band_1(x, y, z)
    if bands > 4:
        out[4], out[5], out[6], out[7], out[8] = _band_2(x, y, z)
    if bands > 9:
        out[9], out[10], out[11], out[12], out[13], out[14], out[15] = _band_3(x, y, z)


@njit(cache=True, error_model="numpy")
def direction_gradient(x, y, z, bands, g):
    """dL/d(x, y, z) of `fill_basis`, given dL/d(basis) g (16,)."""
    gx = -C1 * g[3]
    gy = -C1 * g[1]
    gz = C1 * g[2]
    if bands > 4:
        gx += C2[0] * y * g[4] - 2.0 * C2[2] * x * g[6] + C2[3] * z * g[7] + 2.0 * C2[4] * x * g[8]
        gy += C2[0] * x * g[4] + C2[1] * z * g[5] - 2.0 * C2[2] * y * g[6] - 2.0 * C2[4] * y * g[8]
        gz += C2[1] * y * g[5] + 4.0 * C2[2] * z * g[6] + C2[3] * x * g[7]
    if bands > 9:
        xx, yy, zz = x * x, y * y, z * z
        gx += (
            C3[0] * 6.0 * x * y * g[9]
            + C3[1] * y * z * g[10]
            - C3[2] * 2.0 * x * y * g[11]
            - C3[3] * 6.0 * x * z * g[12]
            + C3[4] * (4.0 * zz - 3.0 * xx - yy) * g[13]
            + C3[5] * 2.0 * x * z * g[14]
            + C3[6] * 3.0 * (xx - yy) * g[15]
        )
        gy += (
            C3[0] * 3.0 * (xx - yy) * g[9]
            + C3[1] * x * z * g[10]
            + C3[2] * (4.0 * zz - xx - 3.0 * yy) * g[11]
            - C3[3] * 6.0 * y * z * g[12]
            - C3[4] * 2.0 * x * y * g[13]
            - C3[5] * 2.0 * y * z * g[14]
            - C3[6] * 6.0 * x * y * g[15]
        )
        gz += (
            C3[1] * x * y * g[10]
            + C3[2] * 8.0 * y * z * g[11]
            + C3[3] * (6.0 * zz - 3.0 * xx - 3.0 * yy) * g[12]
            + C3[4] * 8.0 * x * z * g[13]
            + C3[5] * (xx - yy) * g[14]
        )
    return gx, gy, gz


def colours(
    sh: NDArray[np.floating],  # [N, (d+1)^2, 3]
    directions: NDArray[np.floating],  # [N, 3] unit, eye to Gaussian
) -> NDArray[np.floating]:
    """(N, 3). RGB of each Gaussian seen along its direction. Range [0, inf)."""
    degree = round(sh.shape[1] ** 0.5) - 1
    return np.maximum(0.5 + np.einsum("nk,nkc->nc", basis(directions, degree), sh), 0)


def rgb_to_sh(rgb: NDArray[np.floating]) -> NDArray[np.floating]:
    """Degree-0 coefficients (..., 3) of RGB (..., 3)."""
    return (rgb - 0.5) / C0


def sh_to_rgb(dc: NDArray[np.floating]) -> NDArray[np.floating]:
    """RGB (..., 3) of degree-0 coefficients (..., 3), clamped below at 0 as the renderers do."""
    return np.maximum(dc * C0 + 0.5, 0)
