"""The motion of a film: closed forms of its presets and of films with few keyframes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.model.film.motion import Film, Keyframe, frame_count, frames, placed
from app.model.film.presets import EDGE, PARTED, explode, sweep, turntable
from app.model.film.record import film_record, read_film
from app.model.pieces import PointSample
from engine.errors import InputError
from engine.scene.plane import Plane

START = Keyframe(0.0, 33.3, 20.0, 1.1, (Plane.of((0, 1, 1), 0.1),))
BALL = PointSample.of(np.random.default_rng(0).uniform(-1, 1, (2000, 3)))


def test_a_turntable_turns_evenly_and_ends_where_it_began() -> None:
    film = turntable(START, 5.0)
    shown = list(frames(film, 50, (1.0, 2.0, 3.0)))
    assert film.closed and frame_count(film.seconds, 10) == 50
    assert np.allclose(np.diff([key.azimuth for key in shown]), 360 / 50, atol=1e-9)
    assert abs(shown[-1].azimuth + 360 / 50 - (START.azimuth + 360)) < 1e-9
    assert all(abs(key.elevation - 20) < 1e-9 and abs(key.zoom - 1.1) < 1e-9 for key in shown)
    assert max(abs(key.planes[0].offset - START.planes[0].offset) for key in shown) < 1e-12


def test_a_sweep_passes_from_one_side_to_the_other_and_back() -> None:
    plane = Plane.of((1, -2, 2), 0.3)
    film = sweep(START, 4.0, plane, BALL.points)
    along = BALL.points @ plane.normal
    low, high = along.min(), along.max()
    shown = list(frames(film, 80, BALL.centre))
    places = np.array([-key.planes[0].offset for key in shown])
    assert all(np.allclose(key.planes[0].normal, plane.normal) for key in shown)
    ends = low + (high - low) * np.array([EDGE, 1 - EDGE])
    assert np.allclose([places[40], places[0]], ends) and places.min() >= ends[0] - 1e-9
    assert (np.diff(places[:41]) < 0).all() and (np.diff(places[40:]) > 0).all()
    assert np.allclose(places[1:40], places[:40:-1])  # the way back is the way there, reversed
    steps = np.abs(np.diff([*places, places[0]]))
    assert steps.max() < 1.5 * 2 * (ends[1] - ends[0]) / 80 + 1e-9  # a smoothstep is 1.5 times as fast in the middle
    assert all(key.planes[1] == shown[0].planes[1] for key in shown)


def test_pieces_explode_and_come_together_as_in_the_window() -> None:
    cut = Plane.of((1, 0, 0), 0.0)
    film = explode(replace(START, planes=()), 2.0, (cut,))
    shown = list(frames(film, 20))
    whole, apart = placed(film, shown[0], BALL), placed(film, shown[10], BALL)
    assert abs(shown[10].explosion - PARTED) < 1e-12 and len(whole) == len(apart) == 2
    assert all(np.allclose(piece.transform, np.eye(4)) for piece in whole)
    left, right = (piece.transform[0, 3] for piece in apart)
    middles = [BALL.points[BALL.points[:, 0] * side > 0, 0].mean() - BALL.centre[0] for side in (-1, 1)]
    assert np.allclose([left, right], [PARTED * m + side * 0.08 * PARTED * BALL.radius for m, side in
                                       zip(middles, (-1, 1), strict=True)])  # fmt: skip


def test_two_keyframes_are_a_smoothstep_the_short_way_round() -> None:
    film = Film((Keyframe(0, 170, 0, 1.0), Keyframe(2, -170, 40, 4.0)))
    shown = list(frames(film, 21))
    s = np.linspace(0, 1, 21)
    eased = 3 * s**2 - 2 * s**3
    assert not film.closed
    assert np.allclose([key.azimuth for key in shown], 170 + 20 * eased)
    assert np.allclose([key.elevation for key in shown], 40 * eased)
    assert np.allclose([key.zoom for key in shown], 4**eased)


def test_a_plane_turns_about_the_centre() -> None:
    centre = np.array([3.0, -1.0, 2.0])
    planes = [Plane.through(centre, normal) for normal in ((0, 0, 1), (1, 0, 0.2), (0, 1, 0))]
    film = Film(tuple(Keyframe(t, 0, 0, planes=(plane,)) for t, plane in enumerate(planes)))
    assert all(abs(key.planes[0].distance(centre)) < 1e-9 for key in frames(film, 33, centre))


def test_a_film_is_read_again_and_a_bad_one_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "turn.json"
    film = Film((START, replace(START, time=3.0, azimuth=90.0, explosion=0.5)), (Plane.of((1, 0, 0), 0.25),))
    path.write_text(json.dumps(film_record(film)))
    assert read_film(path) == film
    first: dict[str, Any] = {"time": 0, "azimuth": 0, "elevation": 0}
    last: dict[str, Any] = {**first, "time": 1}
    for keys, wrong in (
        ([first], "1 keyframes"),
        ([first, {**last, "time": 0}], "not after"),
        ([last, {**last, "time": 2}], "is not 0"),
        ([first, {**last, "zoom": 0}], "'zoom' is not between"),
        ([first, {**last, "colour": 0}], "unknown field ['colour']"),
        ([first, {"time": 1, "azimuth": 0}], "'elevation' is not a number"),
        ([first, {**last, "planes": [[0, 0, 1, 0]]}], "another number of 'planes'"),
        ([first, {**last, "planes": [[0, 0, 0, 1]]}], "not zero"),
        ([first | {"planes": [[0, 0, 1, 0]]}, last | {"planes": [[1, 0, -1, 0]]}], "more than 90 degrees"),
        (first, "no list"),
    ):
        path.write_text(json.dumps({"fruitninja_film": 1, "keyframes": keys}))
        with pytest.raises(InputError) as raised:
            read_film(path)
        said = str(raised.value)
        assert said.startswith(f"{path}: not a film: ") and wrong in said and "\n" not in said
    for text in ("", "[1]", "{}", '{"fruitninja_film": 1, "fruitninja_film": 1}', '{"fruitninja_film": NaN}'):
        path.write_text(text)
        with pytest.raises(InputError, match="not a film"):
            read_film(path)
