"""Colours for the atoms that no training view shows: the paper's voxel smoothing (section 3.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["smooth"]

Float = NDArray[np.float32]

# Trained neighbours that are averaged. The paper averages those in a voxel; the nearest few avoid the borders of
# voxels, across which neighbours would have no effect.
NEIGHBOURS = 8


def smooth(
    means: Float,  # [I, 3]
    initial: Float,  # [I, 3]
    current: Float,  # [I, 3]
    trained: NDArray[np.bool_],  # [I]
) -> Float:
    """(I, 3). Trained atoms unchanged; every other one takes its neighbours' change, weighted by inverse distance.

    C = C0 + sum w_i (C_i - C0_i) / sum w_i. From a uniform start C0 this is the paper's weighted mean of the trained
    colours; a start that varies keeps its detail.
    """
    if trained.all() or not trained.any():
        return current
    count = min(NEIGHBOURS, int(trained.sum()))
    distance, index = cKDTree(means[trained]).query(means[~trained], k=count, workers=-1)
    distance, index = distance.reshape(-1, count), index.reshape(-1, count)
    # Coincident atoms have distance 0: the floor keeps their weight finite and still overwhelming.
    weight = 1.0 / np.maximum(distance, 1e-9 * max(1.0, float(np.abs(means).max())))
    weight /= weight.sum(axis=1, keepdims=True)
    change = (current - initial)[trained]
    result = current.copy()
    result[~trained] = initial[~trained] + np.einsum("ik,ikc->ic", weight, change[index]).astype(np.float32)
    return result
