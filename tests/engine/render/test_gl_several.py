"""Several solids in one frame: each as if it were alone, the nearer one in front, picked by its own pieces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from engine.render.gl import Renderer
from engine.scene.image import Picture
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from tests.helpers.gl_scenes import around, draw, tight_ball
from tests.helpers.solids import ball

HALF = Plane.of((0, 0, 1), 0.0)


def at(x: float, y: float = 0.0) -> np.ndarray:
    transform = np.eye(4)
    transform[:2, 3] = x, y
    return transform


@pytest.fixture(params=["kernels", "shaders"])
def drawer(request: pytest.FixtureRequest, offscreen: Renderer) -> Iterator[Renderer]:
    with Renderer(offscreen.ctx, shaders=request.param == "shaders") as made:
        yield made


def close(a: Picture, b: Picture, where: np.ndarray) -> bool:
    return bool(np.abs(a.rgb - b.rgb)[where].max() < 2 / 255 and np.abs(a.alpha - b.alpha)[where].max() < 2 / 255)


def test_each_solid_is_drawn_as_if_alone_and_hides_what_is_behind_it(drawer: Renderer) -> None:
    fine, coarse = tight_ball(1 / 24), tight_ball(1 / 16)
    camera = around(0, 20, 2.2, 160, 90)
    left, right = Piece((HALF,), at(0, -0.8)), Piece((HALF,), at(0, 0.8))
    drawer.set_atoms(fine, coarse)
    for _ in range(2):  # the second time from grids: each solid has its own in the same plane
        both = draw(drawer, camera, left, replace(right, solid=1), exact=False)
    half = np.arange(160) < 80
    for atoms, piece, side in ((fine, left, half), (coarse, right, ~half)):
        drawer.set_atoms(atoms)
        for _ in range(2):
            alone = draw(drawer, camera, piece, exact=False)
        assert alone.alpha[:, side].max() == 1 and not alone.alpha[:, ~side].any()
        assert close(both, alone, np.broadcast_to(side, (90, 160)))
    drawer.set_atoms(fine, coarse)
    near, far = Piece((), at(0.3)), Piece((), at(-1.5), 1)
    picture = draw(drawer, camera, far, near)
    number, point = drawer.pick(80, 45)
    assert number == 1 and point is not None and np.linalg.norm(point - (0.3, 0, 0)) == pytest.approx(0.5, abs=0.05)
    drawer.set_atoms(fine)
    alone = draw(drawer, camera, near)
    inner = ndimage.binary_erosion(alone.alpha > 0.999)  # along its outline, what is behind shines through
    assert inner.sum() > 1000 and close(picture, alone, inner)


def test_a_solid_is_recoloured_by_its_number(drawer: Renderer) -> None:
    atoms = ball(1 / 12, degree=0)
    dark = replace(atoms, surface=replace(atoms.surface, sh=-atoms.surface.sh))
    camera = around(0, 20, 2.2, 160, 90)
    pieces = (Piece((), at(0, -0.8)), Piece((), at(0, 0.8), 1))
    drawer.set_atoms(atoms, dark)
    expected = draw(drawer, camera, *pieces)
    other = replace(atoms)
    drawer.set_atoms(atoms, other)
    drawer.update_colours(dark.surface.sh, solid=1)
    assert np.array_equal(draw(drawer, camera, *pieces).rgb, expected.rgb)
    drawer.set_atoms(atoms, other)  # their original colours
    assert not np.array_equal(draw(drawer, camera, *pieces).rgb, expected.rgb)
