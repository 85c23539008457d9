"""Score distillation: labels from a denoising prior (paper, section 3.2, eq. 5).

Schedules, the weighting w(t) and the loss are defined here for all priors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.priors.prior import Condition, Denoiser, LatentDenoiser

__all__ = ["FIRST_STEPS", "REFINE_STEPS", "distill"]

FIRST_STEPS = 20
"""Steps for the first label of a plane (paper, section 4.1)."""
REFINE_STEPS = 4
"""Steps per refinement round; the paper takes 3 to 4."""

# Noise levels in standard deviations of the data, geometric from the first to the last step. At the first level of a
# first label only the layout survives the noise; a refinement keeps the render's structure and changes details.
FIRST_SIGMAS = (3.2, 0.16)
REFINE_SIGMAS = (0.8, 0.16)

# A first label in a latent space starts higher: large shapes have several times the mean amplitude there. Starting at
# 3.2, over half of the initial grey would remain in shapes of amplitude 8; starting at 10, a 25th does.
FIRST_LATENT_SIGMAS = (10.0, 0.16)

COLOUR_SPREAD = 0.25
"""Approximate standard deviation of the colours of cut faces; that of latents is 1."""


def distill(
    label: NDArray[np.float32],  # [H, W, 3]
    prior: Denoiser,
    condition: Condition,
    rng: np.random.Generator,
    refine: bool = False,
    step: float = 1.0,
) -> NDArray[np.float32]:
    """(H, W, 3). The label moved towards a mode of the prior; range [0, 1], unchanged outside the silhouette.

    Each step walks down the gradient of eq. 5 with w(t) = sigma_t, sigma_t (eps_theta(I + sigma_t eps) - eps), the
    denoiser's Jacobian omitted as usual. `step` is in units of sigma^2: 1, the longest stable one, reaches
    the denoised picture I + sigma_t (eps - eps_theta) itself.
    """
    assert label.ndim == 3 and label.shape[2] == 3, label.shape
    steps = REFINE_STEPS if refine else FIRST_STEPS
    latent = isinstance(prior, LatentDenoiser)
    first = FIRST_LATENT_SIGMAS if latent else FIRST_SIGMAS
    sigmas = np.geomspace(*(REFINE_SIGMAS if refine else first), steps) * (1.0 if latent else COLOUR_SPREAD)
    inside = condition.inside[..., None]
    current = prior.encode(label) if isinstance(prior, LatentDenoiser) else label.astype(np.float32)
    known, free = current, latent_mask(condition.inside, current.shape[:2])[..., None] if latent else inside
    for sigma in sigmas:
        noise = rng.standard_normal(current.shape, dtype=np.float32)
        predicted = prior.denoise(current + np.float32(sigma) * noise, float(sigma), condition, rng)
        gradient = np.float32(sigma) * (predicted - noise)
        current = current - np.float32(step) * gradient
        # The surroundings are reset at every step, so that the prior sees where the cut face ends.
        current = np.where(free, current if latent else np.clip(current, 0, 1), known)
    picture = prior.decode(current, label.shape[:2]) if isinstance(prior, LatentDenoiser) else current
    return np.where(inside, picture, label)


def latent_mask(inside: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(h, w). The cells of a latent of this shape that overlap the silhouette (H, W)."""
    edges = [np.arange(cells) * pixels // cells for cells, pixels in zip(shape, inside.shape, strict=True)]
    return np.logical_or.reduceat(np.logical_or.reduceat(inside, edges[0], axis=0), edges[1], axis=1)
