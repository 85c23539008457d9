"""Atoms as the renderers read them, sorted by chunk. The geometry is fixed; colours can be replaced in place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.backface import BackfaceCulling, no_culling
from engine.render.culling.chunks import Chunks, build

__all__ = ["Ellipsoids", "Spheres"]

Float = NDArray[np.float32]


class Ellipsoids:
    """N splats with colours in spherical harmonics."""

    def __init__(
        self,
        means: Float,  # [N, 3] relative to the object's centre
        scales: Float,  # [N, 3]
        quats: Float,  # [N, 4]
        sh: Float,  # [N, (d+1)^2, 3]
        culling: BackfaceCulling | None = None,
    ) -> None:
        self.chunks: Chunks = build(means, scales.max(1, initial=0))
        order = self.chunks.order
        self.means = np.ascontiguousarray(means[order])
        self.reach = 3 * scales[order].max(1, initial=0)
        culling = culling or no_culling(len(means))
        self.culling = replace(
            culling, axes=np.ascontiguousarray(culling.axes[order]), min_cosine=culling.min_cosine[order]
        )
        """Culling of the atoms in the order of the chunks, with `low` relative to the object's centre."""
        self.degree = round(sh.shape[1] ** 0.5) - 1
        self.vectors = -(-3 * sh.shape[1] // 4)
        """Number of vec4 attributes that hold an atom's coefficients."""
        self.geometry = np.concatenate([self.means, scales[order], quats[order]], 1).astype(np.float32)
        """(N, 10). Mean, scales, quaternion."""
        self.coefficients = np.zeros((len(means), 4 * self.vectors), np.float32)
        """(N, 4 vectors). Packed spherical harmonics, three channels each."""
        self.version = 0
        """Grows with every change of the colours, so that copies know when they are out of date."""
        self.update(sh)

    def __len__(self) -> int:
        return len(self.means)

    @property
    def arrays(self) -> tuple[Float, Float]:
        """`geometry` and colours, as the kernels and GPU buffers take them."""
        return self.geometry, self.coefficients

    def update(self, sh: Float) -> None:
        """Replaces the colours, (N, (d+1)^2, 3) in the caller's order."""
        assert sh.shape == (len(self), (self.degree + 1) ** 2, 3), sh.shape
        if len(self):
            self.coefficients[:, : 3 * sh.shape[1]] = sh.reshape(len(self), 3 * sh.shape[1])[self.chunks.order]
        self.version += 1


class Spheres:
    """N interior atoms with one colour each."""

    def __init__(
        self,
        means: Float,  # [N, 3] relative to the object's centre
        sigmas: Float,  # [N]
        rgb: Float,  # [N, 3]
    ) -> None:
        self.chunks: Chunks = build(means, sigmas)
        self.low = means.min(0, initial=0).astype(np.float64)
        self.high = means.max(0, initial=0).astype(np.float64)
        order = self.chunks.order
        self.means = np.ascontiguousarray(means[order])
        self.reach = 3 * sigmas[order]
        self.geometry = np.concatenate([self.means, sigmas[order, None]], 1).astype(np.float32)
        """(N, 4). Mean, standard deviation."""
        self.rgb = np.zeros((len(means), 3), np.float32)
        """(N, 3). Colours."""
        self.version = 0
        """Grows with every change of the colours, so that copies know when they are out of date."""
        self.update(rgb)

    def __len__(self) -> int:
        return len(self.means)

    @property
    def arrays(self) -> tuple[Float, Float]:
        """`geometry` and colours, as the kernels and GPU buffers take them."""
        return self.geometry, self.rgb

    def update(self, rgb: Float) -> None:
        """Replaces the colours, (N, 3) in the caller's order."""
        assert rgb.shape == (len(self), 3), rgb.shape
        if len(self):
            self.rgb[:] = rgb[self.chunks.order]
        self.version += 1
