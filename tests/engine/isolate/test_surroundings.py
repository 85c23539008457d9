"""The middle of a capture of a room or a garden: objects of known extent in synthetic surroundings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from engine.io.load import load
from engine.isolate.selection import NO_FLOOR, NO_SURROUNDINGS, Sphere, isolated, removed, without_surroundings
from engine.isolate.surroundings import _nearest_directions, directions_of_view, object_ball
from engine.scene.gaussians import Gaussians
from engine.solid.up_axis.detect import detect_up
from tests.helpers.solids import joined, round_gaussians
from tests.paths import SAMPLES, SHARED

TURN = Rotation.from_rotvec((0.4, 1.0, -0.3))
Points = NDArray[np.float64]
Draw = Callable[[np.random.Generator], list[Gaussians]]


def splats(points: Points, size: float | Points, opacity: float = 0.8) -> Gaussians:
    """Round Gaussians at points of the upright scene, of one `size` or one each, turned with the scene."""
    made = round_gaussians(TURN.apply(points), 1.0, opacity)
    return replace(made, scales=(made.scales * np.reshape(size, (-1, 1))).astype(np.float32))


def ball(rng: np.random.Generator) -> Points:
    """The skin of a ball of radius 1 on the ground z = 0."""
    directions = rng.normal(size=(6000, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True) + (0, 0, 1)


def guitar(rng: np.random.Generator) -> Points:
    """Half of the points a ball, half a neck four times as long, askew, on the ground."""
    along = rng.uniform(0, 4, 3000)
    neck = np.stack([0.8 + along, 0.2 * along, 1 + 0.2 * along], 1) + rng.normal(size=(3000, 3)) * 0.08
    return np.concatenate([ball(rng)[:3000], neck])


def ground(rng: np.random.Generator, reach: float, size: float = 0.12) -> Gaussians:
    """Ground from the middle to `reach`, coarser with distance."""
    angle, far = rng.uniform(0, 2 * np.pi, 6000), np.exp(rng.uniform(np.log(0.3), np.log(reach), 6000))
    points = np.stack([far * np.cos(angle), far * np.sin(angle), rng.normal(0, 0.01, 6000)], 1)
    return splats(points, size * far)


def walls(rng: np.random.Generator, half: float, sides: int = 6) -> Gaussians:
    """The first `sides` sides of a cube around the middle; its floor lies below the ground."""
    points = rng.uniform(-half, half, (1500 * sides, 3))
    axis, sign = np.arange(len(points)) % 3, np.where(np.arange(len(points)) % 6 < 3, 1.0, -1.0)
    keep = np.arange(len(points)) % 6 < sides
    points[np.arange(len(points)), axis] = sign * half
    return splats(points[keep], 0.06 * half)


def trees(rng: np.random.Generator) -> Gaussians:
    """Trees all around, up to as high as they are far away."""
    angle, far = rng.uniform(0, 2 * np.pi, 8000), 30 * np.exp(rng.normal(0, 0.3, 8000))
    height = far * rng.uniform(0, 1, 8000)
    return splats(np.stack([far * np.cos(angle), far * np.sin(angle), height], 1), 0.05 * far)


def sky(rng: np.random.Generator) -> Gaussians:
    directions = rng.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    far = np.exp(rng.uniform(np.log(100), np.log(800), 3000))
    return splats(directions * far[:, None], 0.05 * far)


def floaters(rng: np.random.Generator) -> Gaussians:
    return splats(rng.normal(size=(300, 3)) * 5, 0.1, 0.15)


SURROUNDED: dict[str, Draw] = {
    "a room": lambda rng: [ground(rng, 8), walls(rng, 12), floaters(rng)],
    "a room and a view": lambda rng: [ground(rng, 5), walls(rng, 20), sky(rng), floaters(rng)],
    "a garden": lambda rng: [ground(rng, 80), trees(rng), floaters(rng)],
    "the sky": lambda rng: [ground(rng, 80), sky(rng)],
}
OPEN: dict[str, Draw] = {
    "nothing": lambda rng: [],
    "a floor": lambda rng: [ground(rng, 40), floaters(rng)],
    "a floor and a wall": lambda rng: [ground(rng, 8), walls(rng, 6, 1)],
}


@pytest.mark.parametrize(
    ("shape", "around"),
    [(ball, "a room"), (guitar, "a room and a view"), (ball, "a garden"), (guitar, "a garden"), (ball, "the sky")],
)
def test_the_object_is_left_of_its_surroundings_whole(shape: Callable[..., Points], around: str) -> None:
    rng = np.random.default_rng(1)
    points = shape(rng)
    scene = joined(splats(points, 0.05), *SURROUNDED[around](rng))
    found = object_ball(scene)
    assert found is not None
    reach = np.linalg.norm(points - (points.min(0) + points.max(0)) / 2, axis=1).max()
    assert found[1] < 2.5 * reach
    gone = ~Sphere(*found).contains(scene.means)
    assert not gone[: len(points)].any()
    # What is left has a floor, and no further surroundings.
    assert object_ball(scene[~gone]) is None
    gone = removed(scene, (NO_SURROUNDINGS, NO_FLOOR))
    assert gone[: len(points)][points[:, 2] > 0.15].mean() < 0.02 and (~gone[len(points) :]).sum() < 0.05 * len(points)


@pytest.mark.parametrize(
    ("shape", "around"), [(ball, "nothing"), (guitar, "a floor"), (ball, "a floor"), (ball, "a floor and a wall")]
)
def test_a_floor_or_a_wall_alone_is_none(shape: Callable[..., Points], around: str) -> None:
    rng = np.random.default_rng(2)
    scene = joined(splats(shape(rng), 0.05), *OPEN[around](rng))
    assert object_ball(scene) is None
    left, notes = isolated(scene, (NO_SURROUNDINGS,), "a")
    assert left is scene and notes == ["it has no surroundings to leave out"]


def test_units_and_place_are_no_matter() -> None:
    rng = np.random.default_rng(3)
    scene = joined(splats(ball(rng), 0.05), *SURROUNDED["a room"](rng))
    one = object_ball(scene)
    moved = replace(scene, means=1000 * scene.means + np.float32(5000), scales=1000 * scene.scales)
    other = object_ball(moved)
    assert one is not None and other is not None
    assert other[1] == pytest.approx(1000 * one[1], rel=1e-3)
    np.testing.assert_allclose(other[0], 1000 * np.array(one[0]) + 5000, atol=5)


def test_captures_at_the_limit_have_none() -> None:
    plain = splats(ball(np.random.default_rng(4)), 0.05)
    broken = plain.means.copy()
    broken[:3] = np.nan, np.inf, 1e30
    for scene in (
        plain[:0],
        plain[:50],
        replace(plain, means=0 * plain.means),
        replace(plain, scales=0 * plain.scales),
        replace(plain, scales=np.float32(1e12) * plain.scales),
        replace(plain, opacities=np.float32(0.01) * plain.opacities),
        replace(plain, means=broken),
    ):
        assert object_ball(scene) is None


def test_up_is_told_by_the_object_and_its_floor() -> None:
    """Up is not decided by the walls and the view around them."""
    rng = np.random.default_rng(5)
    scene = joined(splats(guitar(rng), 0.05), *SURROUNDED["a room and a view"](rng))
    seen = without_surroundings(scene)
    assert len(seen) < len(scene)
    up = detect_up(seen, {}).axis
    assert np.degrees(np.arccos(up @ TURN.apply((0, 0, 1)))) < 3
    alone = scene[:6000]
    assert without_surroundings(alone) is alone


@pytest.mark.parametrize("name", ["watermelon", "orange", "bread"])
def test_samples_have_none(name: str) -> None:
    assert object_ball(load(SAMPLES / name / f"{name}.ply").gaussians) is None


@pytest.mark.skipif(not SHARED.is_dir(), reason="the captures are not here")
def test_captures_of_things_alone_have_none() -> None:
    for path in (*sorted(SHARED.glob("splats/*")), SHARED / "formats/biker.compressed.ply"):
        assert object_ball(load(path).gaussians) is None, path


def test_the_nearest_direction_is_the_one_of_a_tree() -> None:
    directions = directions_of_view()
    points = np.random.default_rng(5).normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = np.concatenate([points, directions, np.eye(3), -np.eye(3)])
    nearest = np.empty(len(points), np.int64)
    _nearest_directions(0, len(points), points, directions, nearest)
    assert np.array_equal(nearest, cKDTree(directions).query(points)[1])
