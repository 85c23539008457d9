"""How much of a picture each Gaussian of a capture really decides: what compositing hides or thins is not seen."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray

from engine.render.classic.rasterizer import rasterize
from engine.render.projection import (
    camera_point,
    camera_record,
    half_axes,
    jacobian,
    screen_axes,
    screen_covariance,
)
from engine.scene.camera import Camera
from engine.scene.constants import LOW_PASS
from engine.scene.gaussians import Gaussians

__all__ = ["shown"]


def shown(gaussians: Gaussians, cameras: Sequence[Camera]) -> NDArray[np.float32]:
    """(N,). The opacity that each Gaussian is left with in the view that shows it best. Range [0, 1].

    In one view: the sum over pixels of alpha times the light that reaches it (its weight in the classic picture), over
    the area 2 pi sqrt(det C) of its footprint. Alone in front of the camera that is its own opacity; behind others, 0.
    """
    means, scales, quats, opacities = (
        torch.from_numpy(np.ascontiguousarray(array, np.float32))
        for array in (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities)
    )
    best = np.zeros(len(gaussians), np.float32)
    for camera in cameras:
        # A picture is linear in the colours: its derivative by one of them is that Gaussian's weight.
        colours = torch.zeros(len(gaussians), 3, requires_grad=True)
        rasterize(means, scales, quats, opacities, colours, camera)[0][..., 0].sum().backward()
        assert colours.grad is not None
        area = _areas(camera_record(camera), means.numpy(), scales.numpy(), quats.numpy())
        best = np.maximum(best, colours.grad.numpy()[:, 0] / area)
    return np.minimum(best, 1)


@njit(cache=True, error_model="numpy")
def _areas(cam, means, scales, quats):
    """(N,) float32. Integral of each unopposed footprint, pixels; infinite where there is none."""
    out = np.empty(len(means), np.float32)
    for i in range(len(means)):
        x, y, z = camera_point(cam, means[i, 0], means[i, 1], means[i, 2])
        axes = half_axes(
            cam, quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3], scales[i, 0], scales[i, 1], scales[i, 2]
        )
        det = screen_covariance(screen_axes(jacobian(cam, x, y, z), axes), LOW_PASS)[3]
        out[i] = 2.0 * math.pi * math.sqrt(det) if z > cam.near and det > 0.0 and det < 1e60 else np.inf
    return out
