"""Spherical harmonics as 3DGS uses them: real, degree 0..3, colour = 0.5 + sum, clamped below at 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["C0", "basis", "colours", "rgb_to_sh", "sh_to_rgb"]

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


def basis(directions: NDArray[np.floating], degree: int) -> NDArray[np.floating]:
    """(N, (degree+1)^2). The basis functions in unit directions (N, 3), eye to Gaussian, in INRIA's order and signs."""
    assert directions.ndim == 2 and directions.shape[1] == 3, directions.shape
    x, y, z = directions.T
    rows = [np.full_like(x, C0)]
    if degree >= 1:
        rows += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        rows += [
            C2[0] * x * y,
            C2[1] * y * z,
            C2[2] * (2 * zz - xx - yy),
            C2[3] * x * z,
            C2[4] * (xx - yy),
        ]
    if degree >= 3:
        rows += [
            C3[0] * y * (3 * xx - yy),
            C3[1] * x * y * z,
            C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            C3[4] * x * (4 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3 * yy),
        ]
    return np.stack(rows, axis=1)


def colours(
    sh: NDArray[np.floating],  # [N, (d+1)^2, 3]
    directions: NDArray[np.floating],  # [N, 3] unit, eye to Gaussian
) -> NDArray[np.floating]:
    """(N, 3). RGB of each Gaussian seen along its direction. Range [0, inf)."""
    degree = round(sh.shape[1] ** 0.5) - 1
    return np.maximum(0.5 + np.einsum("nk,nkc->nc", basis(directions, degree), sh), 0)


def rgb_to_sh(rgb: NDArray[np.floating]) -> NDArray[np.floating]:
    """Degree-0 coefficients (..., 3) that show RGB (..., 3) from everywhere."""
    return (rgb - 0.5) / C0


def sh_to_rgb(dc: NDArray[np.floating]) -> NDArray[np.floating]:
    """RGB (..., 3) of degree-0 coefficients (..., 3), clamped below at 0 as the renderers do."""
    return np.maximum(dc * C0 + 0.5, 0)
