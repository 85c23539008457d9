"""Atoms and Gaussians on the GPU, in the order of their chunks."""

from __future__ import annotations

from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.gl.chunks import Chunks, build
from engine.gl.facing import Hiding, nothing_hides

__all__ = ["Ellipsoids", "Spheres"]

Float = NDArray[np.float32]


class Ellipsoids:
    """N splats with spherical harmonics: geometry once, colours replaced in place."""

    def __init__(
        self,
        ctx: moderngl.Context,
        means: Float,  # [N, 3] relative to the object's centre
        scales: Float,  # [N, 3]
        quats: Float,  # [N, 4]
        sh: Float,  # [N, (d+1)^2, 3]
        hiding: Hiding | None = None,
    ) -> None:
        self.chunks: Chunks = build(means, scales.max(1, initial=0))
        order = self.chunks.order
        self.means = np.ascontiguousarray(means[order])
        self.reach = 3 * scales[order].max(1, initial=0)
        hiding = hiding or nothing_hides(len(means))
        self.hiding = replace(hiding, axes=np.ascontiguousarray(hiding.axes[order]), least=hiding.least[order])
        """In the order of the chunks, `low` relative to the object's centre."""
        self.degree = round(sh.shape[1] ** 0.5) - 1
        self.vectors = -(-3 * sh.shape[1] // 4)
        """vec4 attributes that hold an atom's coefficients."""
        geometry = np.concatenate([self.means, scales[order], quats[order]], 1).astype(np.float32)
        self._packed = np.zeros((len(means), 4 * self.vectors), np.float32)
        self.kept = geometry, self._packed
        """The same in memory: (N, 10) and coefficients (N, 4 vectors)."""
        self.geometry = ctx.buffer(geometry) if len(means) else ctx.buffer(reserve=40)
        self.coefficients = ctx.buffer(reserve=max(len(means), 1) * 16 * self.vectors)
        shape = {"mean": 3, "scale": 3, "quat": 4}
        self.streams = ((self.geometry, shape), (self.coefficients, {"sh": 4 * self.vectors}))
        self.flat_streams = ((self.geometry, shape), (self.coefficients, {"dc": 3, "rest": 4 * self.vectors - 3}))
        """The same without what depends on the view."""
        self.update(sh)

    def __len__(self) -> int:
        return len(self.means)

    def update(self, sh: Float) -> None:
        """Other colours, (N, (d+1)^2, 3) in the caller's order, for the same atoms."""
        assert sh.shape == (len(self), (self.degree + 1) ** 2, 3), sh.shape
        if len(self):
            self._packed[:, : 3 * sh.shape[1]] = sh.reshape(len(self), 3 * sh.shape[1])[self.chunks.order]
            self.coefficients.write(self._packed)

    def release(self) -> None:
        """Frees the buffers."""
        self.geometry.release()
        self.coefficients.release()


class Spheres:
    """N interior atoms."""

    def __init__(
        self,
        ctx: moderngl.Context,
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
        geometry = np.concatenate([self.means, sigmas[order, None]], 1).astype(np.float32)
        self._rgb = np.zeros((len(means), 3), np.float32)
        self.kept = geometry, self._rgb
        """The same in memory: (N, 4) and RGB (N, 3)."""
        self.geometry = ctx.buffer(geometry) if len(means) else ctx.buffer(reserve=16)
        self.colours = ctx.buffer(reserve=max(len(means), 1) * 12)
        self.streams = ((self.geometry, {"mean": 3, "sigma": 1}), (self.colours, {"rgb": 3}))
        self.update(rgb)

    def __len__(self) -> int:
        return len(self.means)

    def update(self, rgb: Float) -> None:
        """Other colours, (N, 3) in the caller's order, for the same atoms."""
        assert rgb.shape == (len(self), 3), rgb.shape
        if len(self):
            self._rgb[:] = rgb[self.chunks.order]
            self.colours.write(self._rgb)

    def release(self) -> None:
        """Frees the buffers."""
        self.geometry.release()
        self.colours.release()
