"""Depth maps that condition a model on the shape of a cut face."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from transformers import DPTForDepthEstimation

from training.priors.diffusion.loading import load_part, resized
from training.priors.prior import Condition

__all__ = ["Estimator", "exact_depth"]


def exact_depth(inside: NDArray[np.bool_], depth: NDArray[np.float32]) -> Tensor:
    """(1, 1, H, W). Depth (H, W) in the convention of the model's training data, which came from an estimator.

    That is inverse depth, shifted and scaled to [-1, 1] over the picture: the nearest point is 1, the infinite
    background -1. A cut face seen straight on yields its silhouette.
    """
    nearest = depth[inside].min() if inside.any() else np.float32(1)
    inverse = np.where(inside, nearest / np.where(inside, depth, np.float32(1)), 0)
    return torch.from_numpy(np.clip(2 * inverse - 1, -1, 1).astype(np.float32))[None, None]


class Estimator:
    """A MiDaS (DPT) network that estimates depth from the render, as in the paper (section 3.2)."""

    def __init__(self, folder: str | Path, device: torch.device) -> None:
        """Reads the network from a local folder. Raises InputError if that fails."""
        self.network = load_part(DPTForDepthEstimation, Path(folder)).to(device)
        self.device = device

    @torch.no_grad()
    def depth(self, condition: Condition) -> Tensor:
        """(1, 1, H, W). Estimated inverse depth of the current render on white, range [-1, 1]."""
        shown = np.where(condition.inside[..., None], condition.render, np.float32(1))
        side = int(self.network.config.image_size or 384)
        picture = resized(torch.from_numpy(shown).permute(2, 0, 1)[None], (side, side)).clamp(0, 1)
        found = self.network((2 * picture - 1).to(self.device)).predicted_depth[:, None].float().cpu()
        found = resized(found, condition.inside.shape)
        low, high = found.min(), found.max()
        return 2 * (found - low) / (high - low).clamp(min=1e-6) - 1
