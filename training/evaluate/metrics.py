"""Metrics of an interior against the truth, on pictures of cut faces and on features of sets of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.image import psnr
from training.optimise.losses import ssim

__all__ = [
    "face_psnr",
    "face_ssim",
    "frechet_distance",
    "kernel_distance",
    "mean_cosine",
    "patch_distance",
    "sharpness",
]

Picture = NDArray[np.float32]
Mask = NDArray[np.bool_]
Features = NDArray[np.float64]

# Sliced Wasserstein: patches of 7 x 7 as the prior matches them, on a fixed set of directions, so that two
# measurements agree to the last bit.
PATCH = 7
DIRECTIONS = 128
QUANTILES = 256
PATCHES = 8192
"""Number of patches compared per face; a face of 200 x 200 pixels has five times as many overlapping ones."""


def face_psnr(picture: Picture, truth: Picture, inside: Mask) -> float:
    """PSNR in dB over the pixels of the cut face (H, W) only."""
    return psnr(picture[inside], truth[inside])


def face_ssim(picture: Picture, truth: Picture, inside: Mask) -> float:
    """SSIM of the face's bounding box, both pictures white outside of the face."""
    rows, columns = np.nonzero(inside)
    box = np.s_[max(rows.min() - 6, 0) : rows.max() + 7, max(columns.min() - 6, 0) : columns.max() + 7]
    a, b = (np.where(inside[..., None], p, np.float32(1))[box] for p in (picture, truth))
    return ssim(a, b)


def patch_distance(a: Picture, inside_a: Mask, b: Picture, inside_b: Mask) -> float:
    """Sliced Wasserstein-2 distance between the 7 x 7 patches of two faces, times 100.

    Mean over random unit directions of the mean squared difference of quantiles; colours in [0, 1].
    """
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((PATCH * PATCH * 3, DIRECTIONS)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=0)
    levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
    quantiles = []
    for picture, inside in ((a, inside_a), (b, inside_b)):
        projected = np.sort(_patches(picture, inside) @ directions, axis=0)
        places = levels * (len(projected) - 1)
        below = places.astype(np.intp)
        part = (places - below)[:, None]
        above = np.minimum(below + 1, len(projected) - 1)
        quantiles.append(projected[below] * (1 - part) + projected[above] * part)
    return float(((quantiles[0] - quantiles[1]) ** 2).mean()) * 100


def sharpness(picture: Picture, inside: Mask) -> float:
    """RMS of the Laplacian over the face, three pixels clear of its edge; zero for an even face."""
    core = ndimage.binary_erosion(inside, iterations=3)
    if not core.any():
        return 0.0
    laplacian = np.stack([ndimage.laplace(picture[..., c]) for c in range(3)], axis=-1)
    return float(np.sqrt((laplacian[core] ** 2).mean()))


def frechet_distance(a: Features, b: Features) -> float:
    """Frechet distance between Gaussians with the means and covariances of two sets of features (N, D), (M, D);
    N, M > 1.

    FID's formula, |mu_a - mu_b|^2 + tr(A + B - 2 (A B)^1/2). With A = X^T X and B = Y^T Y the last trace is the nuclear
    norm of X Y^T, which is small where D is large.
    """
    x, y = ((f - f.mean(0)) / np.sqrt(len(f) - 1) for f in (a, b))
    cross = np.linalg.svd(x @ y.T, compute_uv=False).sum()
    gap = ((a.mean(0) - b.mean(0)) ** 2).sum()
    return float(max(gap + (x**2).sum() + (y**2).sum() - 2 * cross, 0.0))


def kernel_distance(a: Features, b: Features) -> float:
    """Squared maximum mean discrepancy of two sets of features (N, D), (M, D), unbiased, so it may fall below zero.

    KID's kernel, (x.y / D + 1)^3 (Binkowski et al. 2018).
    """
    n, m = len(a), len(b)
    of_a, of_b, between = ((x @ y.T / a.shape[1] + 1) ** 3 for x, y in ((a, a), (b, b), (a, b)))
    own = (of_a.sum() - np.trace(of_a)) / (n * (n - 1)) + (of_b.sum() - np.trace(of_b)) / (m * (m - 1))
    return float(own - 2 * between.mean())


def mean_cosine(features: Features) -> float:
    """Mean cosine between every two of the features (N, D), N > 1: the paper's consistency (its table 2)."""
    unit = features / np.linalg.norm(features, axis=1, keepdims=True)
    count = len(unit)
    return float((np.sum(unit.sum(0) ** 2) - count) / (count * (count - 1)))


def _patches(picture: Picture, inside: Mask) -> Picture:
    """(N, 147). Patches entirely on the face or, if there are none, those centred on it."""
    windows = np.lib.stride_tricks.sliding_window_view(picture, (PATCH, PATCH), axis=(0, 1))
    half = PATCH // 2
    middle = inside[half:-half, half:-half]
    whole = ndimage.binary_erosion(inside, np.ones((PATCH, PATCH)))[half:-half, half:-half]
    chosen = np.argwhere(whole if whole.any() else middle)
    if len(chosen) > PATCHES:
        chosen = chosen[np.random.default_rng(1).choice(len(chosen), PATCHES, replace=False)]
    return windows[chosen[:, 0], chosen[:, 1]].reshape(-1, PATCH * PATCH * 3)
