"""Score distillation: labels from a prior that can only denoise (paper, section 3.2, eq. 5).

Schedules, the weighting w(t) and the loss live here, once, for every prior.
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

# Noise levels in units of the data's own spread, geometric from the first to the last step. A first label starts
# where only the layout survives the noise; a refinement keeps what the render has and moves the details.
FIRST_SIGMAS = (3.2, 0.16)
REFINE_SIGMAS = (0.8, 0.16)

# A first label in codes starts higher: the large shapes of a picture are several times stronger in its code than the
# mean over all scales. At 3.2 more than half of the grey start would stay in shapes of spread 8; at 10 a 25th does.
FIRST_CODE_SIGMAS = (10.0, 0.16)

COLOUR_SPREAD = 0.25
"""Standard deviation of the colours of cut faces, roughly; codes of a latent space have 1."""


def distill(
    label: NDArray[np.float32],  # [H, W, 3]
    prior: Denoiser,
    condition: Condition,
    rng: np.random.Generator,
    refine: bool = False,
    step: float = 1.0,
) -> NDArray[np.float32]:
    """(H, W, 3). The label moved to where the prior finds it likely; range [0, 1], unchanged outside the silhouette.

    Each step walks down the gradient of eq. 5 with w(t) = sigma_t, sigma_t (eps_theta(I + sigma_t eps) - eps), the
    denoiser's Jacobian left out as usual. `step` is in units of sigma^2: with 1, the longest stable one, it lands on
    the denoised picture I + sigma_t (eps - eps_theta) itself.
    """
    assert label.ndim == 3 and label.shape[2] == 3, label.shape
    steps = REFINE_STEPS if refine else FIRST_STEPS
    latent = isinstance(prior, LatentDenoiser)
    first = FIRST_CODE_SIGMAS if latent else FIRST_SIGMAS
    sigmas = np.geomspace(*(REFINE_SIGMAS if refine else first), steps) * (1.0 if latent else COLOUR_SPREAD)
    inside = condition.inside[..., None]
    current = prior.encode(label) if isinstance(prior, LatentDenoiser) else label.astype(np.float32)
    known, free = current, latent_mask(condition.inside, current.shape[:2])[..., None] if latent else inside
    for sigma in sigmas:
        noise = rng.standard_normal(current.shape, dtype=np.float32)
        predicted = prior.denoise(current + np.float32(sigma) * noise, float(sigma), condition, rng)
        gradient = np.float32(sigma) * (predicted - noise)
        current = current - np.float32(step) * gradient
        # The surroundings stay known at every step, so that the prior sees where the cut face ends.
        current = np.where(free, current if latent else np.clip(current, 0, 1), known)
    picture = prior.decode(current, label.shape[:2]) if isinstance(prior, LatentDenoiser) else current
    return np.where(inside, picture, label)


def latent_mask(inside: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(h, w). The cells of a code of this shape that have any of the silhouette (H, W) in them."""
    edges = [np.arange(cells) * pixels // cells for cells, pixels in zip(shape, inside.shape, strict=True)]
    return np.logical_or.reduceat(np.logical_or.reduceat(inside, edges[0], axis=0), edges[1], axis=1)
