"""The part of the picture that pieces can touch holds all of them, whatever planes bound them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.render.cpu import opaque
from engine.render.culling.polygon import corners_within
from engine.render.gl import Renderer
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from tests.helpers.gl_scenes import around, draw, tight_ball

BOX = np.array([[-0.5, -0.4, -0.3], [0.5, 0.4, 0.3]])


def random_planes(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """(count, 4). Planes in all directions that keep the origin."""
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.column_stack([normals, -rng.uniform(0, 0.2, count)])


def vertices(planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V, 3). The corners of what planes (P, 4) keep of BOX: where three of all planes meet within the others."""
    sides = [np.append(sign * np.eye(3)[i], -abs(BOX[0, i])) for i in range(3) for sign in (1, -1)]
    every = np.concatenate([sides, planes])
    found = []
    for three in combinations(range(len(every)), 3):
        chosen = every[list(three)]
        if abs(np.linalg.det(chosen[:, :3])) > 1e-9:
            point = np.linalg.solve(chosen[:, :3], -chosen[:, 3])
            if (every[:, :3] @ point + every[:, 3] <= 1e-9).all():
                found.append(point)
    return np.array(found)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 8])
def test_the_corners_of_a_piece_are_found_where_three_cuts_meet(count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(40):
        planes = random_planes(rng, count)
        planes = np.concatenate([planes, planes[:1]])  # given twice, it is no less of a plane
        corners, expected = corners_within(planes, *BOX), vertices(planes)
        ways = rng.standard_normal((20, 3))
        assert np.allclose((corners @ ways.T).max(0), (expected @ ways.T).max(0), atol=1e-6)


@pytest.mark.parametrize("shaders", [False, True])
def test_a_piece_between_three_cuts_is_drawn_whole(shaders: bool, offscreen: Renderer) -> None:
    atoms = tight_ball(1 / 16)
    rng = np.random.default_rng(0)
    with Renderer(offscreen.ctx, shaders=shaders) as drawer:
        drawer.set_atoms(atoms)
        for view in range(12):
            planes = tuple(Plane.of(row[:3], row[3]) for row in random_planes(rng, 3))
            camera = around(30.0 * view, 40 - 8 * view)
            expected = opaque.render(atoms, camera, planes)
            assert np.abs(draw(drawer, camera, Piece(planes)).alpha - expected.alpha).mean() < 0.003
