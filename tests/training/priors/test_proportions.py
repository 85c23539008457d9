"""Pictures in bodies of other proportions and outlines: what they show keeps its order, its course and its grain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.scene.grid import Body, Grid
from tests.helpers.exemplar_faces import UP, disc, quiet, save
from training.families import Family, Kind
from training.priors.exemplar import ExemplarPrior, read_picture
from training.priors.exemplar.frames import make_space, upright_factor
from training.priors.exemplar.placement import bend_picture, find_own_plane
from training.priors.exemplar.quilting.disc import BallMap
from training.priors.exemplar.quilting.inside import QuiltInside
from training.priors.prior import Volume

CREAM, CRUMB = np.array([0.95, 0.9, 0.8]), np.array([0.4, 0.05, 0.1])
SLIM = np.array([0.6, 0.25, 1.0])
"""Half sizes of a box whose cuts across its longest level side are four times as high as wide."""


def box(half: NDArray[np.float64], n: int = 40) -> Body:
    """A box of these half sizes, the largest of which is 1."""
    cell = 2 / n
    shape = tuple(int(k) for k in np.round(half * n) + 8)
    grid = Grid(-np.array(shape) * cell / 2, cell, (shape[0], shape[1], shape[2]))
    return Body(grid, (half - np.abs(grid.centres())).min(-1).astype(np.float32))


def square(tower: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """A square cake of five layers with, on its top, a narrow tower of this height over the cake's; and its mask."""
    y, x = np.mgrid[:280, :240] / 100 + 0.005
    up, right = 1.75 - y, x - 1.2
    mask = (np.abs(right) < 1) & (np.abs(up) < 1)
    mask |= (np.abs(right) < 0.3) & (up > 0) & (up < 1 + 2 * tower)
    layer = np.clip(np.floor((up + 1) / 0.4), 0, 4)
    return np.where((layer % 2 == 0)[..., None], CRUMB, CREAM), mask


def grown(
    face: NDArray[np.float64], mask: NDArray[np.bool_], half: NDArray[np.float64], folder: Path, kind: Kind = "parallel"
) -> Volume:
    """The inside of a box from one slice across its longest level side, or through its axis."""
    picture = save(folder / "slice.png", np.where(mask[..., None], face, 1.0))
    return ExemplarPrior().solve(box(half), UP, [Family(kind, 8, (picture,))], 80, 0, quiet)


@pytest.mark.parametrize("kind", ["parallel", "radial"])
def test_layers_of_a_square_slice_are_level_in_a_slim_body(kind: Kind, tmp_path: Path) -> None:
    volume = grown(*square(), SLIM, tmp_path, kind)
    assert volume.inside is not None
    points = np.random.default_rng(0).uniform(-1, 1, (20_000, 3)) * (SLIM - 0.08)
    share = (points[:, 2] + 1) / 0.4
    clear = np.abs(share - np.round(share)) > 0.2
    cream = volume.inside.at(points, 0.0)[:, 1] > 0.45
    assert (cream == (np.floor(share) % 2 == 1))[clear].mean() > 0.98


def test_a_tower_on_a_slice_bends_only_what_lies_under_it(tmp_path: Path) -> None:
    volume = grown(*square(0.1), np.array([1.0, 0.5, 0.5]), tmp_path)
    assert volume.inside is not None
    at = np.linspace(-0.4, 0.4, 800)
    borders = []
    for across in (0.0, 0.2, -0.2, 0.3):  # under the tower, and beside it
        cream = volume.inside.at(np.stack([np.full(800, 0.3), np.full(800, across), at], -1), 0.0)[:, 1] > 0.45
        borders.append(at[1:][cream[1:] != cream[:-1]])
    assert [len(found) for found in borders] == [4] * 4
    assert np.ptp(np.array(borders), axis=0).max() < 0.01


def test_texture_keeps_its_proportions_in_a_slim_body(tmp_path: Path) -> None:
    mask = square()[1]
    grain = np.kron(np.random.default_rng(1).uniform(-0.25, 0.25, (70, 60)), np.ones((4, 4)))
    volume = grown(0.5 + 0.0 * CREAM + grain[..., None], mask, SLIM, tmp_path)
    assert volume.inside is not None
    step = 0.004
    along, right, high = [-0.3, 0.2, 0.4], np.arange(-0.15, 0.15, step), np.arange(-0.8, 0.8, step)
    at = np.stack(np.meshgrid(along, right, high, indexing="ij"))
    shown = volume.inside.at(at.reshape(3, -1).T, step)[:, 0].reshape(at.shape[1:])
    across, up = (float(np.square(np.diff(shown, axis=axis)).mean()) for axis in (1, 2))
    assert 0.7 < (across / up) ** 0.5 < 1.4


