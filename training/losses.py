"""How far a picture is from its label (paper, section 3.2, reconstruction loss)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

__all__ = ["psnr", "reconstruction", "ssim"]

# Wang et al. 2004: an 11-pixel Gaussian window of sigma 1.5, K1 = 0.01, K2 = 0.03, for a range of one.
WINDOW = 11
SIGMA = 1.5
C1 = 0.01**2
C2 = 0.03**2


def _blur(pictures: Tensor) -> Tensor:
    """(B, C, H, W) convolved with the window; the border is the valid part only, as the metric's authors have it."""
    offsets = torch.arange(WINDOW, dtype=pictures.dtype) - WINDOW // 2
    kernel = torch.exp(-(offsets**2) / (2 * SIGMA**2))
    kernel = kernel / kernel.sum()
    b, c, h, w = pictures.shape
    flat = pictures.reshape(b * c, 1, h, w)
    flat = functional.conv2d(flat, kernel.view(1, 1, 1, -1))
    return functional.conv2d(flat, kernel.view(1, 1, -1, 1)).reshape(b, c, h - WINDOW + 1, w - WINDOW + 1)


def ssim(
    a: Tensor,  # [H, W, 3]
    b: Tensor,  # [H, W, 3]
) -> Tensor:
    """Mean structural similarity of two pictures of at least 11 x 11 pixels, range [-1, 1]; differentiable."""
    assert a.shape == b.shape and a.ndim == 3, (a.shape, b.shape)
    x, y = a.permute(2, 0, 1), b.permute(2, 0, 1)
    mean_x, mean_y, xx, yy, xy = _blur(torch.stack([x, y, x * x, y * y, x * y]))
    variance_x, variance_y = xx - mean_x**2, yy - mean_y**2
    covariance = xy - mean_x * mean_y
    likeness = (2 * mean_x * mean_y + C1) * (2 * covariance + C2)
    return (likeness / ((mean_x**2 + mean_y**2 + C1) * (variance_x + variance_y + C2))).mean()


def reconstruction(
    render: Tensor,  # [H, W, 3]
    label: Tensor,  # [H, W, 3]
    alpha: float,
) -> Tensor:
    """alpha MSE + (1 - alpha) (1 - SSIM), the paper's L_recon."""
    return alpha * functional.mse_loss(render, label) + (1 - alpha) * (1 - ssim(render, label))


def psnr(
    a: Tensor,  # [...]
    b: Tensor,  # [...]
) -> float:
    """Peak signal-to-noise ratio in dB for a range of one; infinite where the two are equal."""
    error = float(functional.mse_loss(a.double(), b.double()))
    return float("inf") if error == 0 else -10 * float(torch.log10(torch.tensor(error)))
