"""A single picture: its own plane shows it, texture is as long in every cut, membranes run through, chambers end."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.inside import Inside
from engine.scene.plane import Plane
from tests.helpers.exemplar_faces import FLESH, RIND, SEED, UP, ball, quiet, save
from training.families import Family, Kind
from training.priors.exemplar import ExemplarPrior

InsideOf: TypeAlias = Callable[..., Inside]
SIZE = 360
SEEDS = ((0.5, 0.3), (-0.2, 0.55), (-0.6, -0.1), (0.1, -0.45), (0.45, -0.35))
"""Places of the seeds in the picture, in radii: never near the mirrored or turned place of another."""

LINES = np.radians([20, 95, 160, 230, 300])


def face(lines: bool) -> NDArray[np.float32]:
    """A disc as wide as the picture, on white: a rind, flesh with fine noise, seeds, and perhaps faint radial lines."""
    y, x = 1 - (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2
    x = -x
    r, angle = np.hypot(x, y) / 0.9, np.arctan2(y, x)
    noise = ndimage.gaussian_filter(np.random.default_rng(0).standard_normal((SIZE, SIZE)), 2)
    rgb = FLESH + 0.03 * (noise / noise.std())[..., None]
    if lines:
        for at in LINES:
            off = r * np.abs(np.sin(angle - at))
            rgb[(off < 0.015) & (np.cos(angle - at) > 0) & (r > 0.1)] += 0.08
    for at in SEEDS:
        rgb[np.hypot(x / 0.9 - at[0], y / 0.9 - at[1]) < 0.05] = SEED
    rgb[r > 0.9] = RIND
    return np.where((r < 1)[..., None], np.clip(rgb, 0, 1), 1).astype(np.float32)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> InsideOf:
    """Makes the inside of a ball from one such picture, once for each."""

    @cache
    def inside_of(kind: Kind, lines: bool = False) -> Inside:
        path = save(tmp_path_factory.mktemp("picture") / "face.png", face(lines))
        return solved(kind, path, 128 if lines else 80)  # faint lines are lost on few cells

    return inside_of


def solved(kind: Kind, picture: Path, cells: int = 80) -> Inside:
    """The inside of a ball from that picture."""
    inside = ExemplarPrior().solve(ball(48), UP, [Family(kind, 30, (picture,))], cells, 0, quiet).inside
    assert inside is not None
    return inside


def section(inside: Inside, right: tuple[float, ...], up: tuple[float, ...], off: tuple[float, ...]) -> NDArray:
    """(SIZE, SIZE, 3). A cut through the ball, in the frame of the picture."""
    v, u = (1 - (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2) / 0.9
    points = -u.reshape(-1, 1) * np.array(right) + v.reshape(-1, 1) * np.array(up) + np.array(off)
    return inside.at(points, 0.001).reshape(SIZE, SIZE, 3)


def within(radius: float) -> NDArray[np.bool_]:
    """(SIZE, SIZE). Pixels nearer to the middle than this, in radii of the ball."""
    v, u = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2 - 1
    return np.hypot(u, v) < 0.9 * radius


def coherence(rgb: NDArray[np.float32], where: NDArray[np.bool_]) -> float:
    """Coherence of the texture's direction (Bigun and Granlund 1987): 0 without one, 1 in lines."""
    grey = ndimage.gaussian_filter(rgb.mean(-1), 1.5)
    gy, gx = np.gradient(grey)
    xx, yy, xy = (ndimage.gaussian_filter(a, 8) for a in (gx * gx, gy * gy, gx * gy))
    return float((np.hypot(xx - yy, 2 * xy) / (xx + yy + 1e-9))[where].mean())


@pytest.mark.parametrize("kind", ["horizontal", "radial"])
def test_its_own_plane_shows_it(alone: InsideOf, kind: Kind) -> None:
    inside, true = alone(kind), face(False)
    up = (0.0, 1.0, 0.0) if kind == "horizontal" else (0.0, 0.0, 1.0)
    shown = section(inside, (1, 0, 0), up, (0, 0, 0))
    dark, wanted = (np.linalg.norm(a - SEED, axis=-1) < 0.3 for a in (shown, true))
    inner = within(0.85)
    assert (dark & wanted & inner).sum() > 0.7 * (dark & inner).sum() > 0
    assert (dark & wanted & inner).sum() > 0.7 * (wanted & inner).sum()
    calm = within(0.7) & ~ndimage.binary_dilation(dark | wanted, iterations=8)
    assert np.corrcoef(shown[calm].mean(-1), true[calm].mean(-1))[0, 1] > 0.7


