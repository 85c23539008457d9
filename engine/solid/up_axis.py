"""Guesses which way is up: captures differ, and nothing in the file says. The user can overrule it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.scene.gaussians import Gaussians

__all__ = ["detect_up"]

MIN_OPACITY = 0.1
"""Opacity under which a Gaussian is no evidence of the object's shape."""

SLAB = 0.06
"""Share of an axis' extent: the slab at either end that may be what the object stands on."""

SUPPORT = 0.22
"""Share of all centres in a slab from which it is a floor. A ball's slab has 6 %, the face of a box about 17 %."""

BASE_SLAB = 0.08
BASE_OVER_OTHERS = 1.3
BASE_OVER_OPPOSITE = 2.0
"""An object stands on an end if the slab there, BASE_SLAB of the extent, has this many times the skin of the ends of
the other axes and of the opposite end: a pot's foot has 2.2 and 3.7 times as much, a fruit's lower end at most 1.5 and
1.8."""

ROUND = 0.12
"""Relative difference of the two variances across an axis under which the object is round about that axis."""

SQUAT = 0.8
"""Ratio of the variance along an axis to that across it, under which the object is squat along it."""

NAMES = ("x", "y", "z")


def detect_up(gaussians: Gaussians) -> tuple[NDArray[np.float64], str]:
    """(3,) unit vector, one of +-x, +-y, +-z, and the reason in words for the user.

    A floor or mat under the object decides first, then a broad base, then an axis about which it is round, then +z.
    """
    default = np.array([0.0, 0.0, 1.0])
    opaque = gaussians[gaussians.opacities >= MIN_OPACITY]
    means = opaque.means.astype(np.float64)
    if len(means) < 100:
        return default, "+z, too few Gaussians to tell"
    low, high = np.percentile(means, [0.5, 99.5], axis=0)
    middle = ((means >= low) & (means <= high)).all(axis=1)
    opaque, means = opaque[middle], means[middle]
    extent = np.maximum(high - low, 1e-12)
    ends = np.stack([(means < low + SLAB * extent).mean(0), (means > high - SLAB * extent).mean(0)])
    end, axis = divmod(int(ends.argmax()), 3)
    if ends[end, axis] > SUPPORT and ends[1 - end, axis] < ends[end, axis] / 2:
        up = np.zeros(3)
        up[axis] = 1.0 if end == 0 else -1.0
        return up, f"{'+' if end == 0 else '-'}{NAMES[axis]}, away from the floor it stands on"
    sizes = np.sort(opaque.scales.astype(np.float64), axis=1)
    area = sizes[:, 1] * sizes[:, 2] * opaque.opacities
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
    asymmetry = np.array(
        [abs(variance[b] - variance[c]) / (variance[b] + variance[c]) for b, c in ((1, 2), (0, 2), (0, 1))]
    )
    # z unless the object is clearly round about another axis and squat along it: a long round object lies on its side,
    # and a ball is round about all three axes.
    squat = np.array([2 * variance[a] / (variance.sum() - variance[a]) for a in range(3)]) < SQUAT
    axis = int(np.where(squat, asymmetry, np.inf).argmin())
    if squat[axis] and asymmetry[axis] < ROUND < asymmetry[2]:
        # Scans of small objects have y up when they come from a viewer, and y down when from a camera rig; they lie on
        # the flatter end.
        sign = 1.0 if ends[0, axis] >= ends[1, axis] else -1.0
        up = np.zeros(3)
        up[axis] = sign
        return up, f"{'+' if sign > 0 else '-'}{NAMES[axis]}, the axis it is round about"
    return default, "+z, the axis it is round about" if asymmetry[
        2
    ] < ROUND else "+z, nothing in the scene says otherwise"
