"""Wood: all of it runs along the axis, from one picture or from two of different logs, and its rings are no grains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tests.helpers.exemplar_faces import UP, ball, picture_of, quiet, save
from training.families import Family
from training.priors.exemplar import ExemplarPrior
from training.priors.exemplar.layering.inside import LayeredInside
from training.priors.exemplar.pictures import Picture
from training.priors.exemplar.quilting.agreement import runs_upwards
from training.priors.exemplar.quilting.disc import Disc, disc_grid
from training.priors.exemplar.quilting.labels import made_of_grains

PALE, LATE, BARK = np.array([0.85, 0.68, 0.45]), np.array([0.6, 0.4, 0.22]), np.array([0.3, 0.2, 0.12])
SIZE = 300


def log(x: NDArray[np.floating], y: NDArray[np.floating], z: NDArray[np.floating], number: int) -> NDArray[np.float32]:
    """(..., 3). The wood of one log at places (...) in the unit ball, the axis along z: mottled rings with a sharp
    edge, neither round nor quite upright, in bark."""
    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    ring = (radius + 0.03 * np.sin(2 * angle + number) + 0.02 * np.sin(3 * z + number)) * (11 + number)
    rgb = PALE + ((ring % 1) ** 3)[..., None] * (LATE - PALE)
    mottles = np.sin(31 * x + number) * np.sin(29 * y) * np.cos(5 * z)
    rgb = rgb + 0.03 * mottles[..., None]
    return np.where((np.sqrt(x * x + y * y + z * z) > 0.93)[..., None], BARK, rgb).astype(np.float32)


def on_white(u: NDArray[np.floating], v: NDArray[np.floating], rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """A face on white."""
    return np.where((np.hypot(u, v) < 1)[..., None], np.clip(rgb, 0, 1), 0.97).astype(np.float32)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Pictures of two logs, one cut across and one along."""
    folder = tmp_path_factory.mktemp("logs")
    v, u = (1 - (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2) * 1.1
    across, along = on_white(u, v, log(u, v, 0 * u, 0)), on_white(u, v, log(u, 0 * u, v, 3))
    return save(folder / "across.png", across), save(folder / "along.png", along)


def test_rings_are_no_grains() -> None:
    """Each has dark and bright pieces close together all over, but none that ends along the ring."""
    x, y = disc_grid()
    for number in range(3):
        assert not made_of_grains(Disc(log(x, y, 0 * x, number)), True)


def plank(waves: float, lean: float, knots: bool) -> Picture:
    """A log cut along, with grain that waves by so many pixels and leans by so many degrees."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[:400, :300]
    moved = ndimage.gaussian_filter(rng.standard_normal(row.shape), (60, 25))
    off = column - 150 + waves * moved / moved.std() + np.tan(np.radians(lean)) * (row - 200)
    ends = np.cumsum(rng.uniform(5, 22, 60))
    n = np.searchsorted(ends, np.abs(off))
    ring = (np.abs(off) - np.append(0, ends)[n]) / (ends[n] - np.append(0, ends)[n])
    grey = 0.75 - 0.25 * ring**3 + 0.02 * rng.standard_normal(row.shape)
    if knots:
        away = np.hypot((column - 90) / 12, (row - 200) / 20)
        grey = np.where(away < 2, 0.45 + 0.1 * np.sin(6 * away), grey)
    return Picture(Path("plank.png"), (grey[..., None] * PALE).astype(np.float32), np.pad(np.ones((398, 298), bool), 1))


@pytest.mark.parametrize(("waves", "lean", "knots"), [(3, 0, False), (12, 4, True), (20, 6, True)])
def test_wood_runs_upwards(waves: float, lean: float, knots: bool) -> None:
    assert runs_upwards(plank(waves, lean, knots))


def test_a_sliver_tells_nothing() -> None:
    mask = np.pad(np.ones((400, 10), bool), 1)
    assert not runs_upwards(Picture(Path("sliver.png"), np.full((*mask.shape, 3), 0.5, np.float32), mask))


@pytest.mark.parametrize("name", ["apple_v1", "apple_v2", "orange_v3", "watermelon_v1", "pomegranate_v5"])
def test_fruit_does_not_whatever_its_core_does(name: str) -> None:
    assert not runs_upwards(picture_of(name))


def test_two_logs_make_one(logs: tuple[Path, Path]) -> None:
    """Rings go on along the axis in planes that no picture shows, and are rings in level ones, those of the picture
    across it; one is told so."""
    families = [Family("horizontal", 40, logs[:1]), Family("radial", 30, logs[1:])]
    volume = ExemplarPrior().solve(ball(48), UP, families, 80, 0, quiet)
    inside = volume.inside
    assert isinstance(inside, LayeredInside)
    assert any(str(logs[1]) in note and "runs along the axis" in note for note in volume.notes)
    alone = ExemplarPrior().solve(ball(48), UP, families[:1], 80, 0, quiet)
    assert np.array_equal(volume.rgb, alone.rgb)
    v, u = 0.6 * ((np.mgrid[:200, :200] + 0.5) / 100 - 1)
    turn = np.radians(50)
    upright = np.stack([u * np.cos(turn), u * np.sin(turn), v], -1)
    level = np.stack([u, v, np.full_like(u, 0.3)], -1)

    def slopes(at: NDArray[np.floating]) -> list[NDArray[np.floating]]:
        shown = ndimage.gaussian_filter(inside.at(at.reshape(-1, 3), 0.005).reshape(*u.shape, 3), (1, 1, 0))
        return list(np.gradient(shown.mean(-1)))

    along, across = slopes(upright)
    assert np.square(along).sum() < 0.2 * np.square(across).sum()
    down, right = slopes(level)
    radius = np.maximum(np.hypot(u, v), 0.01)
    outwards, around = (u * right + v * down) / radius, (u * down - v * right) / radius
    assert np.square(around).sum() < 0.35 * np.square(outwards).sum()
