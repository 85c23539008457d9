"""The prior that uses a depth-conditioned Stable Diffusion model (paper, section 3.2)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from engine.errors import InputError
from training.priors.diffusion.depth import Estimator, exact_depth
from training.priors.diffusion.loading import load_model, resized
from training.priors.diffusion.prompts import plain_prompts
from training.priors.prior import Condition

__all__ = ["GUIDANCE", "StableDiffusionPrior"]

GUIDANCE = 7.5
"""Scale of classifier-free guidance. The usual value for sampling; the 100 of DreamFusion is for distillation at random
noise levels, and oversaturates the colours of an annealed schedule."""


class StableDiffusionPrior:
    """Predicts noise in the latents of a model from a local folder; `training.priors.sds` makes labels with it.

    Prompts are, in this order: the family's own, those that the model was fine-tuned on, the paper's for `object_name`.
    Depth is exact, or with a MiDaS folder the mean of exact and estimated depth. Bit-equal for the same input on one
    machine.
    """

    def __init__(
        self,
        folder: str | Path,
        object_name: str = "object",
        guidance: float = GUIDANCE,
        midas: str | Path | None = None,
        device: torch.device | None = None,
    ) -> None:
        """Reads the model onto `device`, by default the best available. Raises InputError if the folder holds none."""
        self.model = load_model(folder, half=True, device=device)
        self.prompts = plain_prompts(object_name) | self.model.prompts
        self.guidance = guidance
        self.estimator = None if midas is None else Estimator(midas, self.model.device)
        self._embedded: dict[str, Tensor] = {}
        self._depth: tuple[Condition, Tensor] | None = None

    def encode(self, label: NDArray[np.float32]) -> NDArray[np.float32]:
        """The latent (h, w, 4) of a picture (H, W, 3), of about unit variance, at the model's working size."""
        assert label.ndim == 3 and label.shape[2] == 3, label.shape
        picture = resized(torch.from_numpy(np.ascontiguousarray(label)).permute(2, 0, 1)[None], self._size(label))
        return self.model.encode(picture)[0].permute(1, 2, 0).cpu().numpy()

    def decode(self, latent: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
        """The picture (H, W, 3), range [0, 1], of a latent (h, w, 4)."""
        picture = self.model.decode(torch.from_numpy(latent).permute(2, 0, 1)[None]).cpu()
        return resized(picture, shape)[0].permute(1, 2, 0).clamp(0, 1).numpy()

    @torch.no_grad()
    def denoise(
        self,
        noisy: NDArray[np.float32],  # [h, w, 4], latent + sigma * noise
        sigma: float,
        condition: Condition,
        rng: np.random.Generator,
    ) -> NDArray[np.float32]:
        """(h, w, 4). The noise in a noisy latent, of unit variance, with guidance."""
        device = self.model.device
        latents = torch.from_numpy(noisy).permute(2, 0, 1)[None].to(device)
        depth = resized(self._depth_of(condition), (noisy.shape[0], noisy.shape[1])).to(device)
        text = self._text(condition.prompt or self.prompts[condition.family.kind])
        with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True):
            noise = self.model.guided(latents, sigma, text, self._text(""), depth, self.guidance)
        if not torch.isfinite(noise).all():
            raise InputError(f"{self.model.folder}: answers with numbers that are not finite; its weights are damaged")
        return noise[0].permute(1, 2, 0).cpu().numpy()

    def _size(self, label: NDArray[np.float32]) -> tuple[int, int]:
        return self.model.working_size(label.shape[0], label.shape[1])

    def _text(self, prompt: str) -> Tensor:
        if prompt not in self._embedded:
            self._embedded[prompt] = self.model.embed([prompt])
        return self._embedded[prompt]

    def _depth_of(self, condition: Condition) -> Tensor:
        """(1, 1, H, W). The depth map of a condition, cached for the last one: a plane takes many steps in a row."""
        if self._depth is None or self._depth[0] is not condition:
            depth = exact_depth(condition.inside, condition.depth)
            if self.estimator is not None:
                depth = (depth + self.estimator.depth(condition)) / 2
            self._depth = condition, depth
        return self._depth[1]
