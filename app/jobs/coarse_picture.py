"""The first picture of a large capture: a sample of its Gaussians, shown until all of them are read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from engine.io.load import LoadedScene, load_sample

__all__ = ["coarse_picture"]

LEAST_FILE = 16 << 20
"""Smallest file that is sampled, bytes. A smaller one is read in less than a second: it has a few hundred thousand
Gaussians, or, as an .spz of degree 0, one million."""

MOST = 1 << 15
"""Most Gaussians in the picture: each costs a page of 4 to 8 kB read from disk, so 0.3 GB for all of them."""

NEIGHBOURS = 6
"""Number of nearest neighbours that surround a Gaussian on a surface."""

REACH = 0.5
"""Standard deviation of an enlarged Gaussian, in distances to the last of its NEIGHBOURS: kernels then overlap."""

LARGEST = 0.02
"""Largest standard deviation after enlarging, as a part of the capture's longest side: a floater far from all others
would otherwise become a ball in front of them."""


def coarse_picture(path: Path) -> LoadedScene | None:
    """A sample of the Gaussians in a large file, enlarged so that they cover what all of them cover.

    None for a small file, and for one that is better read as a whole (engine.io.load.load_sample).
    """
    large = path.is_file() and path.stat().st_size >= LEAST_FILE
    sample = load_sample(path, MOST) if large else None
    if sample is None or len(sample.gaussians) <= NEIGHBOURS:
        return None
    gaussians = sample.gaussians
    distance = cKDTree(gaussians.means).query(gaussians.means, NEIGHBOURS + 1)[0][:, -1]
    low, high = np.percentile(gaussians.means, [5, 95], axis=0)
    sizes = np.sort(gaussians.scales, axis=1)
    wanted = REACH * distance / np.sqrt(sizes[:, 1] * sizes[:, 2])
    allowed = LARGEST * float((high - low).max()) / sizes[:, 2]
    factor = np.maximum(np.minimum(wanted, allowed), 1)[:, None]
    enlarged = replace(gaussians, scales=(gaussians.scales * factor).astype(np.float32))
    return replace(sample, gaussians=enlarged)
