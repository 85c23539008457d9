"""Scenes of several bodies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from engine.io.load import load
from engine.scene.gaussians import Gaussians
from tests.paths import SAMPLES

__all__ = ["beside", "three_samples"]


def beside(*scenes: Gaussians, places: Sequence[Sequence[float]], size: float = 1.0) -> Gaussians:
    """The scenes in one, each scaled to a longest side of `size` around its place (3,); as many harmonics as the one
    with the fewest has."""
    bands = min(scene.sh.shape[1] for scene in scenes)
    columns = []
    for scene, place in zip(scenes, places, strict=True):
        low, high = scene.visible_bounds()
        factor = np.float32(size / (high - low).max())
        means = ((scene.means - (low + high) / 2) * factor + np.asarray(place)).astype(np.float32)
        columns.append((means, scene.scales * factor, scene.quats, scene.opacities, scene.sh[:, :bands]))
    return Gaussians(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def three_samples() -> tuple[Gaussians, list[int]]:
    """The three samples beside each other, and how many Gaussians each has."""
    scenes = [load(Path(SAMPLES / name / f"{name}.ply")).gaussians for name in ("watermelon", "orange", "bread")]
    places = ((0, 0, 0), (1.3, 0, 0), (0.6, 1.3, 0))
    return beside(*scenes, places=places), [len(scene) for scene in scenes]