def test_deeper_than_a_rind_there_is_none(tmp_path: Path) -> None:
    """Where a body reaches farther than its picture, the picture's rim is not shown all the way in."""
    y, x = np.mgrid[:240, :240] / 100 - 1.195
    radius = np.hypot(x, y)
    face = np.where((radius > 0.9)[..., None], [0.1, 0.5, 0.1], [0.9, 0.3, 0.3])
    volume = grown(face, radius < 1, np.array([0.7, 0.7, 0.7]), tmp_path, "radial")
    assert volume.inside is not None
    points = np.random.default_rng(0).uniform(-0.54, 0.54, (20_000, 3))
    assert volume.inside.at(points, 0.0)[:, 0].min() > 0.8


@pytest.mark.parametrize(
    ("half", "kind"),
    [(SLIM, "parallel"), (np.array([1.0, 0.7, 0.7]), "parallel"), (SLIM, "radial")],
    ids=["slim", "square", "turned"],
)
def test_the_preview_shows_the_own_plane(half: NDArray[np.float64], kind: Kind, tmp_path: Path) -> None:
    volume = grown(*square(), half, tmp_path, kind)
    family = Family(kind, 8, (tmp_path / "slice.png",))
    plane = find_own_plane(box(half), UP, family, alone=True)
    bent = bend_picture(read_picture(family.exemplars[0], kind), plane) / 255
    left, down = plane.corners[1] - plane.corners[0], plane.corners[3] - plane.corners[0]
    rows, columns = np.nonzero(bent[..., 3] == 1)
    middle = (np.stack([columns, rows], -1) + 0.5) / len(bent)
    points = plane.corners[0] + middle[:, :1] * left + middle[:, 1:] * down
    assert volume.inside is not None
    deep = (half - np.abs(points)).min(1) > 0.06
    apart = np.abs(volume.inside.at(points[deep], 0.01) - bent[rows, columns, :3][deep]).mean()
    assert apart < 0.06


def ellipsoid(half: NDArray[np.float64], n: int = 40) -> Body:
    """An ellipsoid of these half axes, the largest of which is 1; its depth is right at the skin."""
    cell = 2 / n
    shape = tuple(int(k) for k in np.round(half * n) + 8)
    grid = Grid(-np.array(shape) * cell / 2, cell, (shape[0], shape[1], shape[2]))
    share = np.linalg.norm(grid.centres() / half, axis=-1)
    slope = np.linalg.norm(grid.centres() / half**2, axis=-1)
    return Body(grid, (share * (1 - share) / np.maximum(slope, 1e-3)).astype(np.float32))


def test_the_ball_of_a_long_body_is_its_affine_image() -> None:
    """Or what runs along its axis, a column in the ball, would be an hourglass in it."""
    half = np.array([0.35, 0.35, 1.0])
    space = make_space(ellipsoid(half, 80), UP, 128)
    up = upright_factor(space.axial_proportions, 1.0)
    assert up == pytest.approx(0.35, rel=0.05)
    points = space.points[space.depth > 0.05]
    image = BallMap.of(space, up=up).to_ball(space.planar[space.depth > 0.05])
    assert np.abs(image - points / half).max() < 0.08


def test_nearly_the_same_proportions_are_the_same() -> None:
    """Directions from the middle are kept then, as they are compared in photographs."""
    assert [upright_factor(ratio, 1.0) for ratio in (0.75, 1.0, 1.4)] == [1, 1, 1]
    factors = [upright_factor(ratio, 1.0) for ratio in np.linspace(1.4, 2.2, 30)]
    assert np.diff(factors).min() >= 0
    assert np.diff(factors).max() < 0.15
    assert upright_factor(2.0, 0.8) == pytest.approx(2.5)


def test_pictures_of_two_things_are_quilted_in_an_oval_body(tmp_path: Path) -> None:
    melon, _ = disc(seeds=8)
    other = np.where((melon == 1).all(-1, keepdims=True), melon, melon[..., [1, 0, 2]])
    pictures = save(tmp_path / "melon.png", melon), save(tmp_path / "other.png", other)
    families = [Family("horizontal", 8, pictures[:1]), Family("radial", 8, pictures[1:])]
    volume = ExemplarPrior().solve(ellipsoid(np.array([1.0, 0.7, 0.9]), 24), UP, families, 32, 0, quiet)
    assert isinstance(volume.inside, QuiltInside)
