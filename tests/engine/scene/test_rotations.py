"""Rotations turn directions as they claim."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import DTypeLike

from engine.scene.rotations import facing, rotation_matrices


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_facing_takes_z_to_the_normal(kind: DTypeLike) -> None:
    """In all directions, at the poles, and a hair beside them."""
    rng = np.random.default_rng(0)
    poles = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], 400, axis=0)
    beside = poles + rng.normal(size=(800, 3)) * np.geomspace(1e-6, 0.1, 800)[:, None]
    normals = np.concatenate([rng.normal(size=(1000, 3)), poles, beside])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    quats = facing(normals.astype(kind))
    assert np.allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-12)
    off = np.linalg.norm(rotation_matrices(quats)[:, :, 2] - normals, axis=1)
    assert off.max() < 5e-4
    assert off[normals[:, 2] > -0.999].max() < 4 * np.finfo(kind).eps / (2 * 0.001) ** 0.5
