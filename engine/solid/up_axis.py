"""Which way is up: captures differ, and nothing in the file says so. A guess that the user can overrule."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.scene.gaussians import Gaussians

__all__ = ["detect_up"]

FAINT = 0.1
"""Opacity under which a Gaussian says nothing about the object's shape."""

SLAB = 0.06
"""Of an axis' extent. What stands within this of an end may be what the object stands on."""

SUPPORT = 0.22
"""Share of all centres in one end's slab from which it is a floor. A ball has its 6 %, a box's own face about 17 %."""

BASE_SLAB = 0.08
BASE_OVER_OTHERS = 1.3
BASE_OVER_OPPOSITE = 2.0
"""An object stands on an end when, within this share of the axis' extent, it has so much more skin there than at the
ends of the other axes and at the opposite end: a pot's foot has 2.2 and 3.7 times as much, a fruit's lower end 1.5 and
1.8 at most."""

ROUND = 0.12
"""Relative difference of the two variances across an axis under which the object is round about it."""

SQUAT = 0.8
"""Variance along an axis over that across it, under which the object is flattened along it."""

NAMES = ("x", "y", "z")


def detect_up(gaussians: Gaussians) -> tuple[NDArray[np.float64], str]:
    """(3,) unit vector among +-x, +-y, +-z, and the reason in words.

    A floor or mat under the object decides first, then a broad end to stand on, then the axis that the object is round
    about, then +z.
    """
    default = np.array([0.0, 0.0, 1.0])
    seen = gaussians[gaussians.opacities >= FAINT]
    means = seen.means.astype(np.float64)
    if len(means) < 100:
        return default, "+z, too few Gaussians to tell"
    low, high = np.percentile(means, [0.5, 99.5], axis=0)
    middle = ((means >= low) & (means <= high)).all(axis=1)
    seen, means = seen[middle], means[middle]
    extent = np.maximum(high - low, 1e-12)
    ends = np.stack([(means < low + SLAB * extent).mean(0), (means > high - SLAB * extent).mean(0)])
    end, axis = divmod(int(ends.argmax()), 3)
    if ends[end, axis] > SUPPORT and ends[1 - end, axis] < ends[end, axis] / 2:
        up = np.zeros(3)
        up[axis] = 1.0 if end == 0 else -1.0
        return up, f"{'+' if end == 0 else '-'}{NAMES[axis]}, away from the floor it stands on"
    sizes = np.sort(seen.scales.astype(np.float64), axis=1)
    area = sizes[:, 1] * sizes[:, 2] * seen.opacities
    area = np.minimum(area, np.percentile(area, 99))  # a few huge ones are haze, not skin
    below, above = means < low + BASE_SLAB * extent, means > high - BASE_SLAB * extent
    skin = np.stack([area @ below, area @ above])
    end, axis = (int(i) for i in np.unravel_index(skin.argmax(), skin.shape))
    others = np.delete(skin, axis, axis=1).max()
    if skin[end, axis] > max(BASE_OVER_OTHERS * others, BASE_OVER_OPPOSITE * skin[1 - end, axis]):
        up = np.zeros(3)
        up[axis] = 1.0 if end == 0 else -1.0
        return up, f"{'+' if end == 0 else '-'}{NAMES[axis]}, away from the broad end it stands on"
    variance = means.var(axis=0)
    unround = np.array(
        [abs(variance[b] - variance[c]) / (variance[b] + variance[c]) for b, c in ((1, 2), (0, 2), (0, 1))]
    )
    # z unless the object is plainly round about another axis and squat along it: a long round thing lies on its side,
    # and a ball is round about all three.
    squat = np.array([2 * variance[a] / (variance.sum() - variance[a]) for a in range(3)]) < SQUAT
    axis = int(np.where(squat, unround, np.inf).argmin())
    if squat[axis] and unround[axis] < ROUND < unround[2]:
        # Upright scans of small things have y up when they come from a viewer and down when from a camera rig; the
        # flatter end is the one they lie on.
        sign = 1.0 if ends[0, axis] >= ends[1, axis] else -1.0
        up = np.zeros(3)
        up[axis] = sign
        return up, f"{'+' if sign > 0 else '-'}{NAMES[axis]}, the axis it is round about"
    return default, "+z, the axis it is round about" if unround[
        2
    ] < ROUND else "+z, nothing in the scene says otherwise"
