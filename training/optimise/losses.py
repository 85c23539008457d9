"""The reconstruction loss of a picture against its label (paper, section 3.2), with a closed-form gradient."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from engine.threads import for_each

__all__ = ["reconstruction", "ssim"]

# Wang et al. 2004: an 11-pixel Gaussian window of sigma 1.5, K1 = 0.01, K2 = 0.03, for a range of one. The border is
# left out, as in the authors' reference implementation.
WINDOW = 11
SIGMA = 1.5
C1 = np.float32(0.01**2)
C2 = np.float32(0.03**2)

_TAPS = np.exp(-((np.arange(WINDOW) - WINDOW // 2) ** 2) / (2 * SIGMA**2))
TAPS = (_TAPS / _TAPS.sum()).astype(np.float32)

Float = NDArray[np.float32]


def reconstruction(
    render: Tensor,  # [H, W, 3]
    label: Tensor,  # [H, W, 3]
    alpha: float,
) -> Tensor:
    """alpha MSE + (1 - alpha) (1 - SSIM), the paper's L_recon; differentiable in the render.

    Pictures have at least 11 x 11 pixels. Both means include the background.
    """
    assert render.shape == label.shape and render.ndim == 3, (render.shape, label.shape)
    assert min(render.shape[:2]) >= WINDOW, render.shape
    return _Reconstruction.apply(render, label, alpha)


def ssim(
    a: NDArray[np.floating],  # [H, W, 3]
    b: NDArray[np.floating],  # [H, W, 3]
) -> float:
    """Mean structural similarity of two pictures of at least 11 x 11 pixels, range [-1, 1]."""
    assert a.shape == b.shape and a.ndim == 3, (a.shape, b.shape)
    assert min(a.shape[:2]) >= WINDOW, a.shape
    sums, _ = _ssim_and_gradient(a.astype(np.float32), b.astype(np.float32))
    return sums / (3 * (a.shape[0] - WINDOW + 1) * (a.shape[1] - WINDOW + 1))


class _Reconstruction(torch.autograd.Function):
    """The loss; computes its gradient in the forward pass, which is cheaper than saving the intermediates."""

    @staticmethod
    def forward(context: Any, render: Tensor, label: Tensor, alpha: float) -> Tensor:
        x, y = render.detach().float().numpy(), label.detach().float().numpy()
        difference = x - y
        sums, gradient = _ssim_and_gradient(x, y)
        valid = 3 * (x.shape[0] - WINDOW + 1) * (x.shape[1] - WINDOW + 1)
        context.gradient = torch.from_numpy((2 * alpha / x.size) * difference - ((1 - alpha) / valid) * gradient)
        mse = float(np.mean(difference * difference, dtype=np.float64))
        return torch.tensor(alpha * mse + (1 - alpha) * (1 - sums / valid), dtype=torch.float32)

    @staticmethod
    def backward(context: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:
        return gradients[0] * context.gradient, None, None


def _ssim_and_gradient(x: Float, y: Float) -> tuple[float, Float]:
    """Sum of the SSIM map of (H, W, 3) pictures, and its gradient (H, W, 3) in x; one channel per task."""
    planes = np.ascontiguousarray(np.moveaxis(np.stack([x, y]), -1, 0))
    sums = np.zeros(3)
    gradient = np.empty((3, *x.shape[:2]), np.float32)
    for_each(_channel, 3, planes, TAPS, sums, gradient)
    return float(sums.sum()), np.moveaxis(gradient, 0, -1)


@njit(cache=True, nogil=True)
def _channel(
    c: int,
    planes: Float,  # [3, 2, H, W] both pictures, channel by channel
    taps: Float,  # [WINDOW]
    sums: NDArray[np.float64],  # out [3]
    gradient: Float,  # out [3, H, W]
) -> None:
    """SSIM of one channel and its gradient.

    With S = A1 A2 / (B1 B2) over the window's moments m_x, m_y, E[xx], E[yy], E[xy]:
    dS/dE[xy] = 2 A1 / (B1 B2), dS/dE[xx] = -S / B2, and dS/dm_x the rest; each is spread back through the window.
    """
    x, y = planes[c, 0], planes[c, 1]
    mx, my = _blur(x, taps), _blur(y, taps)
    exx, eyy, exy = _blur(x * x, taps), _blur(y * y, taps), _blur(x * y, taps)
    rows, columns = mx.shape
    two = np.float32(2)
    total = 0.0
    for i in range(rows):
        for j in range(columns):
            a, b = mx[i, j], my[i, j]
            a1 = two * a * b + C1
            a2 = two * (exy[i, j] - a * b) + C2
            b1 = a * a + b * b + C1
            b2 = exx[i, j] - a * a + eyy[i, j] - b * b + C2
            s = a1 * a2 / (b1 * b2)
            total += s
            mx[i, j] = two * b * (a2 - a1) / (b1 * b2) + two * a * s * (np.float32(1) / b2 - np.float32(1) / b1)
            exx[i, j] = -s / b2
            exy[i, j] = two * a1 / (b1 * b2)
    sums[c] = total
    through_mean, through_xx, through_xy = (
        _blur_transposed(mx, taps),
        _blur_transposed(exx, taps),
        _blur_transposed(exy, taps),
    )
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            gradient[c, i, j] = through_mean[i, j] + two * x[i, j] * through_xx[i, j] + y[i, j] * through_xy[i, j]


@njit(cache=True, nogil=True)
def _blur(picture: Float, taps: Float) -> Float:
    """Valid part of the separable convolution with the window; the innermost loop runs along rows."""
    k = len(taps)
    h, w = picture.shape
    down = np.zeros((h - k + 1, w), np.float32)
    for i in range(h - k + 1):
        for t in range(k):
            for j in range(w):
                down[i, j] += taps[t] * picture[i + t, j]
    result = np.zeros((h - k + 1, w - k + 1), np.float32)
    for i in range(h - k + 1):
        for t in range(k):
            for j in range(w - k + 1):
                result[i, j] += taps[t] * down[i, j + t]
    return result


@njit(cache=True, nogil=True)
def _blur_transposed(values: Float, taps: Float) -> Float:
    """The transpose of `_blur`: spreads each value over the pixels under its window."""
    k = len(taps)
    rows, columns = values.shape
    across = np.zeros((rows, columns + k - 1), np.float32)
    for i in range(rows):
        for t in range(k):
            for j in range(columns):
                across[i, j + t] += taps[t] * values[i, j]
    result = np.zeros((rows + k - 1, columns + k - 1), np.float32)
    for i in range(rows):
        for t in range(k):
            for j in range(columns + k - 1):
                result[i + t, j] += taps[t] * across[i, j]
    return result
