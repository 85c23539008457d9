"""The edge of a cut face: how far it lies in each direction, and where a picture shows what lies so deep under it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.patches import OVER
from training.priors.exemplar.sampling import read_bilinear, smoothstep

__all__ = ["ANGLES", "INSET_STEP", "UNDER", "Outline", "find_insets", "find_rims", "skin_weight"]

ANGLES = 180
"""Directions around the axis in which the rim of a slice is sampled."""

UNDER = 1.2
"""Depth over that of the rind from which a face shows nothing of it: its edge is blurred."""

INSET_STEP = 0.5
"""Cells between two samples of the depth; one pixel of a scaled picture."""


@dataclass(frozen=True)
class Outline:
    """The edge of a cut face in a picture."""

    middle: tuple[float, float]
    """Centre (x, y) in cells."""
    half: tuple[float, float]
    """Half width and half height of the cut face in cells."""
    rims: NDArray[np.float32]
    """(ANGLES,). Distance of the edge from the centre, counter-clockwise from the right, in cells."""
    insets: NDArray[np.float32]
    """(ANGLES, L). Distance from the edge towards the centre, in cells, at which the depth reaches l * INSET_STEP
    cells."""

    def rim(self, angle: NDArray[np.floating]) -> NDArray[np.float32]:
        """(...). Distance of the edge from the centre at angles in radians."""
        turn = np.asarray(angle) / (2 * np.pi) * ANGLES - 0.5
        return np.interp(turn, np.arange(ANGLES), self.rims, period=ANGLES).astype(np.float32)

    def inset(self, angle: NDArray[np.floating], depth: NDArray[np.floating]) -> NDArray[np.float32]:
        """(...). Distance from the edge towards the centre, at angles in radians, of points `depth` cells under it.

        Larger than the depth itself at a corner, such as a loaf's.
        """
        turn = (np.asarray(angle) / (2 * np.pi) * ANGLES - 0.5) % ANGLES
        closed = np.concatenate([self.insets, self.insets[:1]])[..., None]
        return read_bilinear(closed, turn.ravel(), (np.asarray(depth) / INSET_STEP).ravel()).reshape(turn.shape)

    def position(
        self,
        angle: NDArray[np.floating],
        share: NDArray[np.floating],
        depth: NDArray[np.floating],
        inradius: float,
        rind: float,
        reaches_rind: bool = False,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M,), (M,). Place in the picture, in cells, of points of a body at an angle, a share of the rim and a depth
        in inradii: at equal depth near the skin, at an equal share of the rim below, but in no rind. `inradius`: the
        body's, in cells. `rind`: thickness of the layers along the skin, in inradii. `reaches_rind`: whether the share
        counts down to the rind, as for a core or a membrane that joins it."""
        rim = self.rim(angle)
        by_depth = np.maximum(rim - self.inset(angle, depth * inradius), 0)
        under_rind = np.maximum(rim - self.inset(angle, np.minimum(depth, UNDER * rind) * inradius), 0)
        near = skin_weight(depth, rind, narrow=reaches_rind)
        r = near * by_depth + (1 - near) * np.minimum(share * rim, under_rind)
        return self.middle[0] + r * np.cos(angle), self.middle[1] - r * np.sin(angle)


def skin_weight(depth: NDArray[np.floating], rind: float, narrow: bool = False) -> NDArray[np.floating]:
    """1 within the rind, falling smoothly to 0 below it; in a narrow zone, right below it."""
    if narrow:
        return 1 - smoothstep((depth - rind) / ((UNDER - 1) * rind + 0.02))
    return 1 - smoothstep((depth - 1.1 * rind) / (0.7 * rind + 0.1))


def find_rims(mask: NDArray[np.bool_], middle: tuple[float, float]) -> NDArray[np.float32]:
    """(ANGLES,). Distance of a mask's edge from its centre in cells; the mask has OVER pixels per cell."""
    angles = (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi
    reach = np.arange(0, np.hypot(*mask.shape), 0.5)
    x = middle[0] * OVER + np.cos(angles)[:, None] * reach
    y = middle[1] * OVER - np.sin(angles)[:, None] * reach
    hit = ndimage.map_coordinates(mask.astype(np.float32), np.stack([y, x]), order=1, mode="constant") > 0.5
    last = len(reach) - 1 - np.argmax(hit[:, ::-1], axis=1)
    rims = np.where(hit.any(1), reach[last], 1.0) / OVER
    return np.maximum(ndimage.gaussian_filter1d(rims, 1.0, mode="wrap"), 1.0).astype(np.float32)


def find_insets(
    depth: NDArray[np.float32], middle: tuple[float, float], rims: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(ANGLES, L). `Outline.insets` of a depth map (H, W) in cells with OVER pixels per cell; the search ends at
    the centre."""
    angles = (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi
    inward = np.arange(0, float(rims.max()), INSET_STEP, dtype=np.float32)
    r = np.maximum(rims[:, None] - inward, 0)
    x = (middle[0] + np.cos(angles)[:, None] * r) * OVER
    y = (middle[1] - np.sin(angles)[:, None] * r) * OVER
    found = ndimage.map_coordinates(depth, np.stack([y, x]), order=1, mode="constant")
    # Monotone: beyond the ridge of the shape the depth falls again, which belongs to the opposite skin.
    found = np.maximum.accumulate(found, axis=1)
    levels = np.arange(0, float(depth.max()) + INSET_STEP, INSET_STEP)
    steep = found + 1e-4 * inward  # strictly increasing, so that the inverse is unique
    insets = np.stack([np.interp(levels, row, inward) for row in steep])
    return np.minimum(insets, rims[:, None]).astype(np.float32)
