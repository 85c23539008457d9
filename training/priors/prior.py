"""The interfaces of priors, which draw the labels of cut faces (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from engine.scene.grid import Body
from engine.scene.inside import Inside
from training.families import Family
from training.priors.cubic import read_cubic, spline_coefficients

__all__ = ["Condition", "Denoiser", "LatentDenoiser", "Progress", "Volume", "VolumeSolver"]

Progress = Callable[[float], None]
"""Called repeatedly with the completed fraction, range [0, 1]. May raise to stop the work."""


@dataclass(frozen=True)
class Condition:
    """What a prior knows of the cut face whose noise it predicts; arrays are (H, W)."""

    family: Family
    prompt: str
    inside: NDArray[np.bool_]
    """The silhouette."""
    under_skin: NDArray[np.float32]
    """Depth under the skin, divided by the inradius of the body. Range [0, 1] inside."""
    radius: NDArray[np.float32]
    """Distance from the up axis, divided by the body's largest. Range [0, 1] inside."""
    angle: NDArray[np.float32]
    """Angle around the up axis in radians, range [-pi, pi], from the first vector of `equator(up)`."""
    height: NDArray[np.float32]
    """Height along the up axis. Range [-1, 1] from the lowest to the highest point of the body."""
    depth: NDArray[np.float32]
    """Depth from the camera to the cut face, world units; infinite outside the silhouette."""
    render: NDArray[np.float32]
    """(H, W, 3). The current render of the cut face."""


@dataclass(frozen=True)
class Volume:
    """Colours on a grid, from which the cut face of any plane can be sampled."""

    body: Body
    """Grid and solid; the colours stand at its cell centres."""
    rgb: NDArray[np.float32]
    """(X, Y, Z, 3). Range [0, 1]; outside the solid the nearest inside colour, so that cuts have no dark rim."""
    inside: Inside | None = field(default=None, kw_only=True)
    """The function that the grid samples, if there is one."""
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    """What the user should check in the pictures that the volume was made from, a line each."""

    def at(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(..., 3). Colours at world points (..., 3), trilinear."""
        return self.body.grid.sample(self.rgb, points)

    def at_cubic(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(..., 3). Colours at world points (..., 3) by a cubic spline, clipped to [0, 1].

        For atoms, whose kernels blur once more: their cuts are 0.93 to 1.1 times as sharp as the truth, with trilinear
        colours 0.75 to 0.9 times (orange, watermelon, bread).
        """
        places = self.body.grid.index(points).reshape(-1, 3)
        return np.clip(read_cubic(self._splines, places), 0, 1).reshape(points.shape)

    @cached_property
    def _splines(self) -> NDArray[np.float32]:
        return spline_coefficients(self.rgb)


@runtime_checkable
class Denoiser(Protocol):
    """A prior that predicts noise; score distillation makes its labels."""

    def denoise(
        self,
        noisy: NDArray[np.float32],  # [H, W, 3], label + sigma * noise
        sigma: float,
        condition: Condition,
        rng: np.random.Generator,
    ) -> NDArray[np.float32]:
        """(H, W, 3). The noise in `noisy` in units of one: epsilon_theta of the paper's eq. 5."""
        ...


@runtime_checkable
class LatentDenoiser(Denoiser, Protocol):
    """A prior that denoises in a latent space: its `denoise` takes and returns latents instead of pictures."""

    def encode(self, label: NDArray[np.float32]) -> NDArray[np.float32]:
        """The latent (h, w, c) of a picture (H, W, 3), of about unit variance."""
        ...

    def decode(self, latent: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
        """The picture (H, W, 3), range [0, 1], of a latent (h, w, c)."""
        ...


@runtime_checkable
class VolumeSolver(Protocol):
    """A prior that solves for a volume, which labels all planes at once."""

    def solve(
        self,
        body: Body,
        up: NDArray[np.float64],  # [3]
        families: Sequence[Family],
        voxels: int,
        seed: int,
        progress: Progress,
    ) -> Volume:
        """The interior on a grid of `voxels` cells along the body's longest side. Bit-equal for a seed.

        Uses fewer cells if its sources resolve less.
        """
        ...