@pytest.mark.parametrize("kind", ["horizontal", "radial"])
def test_texture_is_no_lines(alone: InsideOf, kind: Kind) -> None:
    """In no cut does texture run on farther than in the picture, and no cut repeats the picture's own plane."""
    inside, true = alone(kind), face(False)
    calm = within(0.55)
    known = coherence(true, calm)
    own = section(inside, (1, 0, 0), (0, 1, 0) if kind == "horizontal" else (0, 0, 1), (0, 0, 0))
    for right, up, off in (
        ((1, 0, 0), (0, 1, 0), (0, 0, 0.21)),
        ((0.8, 0.6, 0), (0, 0, 1), (0.12, -0.16, 0)),
        ((1, 0, 0), (0, 0.6, 0.8), (0, 0.16, -0.12)),
    ):
        cut = section(inside, right, up, off)
        assert coherence(cut, calm) < known + 0.15
        assert abs(np.corrcoef(cut[calm].mean(-1), own[calm].mean(-1))[0, 1]) < 0.3


def test_a_faint_membrane_runs_through(alone: InsideOf) -> None:
    """Radial lines in a horizontal picture, weaker than any seed, keep their places at other heights."""
    inside = alone("horizontal", True)
    angles = np.arange(360) / 180 * np.pi
    r = np.linspace(0.3, 0.7, 60)[:, None]
    lit = np.zeros(360)
    for at in LINES:
        lit[np.abs(np.angle(np.exp(1j * (angles - at)))) < np.radians(3)] = 1
    for height in (-0.4, 0.35):
        share = r * np.sqrt(1 - height**2)
        points = np.stack([share * np.cos(angles), share * np.sin(angles), np.full((60, 360), height)], -1)
        around = np.median(inside.at(points.reshape(-1, 3), 0.01).reshape(60, 360, 3).mean(-1), axis=0)
        assert np.corrcoef(ndimage.gaussian_filter1d(lit, 2, mode="wrap"), around)[0, 1] > 0.6


def test_chambers_end_and_a_core_runs_through(tmp_path: Path) -> None:
    """Five chambers around the axis are as tall as they are long, though they are joined there; a wide core on the axis
    is as tall as the body."""
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2 - 1
    r, angle = np.hypot(x, y) / 0.9, np.arctan2(y, x)
    bend = (angle + np.pi / 5) % (2 * np.pi / 5) - np.pi / 5
    star = ((r * np.cos(bend) - 0.19) / 0.16) ** 2 + (r * np.sin(bend) / 0.07) ** 2 < 1
    joined = ((r * np.cos(bend) - 0.17) / 0.18) ** 2 + (r * np.sin(bend) / 0.065) ** 2 < 1
    brown, pale = np.array([0.4, 0.25, 0.1]), np.array([0.95, 0.92, 0.8])
    for number, (dark, runs) in enumerate(((star, False), (joined, False), (r < 0.2, True))):
        rgb = np.where(dark[..., None], brown, np.where((r > 0.9)[..., None], RIND, pale))
        picture = save(tmp_path / f"{number}.png", np.where((r < 1)[..., None], rgb, 0.0))
        inside = solved("horizontal", picture)
        for height, share in ((0.0, 1.0), (0.03, 1.0), (0.3, float(runs)), (-0.3, float(runs))):
            cut = section(inside, (np.sqrt(1 - height**2), 0, 0), (0, np.sqrt(1 - height**2), 0), (0, 0, height))
            found = np.linalg.norm(cut - pale, axis=-1)[within(0.5)] > 0.4
            assert found.sum() == pytest.approx(share * dark.sum(), abs=(0.35 if share else 0.02) * dark.sum()), height


@pytest.mark.parametrize("kind", ["horizontal", "radial"])
def test_a_single_plane_may_be_of_a_kind_that_has_a_family(tmp_path: Path, kind: Kind) -> None:
    """Its picture is then one more of that family."""
    pictures = [save(tmp_path / f"{name}.png", face(lines)) for name, lines in (("one", False), ("two", True))]
    plane = Plane.of(UP if kind == "horizontal" else (0, 1, 0), 0.0)
    apart = [Family(kind, 30, (pictures[0],)), Family("custom", 1, (pictures[1],), custom=(plane,))]
    together = [Family(kind, 30, tuple(pictures))]
    one, other = (ExemplarPrior().solve(ball(24), UP, families, 32, 0, quiet).rgb for families in (apart, together))
    assert np.array_equal(one, other)
