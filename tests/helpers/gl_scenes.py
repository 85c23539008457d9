"""Scenes for the tests of the GL engine, and how to draw them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors.numpy import load_file

from engine.render.gl import Renderer
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.camera import Camera, fit_distance, orbit
from engine.scene.gaussians import Gaussians
from engine.scene.image import Picture
from engine.scene.piece import Piece
from tests.helpers.solids import ball
from tests.paths import SHARED

FOV = math.radians(35)


def around(azimuth: float, elevation: float, distance: float = 1.0, width: int = 120, height: int = 90) -> Camera:
    """A camera that fits the ball of radius 0.5 at distance 1."""
    away = distance * fit_distance(0.5, FOV, width / height)
    return orbit((0, 0, 0), (0, 0, 1), azimuth, elevation, away, width, height, FOV)


def draw(renderer: Renderer, camera: Camera, *pieces: Piece, **options: Any) -> Picture:
    renderer.render(camera, pieces or (Piece(),), **options)
    return renderer.read()


def tight_ball(pitch: float) -> Atoms:
    """A ball whose interior reaches its skin: a plain lattice, and a layer half a pitch under the skin."""
    atoms = ball(pitch, degree=0)
    side = np.arange(-int(0.5 / pitch) - 1, int(0.5 / pitch) + 2) * pitch
    lattice = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
    lattice = lattice[np.linalg.norm(lattice, axis=1) < 0.5 - 0.6 * pitch]
    layer = atoms.surface.means * (1 - pitch)
    means = np.concatenate([lattice, layer]).astype(np.float32)
    rgb = (0.5 + 0.4 * np.sin(20 * means)).astype(np.float32)
    return Atoms(atoms.surface, InteriorAtoms(means, np.full(len(means), pitch / 2, np.float32), rgb), pitch)


def brush_case() -> tuple[Gaussians, Camera, NDArray[np.float32]]:
    """A few Gaussians, the camera, and the RGBA picture (H, W, 4) over black that Brush renders of them."""
    path = SHARED / "reference/brush_tiny_case.safetensors"
    if not path.exists():
        pytest.skip("the reference pictures are not here")
    case = load_file(path)
    quats = case["quats"] / np.linalg.norm(case["quats"], axis=1, keepdims=True)
    opacities = (1 / (1 + np.exp(-case["opacities"].ravel().astype(np.float64)))).astype(np.float32)
    height, width, _ = case["out_img"].shape
    view = np.eye(4)
    view[:3, 3] = -0.123, -0.456, 8.0
    camera = Camera(view, width / 2, width / 2, width / 2, height / 2, width, height)
    return Gaussians(case["means"], np.exp(case["scales"]), quats, opacities, case["coeffs"]), camera, case["out_img"]
