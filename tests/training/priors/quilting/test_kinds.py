"""The kinds that insides report, against faces of known rind, flesh, seeds and membranes."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.scene.inside import Inside, Kind
from tests.helpers.exemplar_faces import UP, ball, quiet, save
from training.families import Family
from training.priors.exemplar import ExemplarPrior
from training.priors.exemplar.quilting import quilt

FLESH, PALE, SEED, RIND = np.array([0.9, 0.5, 0.2]), [1.0, 0.9, 0.7], [0.15, 0.1, 0.05], [0.2, 0.6, 0.2]
SIZE, MEMBRANES = 300, 7


def truth(x: NDArray[np.floating], y: NDArray[np.floating], membranes: bool) -> NDArray[np.int64]:
    """Kinds at places of a face of radius 1: a rind a tenth thick, seeds in a ring and membranes between them."""
    radius, turn = np.hypot(x, y), np.arctan2(y, x) * MEMBRANES / (2 * np.pi)
    kind = np.full(x.shape, int(Kind.INSIDE))
    if membranes:
        off = np.abs(turn - np.round(turn)) * 2 * np.pi / MEMBRANES * radius
        kind[(off < 0.022) & (radius > 0.08)] = Kind.STRUCTURE
    between = np.abs(turn - np.floor(turn) - 0.5) * 2 * np.pi / MEMBRANES * radius
    kind[np.hypot(radius - 0.6, between) < 0.06] = Kind.THING
    kind[radius > 0.9] = Kind.RIND
    return kind


def face(membranes: bool, light: float = 1.0) -> NDArray[np.float64]:
    """That face as a picture on white, with a margin."""
    y, x = ((np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2 - 1) / 0.9
    colours = np.array([np.ones(3), FLESH, RIND, SEED, PALE]) * np.array([1, *4 * [light]])[:, None]
    return colours[np.where(np.hypot(x, -y) < 1, truth(x, -y, membranes), 0)]


@pytest.fixture(scope="module", params=["quilted", "layered"])
def inside(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Inside]:
    """The inside of a ball, from the horizontal face and, if quilted, a radial one without membranes in other light."""
    folder = tmp_path_factory.mktemp("faces")
    families = [Family("horizontal", 8, (save(folder / "h.png", face(True)),))]
    if request.param == "quilted":
        families.append(Family("radial", 8, (save(folder / "r.png", face(False, 0.9)),)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quilt, "LEVELS", (16, 32))  # colours and kinds are still read at every point
        made = ExemplarPrior().solve(ball(48), UP, families, 96, 0, quiet).inside
        assert made is not None
        yield made


@cache
def level(height: float) -> NDArray[np.float64]:
    """(M, 3). Points of a level cut through the ball."""
    u, v = np.meshgrid(*2 * [np.linspace(-1, 1, 201)])
    points = np.stack([u.ravel(), v.ravel(), np.full(u.size, height)], -1)
    return points[np.linalg.norm(points, axis=1) < 0.97]


def share(inside: Inside, height: float, told: Kind, where: NDArray[np.bool_]) -> float:
    """Share of the chosen points of a level cut where this kind is reported."""
    return float((inside.kinds(level(height))[where] == told).mean())


@pytest.mark.parametrize("kind", [Kind.INSIDE, Kind.RIND, Kind.THING, Kind.STRUCTURE])
def test_its_own_plane_has_the_kinds_of_the_picture(inside: Inside, kind: Kind) -> None:
    points = level(0.01)
    there = truth(points[:, 0], points[:, 1], True)
    clear = np.array(
        [
            (there == truth(points[:, 0] + dx, points[:, 1] + dy, True))
            for dx, dy in ((0.015, 0), (-0.015, 0), (0, 0.015), (0, -0.015))
        ]
    ).all(0)
    clear &= (np.hypot(points[:, 0], points[:, 1]) > 0.2) & (np.abs(points[:, 1]) > 0.1)
    assert share(inside, 0.01, kind, clear & (there == kind)) > 0.75
    assert share(inside, 0.01, kind, clear & (there != kind)) < 0.05


def test_seeds_end_and_the_rind_goes_on(inside: Inside) -> None:
    points = level(0.45)
    length = np.linalg.norm(points, axis=1)
    assert share(inside, 0.45, Kind.RIND, length > 0.93) > 0.95
    assert share(inside, 0.45, Kind.RIND, length < 0.8) < 0.02
    assert share(inside, 0.45, Kind.THING, length < 0.8) < 0.06  # the seeds in the picture's plane take 0.04
