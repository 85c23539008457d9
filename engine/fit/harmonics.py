"""The colours that atoms show to a camera as a torch function, differentiable in their harmonics and means.

Torch's own derivative of the basis functions takes half of a fitting step with harmonics of degree 3: it keeps dozens
of arrays as long as there are atoms, where a view shows a third of them and gives the rest no gradient.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit

from engine.render.projection import camera_record, view_direction
from engine.scene.camera import Camera
from engine.scene.sh import direction_gradient, fill_basis
from engine.threads import for_each

__all__ = ["harmonic_colours"]

CHUNK = 2048
"""Atoms in a task."""


def harmonic_colours(means: torch.Tensor, sh: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(S, 3). RGB of atoms with harmonics (S, (d+1)^2, 3) at means (S, 3), as in `engine.scene.sh.colours`."""
    return _HarmonicColours.apply(means, sh, camera)


class _HarmonicColours(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, means: torch.Tensor, sh: torch.Tensor, camera: Camera) -> torch.Tensor:
        context.arguments = (
            means.detach().contiguous().numpy(),
            sh.detach().contiguous().numpy(),
            camera_record(camera),
            np.asarray(camera.position, np.float64),
        )
        out = np.empty((len(means), 3), context.arguments[0].dtype)
        for_each(_colours, -(-len(out) // CHUNK), *context.arguments, out)
        return torch.from_numpy(out)

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        means, sh, _, _ = context.arguments
        given = gradients[0].contiguous().numpy()
        out = np.zeros_like(means), np.zeros_like(sh)
        for_each(_colours_backward, -(-len(given) // CHUNK), *context.arguments, given, *out)
        return (*(torch.from_numpy(o) for o in out), None)


@njit(cache=True, error_model="numpy", nogil=True)
def _colours(
    chunk,
    means,  # [S, 3]
    sh,  # [S, K, 3]
    cam,  # CameraRecord
    eye,  # [3]
    out,  # out [S, 3]
):
    """The colours of a chunk of atoms."""
    bands = sh.shape[1]
    basis = np.empty(16, np.float64)
    for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(means))):
        x, y, z, _ = view_direction(cam, eye, means[i, 0], means[i, 1], means[i, 2])
        fill_basis(x, y, z, bands, basis)
        for channel in range(3):
            value = 0.5
            for band in range(bands):
                value += basis[band] * sh[i, band, channel]
            out[i, channel] = max(value, 0.0)


@njit(cache=True, error_model="numpy", nogil=True)
def _colours_backward(
    chunk,
    means,  # [S, 3]
    sh,  # [S, K, 3]
    cam,  # CameraRecord
    eye,  # [3]
    given,  # [S, 3] dL/d(colour)
    g_means,  # out [S, 3], zeros
    g_sh,  # out [S, K, 3], zeros
):
    """The gradients of a chunk of atoms; a colour clamped to 0 passes none on."""
    bands = sh.shape[1]
    basis, g_basis = np.empty(16, np.float64), np.empty(16, np.float64)
    for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(means))):
        if given[i, 0] == 0.0 and given[i, 1] == 0.0 and given[i, 2] == 0.0:
            continue
        x, y, z, length = view_direction(cam, eye, means[i, 0], means[i, 1], means[i, 2])
        fill_basis(x, y, z, bands, basis)
        g_basis[:] = 0.0
        for channel in range(3):
            value = 0.5
            for band in range(bands):
                value += basis[band] * sh[i, band, channel]
            if value < 0.0:
                continue
            for band in range(bands):
                g_sh[i, band, channel] = basis[band] * given[i, channel]
                g_basis[band] += sh[i, band, channel] * given[i, channel]
        if bands > 1 and length > 0.0:
            gx, gy, gz = direction_gradient(x, y, z, bands, g_basis)
            along = gx * x + gy * y + gz * z
            g_means[i, 0] = (gx - along * x) / length
            g_means[i, 1] = (gy - along * y) / length
            g_means[i, 2] = (gz - along * z) / length
