"""Separate bodies: which are told apart, which stay one, and what belongs to which."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.load import load
from engine.io.splats.ply import write_ply
from engine.isolate.bodies import find_bodies
from engine.isolate.selection import removed, split_bodies
from engine.scene.camera import spread_directions
from engine.scene.gaussians import Gaussians
from tests.helpers.solids import round_gaussians, three_samples
from tests.paths import SAMPLES, SHARED
from training.cli import runs_of_bodies
from training.isolation_options import parse_body, parse_isolation, select_bodies
from training.request import Request

Points = NDArray[np.float64]


def ball(count: int, radius: float, centre: tuple[float, float, float]) -> Points:
    """Points (count, 3) evenly on a sphere."""
    return spread_directions(count) * radius + centre


def gaussians(*parts: Points, scale: float = 0.03) -> Gaussians:
    """Opaque balls, all of the same size."""
    return round_gaussians(np.concatenate(parts), scale)


LARGE, SMALL = ball(4000, 1.0, (0, 0, 0)), ball(1000, 0.4, (2.0, 0, 0))
SHEET = np.random.default_rng(1).uniform((-0.5, 1.6, 0), (0.5, 2.6, 0), (1500, 3))


def test_two_balls_are_two_bodies_in_any_units_and_touching_ones_are_one() -> None:
    for unit in (1e-3, 1.0, 1e3):
        scene = gaussians(SMALL * unit, LARGE * unit, scale=0.03 * unit)
        bodies = find_bodies(scene)
        assert np.array_equal(bodies.labels, np.arange(5000) < 1000)  # the body with more Gaussians comes first
        at = [bodies.labels[(scene.means == np.array(point, np.float32)).all(1)] for point in bodies.points]
        assert [label.tolist() for label in at] == [[0], [1]]
    assert find_bodies(gaussians(LARGE, SMALL - (0.65, 0, 0))).points == ()
    assert find_bodies(gaussians(LARGE)).points == () == find_bodies(gaussians(LARGE[:0])).points


def test_what_has_no_inside_stays_with_the_nearest_body() -> None:
    specks = np.full((3, 3), (2.0, 0.0, 0.6))  # above the small ball
    scene = gaussians(LARGE, SMALL, SHEET, specks)
    scene.scales[5000:6500, 2] = 0.002  # a mat beside the large one
    labels = find_bodies(scene).labels
    assert not labels[:4000].any() and labels[4000:5000].all()
    assert not labels[5000:6500].any() and labels[6500:].all()
    assert find_bodies(scene[(np.arange(6503) < 4000) | (np.arange(6503) >= 5000)]).points == ()


def test_three_samples_in_one_file_are_three_and_each_selection_leaves_one() -> None:
    scene, counts = three_samples()
    expected = np.repeat([0, 1, 2], counts)
    selections = split_bodies(scene)
    assert len(selections) == 3
    owners = []
    for selection in selections:
        kept = ~removed(scene, (selection,))
        owners.append(int(np.bincount(expected[kept]).argmax()))
        assert (kept == (expected == owners[-1])).mean() > 0.995  # haze between two bodies may go with either
    assert owners == [2, 1, 0]


@pytest.mark.parametrize("name", ["watermelon", "orange", "bread"])
def test_a_sample_is_one_body(name: str) -> None:
    assert find_bodies(load(SAMPLES / name / f"{name}.ply").gaussians).points == ()


@pytest.mark.skipif(not SHARED.is_dir(), reason="the captures are not here")
@pytest.mark.parametrize("path", sorted((SHARED / "splats").glob("*")), ids=lambda path: path.name)
def test_a_real_capture_of_one_object_is_one_body(path: Path) -> None:
    scene = load(path).gaussians
    assert find_bodies(scene).points == ()
    rest = scene[~removed(scene, parse_isolation([], [], no_floor=True))]
    assert find_bodies(rest).points == ()


def test_the_command_line_names_a_body_by_its_number(tmp_path: Path) -> None:
    scene = gaussians(LARGE, SMALL)
    floor = parse_isolation([], ["plane:0,0,1,1.5"], no_floor=False)  # nothing lies there
    write_ply(tmp_path / "a.ply", scene, [])
    request = Request(tmp_path / "a.ply", (), isolation=floor)
    first, second = runs_of_bodies(request, None, tmp_path).items()
    assert (first[0], second[0]) == (tmp_path / "1", tmp_path / "2")
    assert np.array_equal(removed(scene, second[1].isolation), np.arange(5000) < 4000)
    assert runs_of_bodies(request, 1, tmp_path) == {tmp_path: first[1]}
    assert select_bodies(gaussians(LARGE), (), None, "a.ply") == {1: ()}
    with pytest.raises(InputError, match=r"^a\.ply: no body 3; it has 2$"):
        select_bodies(scene, (), 3, "a.ply")
    assert parse_body("all") is None and parse_body("12") == 12
    for text in ("0", "-1", "", "two", "1.5", "²"):
        with pytest.raises(InputError, match="give a number from 1, or all"):
            parse_body(text)
