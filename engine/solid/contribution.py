"""How much each Gaussian of a capture contributes to its pictures: compositing hides some and thins others."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.classic.rasterizer import composite_weights
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

__all__ = ["contributions"]


def contributions(
    gaussians: Gaussians, cameras: Sequence[Camera]
) -> tuple[NDArray[np.float32], list[NDArray[np.float32]]]:
    """The opacity (N,) that compositing leaves each Gaussian in the view that shows it best, range [0, 1], and each
    view's median depth (H, W), inf where less than half of the light is stopped.

    In one view the opacity is the Gaussian's weight in the classic picture, summed over the pixels (alpha times the
    transmittance in front of it), over the area 2 pi sqrt(det C) of its footprint. A Gaussian alone in front of the
    camera keeps its own opacity; one hidden behind others has 0.
    """
    means, scales, quats = (
        np.ascontiguousarray(array, np.float32) for array in (gaussians.means, gaussians.scales, gaussians.quats)
    )
    best, medians = np.zeros(len(gaussians), np.float32), []
    for camera in cameras:
        weights, median = composite_weights(gaussians, camera)
        best = np.maximum(best, weights / _footprint_areas(camera_record(camera), means, scales, quats))
        medians.append(median)
    return np.minimum(best, 1), medians


@njit(cache=True, error_model="numpy")
def _footprint_areas(cam, means, scales, quats):
    """(N,) float32. Area of each footprint, pixels; infinite for a Gaussian that the camera does not see."""
    out = np.empty(len(means), np.float32)
    for i in range(len(means)):
        x, y, z = camera_point(cam, means[i, 0], means[i, 1], means[i, 2])
        axes = half_axes(
            cam, quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3], scales[i, 0], scales[i, 1], scales[i, 2]
        )
        det = screen_covariance(screen_axes(jacobian(cam, x, y, z), axes), LOW_PASS)[3]
        out[i] = 2.0 * math.pi * math.sqrt(det) if z > cam.near and det > 0.0 and det < 1e60 else np.inf
    return out
