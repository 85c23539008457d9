"""Selections against brute force, growing over what touches, what is detected, and the JSON form."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.io.fields import Fields
from engine.io.load import load
from engine.isolate.floor import find_floor
from engine.isolate.record import isolation_record, read_isolation
from engine.isolate.selection import (
    INVERT,
    Below,
    BodyAt,
    Box,
    Detected,
    Isolation,
    Lasso,
    Sphere,
    Step,
    View,
    isolated,
    keep_only,
    removed,
)
from engine.scene.camera import orbit, spread_directions
from engine.scene.gaussians import Gaussians
from engine.scene.plane import Plane
from tests.helpers.solids import round_gaussians
from tests.paths import SHARED

Points = NDArray[np.float64]


def quat(rotation: Rotation) -> tuple[float, float, float, float]:
    x, y, z, w = (float(v) for v in rotation.as_quat())
    return w, x, y, z


CLOUD = round_gaussians(np.random.default_rng(3).normal(size=(5000, 3)))
TURN = Rotation.from_rotvec((0.3, -0.8, 0.5))
BOX = Box((-0.5, -0.2, -1.0), (0.7, 0.9, 0.4), quat(TURN))
SPHERE = Sphere((0.2, -0.3, 0.1), 0.8)
BELOW = Below(Plane.of((0.6, 0.0, 0.8), 0.25))


def test_boxes_spheres_and_half_spaces_contain_what_their_formulas_say() -> None:
    points = CLOUD.means.astype(np.float64)
    local = TURN.inv().apply(points)
    assert np.array_equal(BOX.contains(points), ((local >= BOX.low) & (local <= BOX.high)).all(1))
    assert np.array_equal(SPHERE.contains(points), np.linalg.norm(points - SPHERE.centre, axis=1) <= 0.8)
    assert np.array_equal(BELOW.contains(points), points @ (0.6, 0.0, 0.8) + 0.25 <= 0)
    assert 100 < BOX.contains(points).sum() < SPHERE.contains(points).sum() < BELOW.contains(points).sum() < 4000


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_lasso_contains_what_is_drawn_inside_of_it(orthographic: bool) -> None:
    camera = orbit((0, 0, 0), (0, 0, 1), 40, 25, 1.5, 300, 200)  # close: some points are behind the eye
    half = (1.5, 1.0) if orthographic else (150 / camera.fx, 100 / camera.fy)
    view = View(tuple(camera.position), quat(Rotation.from_matrix(camera.viewmat[:3, :3].T)), half, orthographic)
    star = [(math.sin(a) * r, math.cos(a) * r) for a, r in zip(np.arange(10) * 0.628, [0.9, 0.3] * 5, strict=True)]
    lasso = Lasso(view, tuple(star))
    local = CLOUD.means.astype(np.float64) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    ahead = local[:, 2] > 0
    places = local[:, :2] / half if orthographic else local[:, :2] / local[:, 2:] / half
    spokes = np.arctan2(*(np.array(star)[None] - places[:, None]).transpose(2, 0, 1))
    turns = (np.roll(spokes, -1, axis=1) - spokes + np.pi) % (2 * np.pi) - np.pi  # angle from corner to corner
    expected = (np.abs(turns.sum(1)) > np.pi) & (ahead | orthographic)
    assert np.array_equal(lasso.contains(CLOUD.means), expected)
    assert (~ahead).sum() > 50 and 200 < expected.sum() < 4000


def test_steps_follow_one_another_and_selections_look_at_what_is_left() -> None:
    points = CLOUD.means
    steps = (Step("add", SPHERE), Step("subtract", BOX), Step("add", BELOW), INVERT)
    outside = ~((SPHERE.contains(points) & ~BOX.contains(points)) | BELOW.contains(points))
    assert np.array_equal(removed(CLOUD, (steps,)), outside)
    both: Isolation = (keep_only(SPHERE, BOX), (Step("add", BELOW),))
    kept = (SPHERE.contains(points) | BOX.contains(points)) & ~BELOW.contains(points)
    assert np.array_equal(removed(CLOUD, both), ~kept)
    rest, notes = isolated(CLOUD, (*both, (Step("add", Detected("floor")),)), "cloud")
    assert np.array_equal(rest.means, points[kept])
    assert notes == [
        "it has no floor to leave out",
        f"{5000 - kept.sum()} of 5000 Gaussians are no part of the object",
    ]
    assert isolated(CLOUD, (), "cloud") == (CLOUD, [])
    with pytest.raises(InputError, match=r"^cloud: nothing is left"):
        isolated(CLOUD, ((INVERT,),), "cloud")


def test_a_selection_grows_over_its_blob_and_not_into_the_next() -> None:
    ball = spread_directions(3000)
    # The balls are 0.5 apart; on each, neighbours are 0.06 apart.
    scene = round_gaussians(np.concatenate([ball, ball + np.array((2.5, 0, 0))]))
    seed = Step("add", Sphere((-1.0, 0.0, 0.0), 0.2))
    assert np.array_equal(removed(scene, ((seed, Step("grow")),)), np.arange(6000) < 3000)
    # A faint veil that reaches both balls is not a bridge.
    veil = round_gaussians(np.concatenate([scene.means, [[1.25, 0, 0]]]))
    veil.scales[6000], veil.opacities[6000] = 0.3, 0.02
    assert removed(veil, ((seed, Step("grow")),))[:6000].sum() == 3000


BOX_COUNT = 6000


def room(rotation: Rotation, reach: float = 1.6, legs: int = 0) -> Gaussians:
    """A box of 1 x 0.6 x 1.5 on an uneven disc of radius `reach`, of the same density, somewhere in space."""
    rng = np.random.default_rng(2)
    sides = rng.uniform(-1, 1, (BOX_COUNT, 3))
    axis = rng.integers(0, 3, BOX_COUNT)
    sides[np.arange(BOX_COUNT), axis] = np.sign(sides[np.arange(BOX_COUNT), axis])
    box = sides * (0.5, 0.3, 0.75) + (0.1, 0.2, 0.75)
    count = round(BOX_COUNT / 6 * np.pi * reach**2)  # the box has 6 square units of skin
    angle, radius = rng.uniform(0, 2 * np.pi, count), reach * np.sqrt(rng.uniform(0, 1, count))
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.normal(0, 0.004, count)], 1)
    leg = np.stack([np.full(legs, 1.2), np.zeros(legs), rng.uniform(-1, 0, legs)], 1)
    return round_gaussians(rotation.apply(np.concatenate([box, disc, leg])) + np.array((3, -2, 5)))


@pytest.mark.parametrize(("reach", "legs"), [(1.1, 0), (1.6, 300), (8.0, 3000)])
def test_a_floor_is_found_within_a_degree_and_goes_with_what_is_under_it(reach: float, legs: int) -> None:
    rotation = Rotation.from_rotvec((1.1, 0.4, -0.7))
    scene = room(rotation, reach, legs)
    floor = find_floor(scene)
    assert floor is not None
    up = rotation.apply((0, 0, 1))
    assert math.degrees(math.acos(min(1.0, float(np.dot(floor.normal, up))))) < 1
    gone = removed(scene, ((Step("add", Detected("floor")),),))
    assert gone[BOX_COUNT:].mean() > 0.995
    above = ((scene.means.astype(np.float64) - (3, -2, 5)) @ up)[:BOX_COUNT] > 0.05
    assert not gone[:BOX_COUNT][above].any()


def test_an_object_without_a_floor_keeps_its_foot() -> None:
    box = room(Rotation.identity())[np.arange(BOX_COUNT)]
    ball = CLOUD.means / np.linalg.norm(CLOUD.means, axis=1, keepdims=True)
    rng = np.random.default_rng(5)
    around, height = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(0, 1.2, 6000)
    wall = np.stack([np.cos(around) * (1 + 0.2 * height), np.sin(around) * (1 + 0.2 * height), height], 1)
    inner = rng.uniform(-1, 1, (3000, 2))
    foot = np.c_[inner[(inner**2).sum(1) < 1], np.zeros(((inner**2).sum(1) < 1).sum())]
    for scene in (
        box,
        round_gaussians(ball),
        round_gaussians(np.concatenate([wall, foot])),
        CLOUD,
        CLOUD[np.arange(3)],
    ):
        assert find_floor(scene) is None


@pytest.mark.skipif(not SHARED.is_dir(), reason="the captures are not here")
@pytest.mark.parametrize(
    ("name", "has_floor"),
    [
        ("splats/tarot_box_capture.ply", True),
        ("splats/plant.splat", False),
        ("splats/guitar.compressed.ply", False),
        ("splats/donut_mipsplatting.ply", False),
        ("splats/meshgs_orange_30k.ply", False),
        ("formats/biker.compressed.ply", False),
    ],
)
def test_the_mat_of_a_real_capture_is_a_floor_and_a_pots_foot_is_none(name: str, has_floor: bool) -> None:
    floor = find_floor(load(SHARED / name).gaussians)
    assert (floor is not None) == has_floor
    assert floor is None or floor.normal[1] < -0.999


EVERYTHING: Isolation = (
    (Step("add", BOX), Step("subtract", SPHERE), Step("grow"), INVERT),
    (
        Step("add", Lasso(View((1, 2, 3), quat(TURN), (0.5, 0.25), True), ((-1, 0.1), (1 / 3, 0), (0, 1)))),
        Step("add", BELOW),
        Step("add", BodyAt((1.5, 0.0, -2.0))),
        *(Step("add", Detected(kind)) for kind in ("surroundings", "floor", "fragments", "haze")),
    ),
)


def test_every_isolation_survives_json() -> None:
    reader = Fields(Path("a.json"), "request")
    record = isolation_record(EVERYTHING)
    parsed = json.loads(json.dumps(record, allow_nan=False))
    assert parsed == record and read_isolation(reader, parsed) == EVERYTHING


BREAK: dict[str, Callable[[Any], object]] = {
    "operation": lambda r: r[0][0].update(operation="xor"),
    "no shape": lambda r: r[0][0].pop("shape"),
    "corners of a box": lambda r: r[0][0].update(low=[9, 9, 9]),
    "turn": lambda r: r[0][0].update(turn=[1, 1, 0, 0]),
    "radius": lambda r: r[0][1].update(radius=-1),
    "infinite": lambda r: r[0][1].update(radius=1e300),
    "corners of a lasso": lambda r: r[1][0].update(corners=[[0, 0], [1, 1]]),
    "half": lambda r: r[1][0].update(half=[0, 1]),
    "normal": lambda r: r[1][1].update(plane=[1, 1, 1, 0]),
    "point": lambda r: r[1][2].update(point=[1, 2]),
    "step": lambda r: r.append(["add"]),
    "selection": lambda r: r.append({}),
    "endless": lambda r: r.extend([[]] * 1001),
}


@pytest.mark.parametrize("name", BREAK)
def test_a_broken_isolation_is_refused_in_one_line(name: str) -> None:
    record = json.loads(json.dumps(isolation_record(EVERYTHING)))
    BREAK[name](record)
    with pytest.raises(InputError, match=r"^a\.json: not a request: "):
        read_isolation(Fields(Path("a.json"), "request"), record)
