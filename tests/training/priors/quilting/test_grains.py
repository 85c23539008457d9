"""Grains of a face as balls: against drawn discs of known size, and the closed forms of stereology."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tests.helpers.exemplar_faces import UP, ball, photograph, save
from training.families import Family, Kind
from training.priors.exemplar import ExemplarPrior
from training.priors.exemplar.quilting import quilt
from training.priors.exemplar.quilting.disc import Disc, disc_grid
from training.priors.exemplar.quilting.inside import QuiltInside
from training.priors.exemplar.quilting.labels import made_of_grains
from training.priors.exemplar.quilting.things.candidates import SECTION, Candidates, strewn
from training.priors.exemplar.quilting.things.grains import Grains
from training.priors.exemplar.quilting.things.packing import NEAR, Packing, pack
from training.priors.exemplar.quilting.things.stamps import Things

PALE, DARK = np.array([0.9, 0.7, 0.6], np.float32), np.array([0.5, 0.1, 0.1], np.float32)
NEVER = np.full((*disc_grid()[0].shape, 1), 2.0, np.float32)


def laid_out(spacing: float) -> NDArray[np.float64]:
    """(B, 2). A triangular lattice in the disc."""
    steps = np.arange(-30, 31)
    i, j = (a.ravel() for a in np.meshgrid(steps, steps))
    places = spacing * np.stack([i + j / 2, j * np.sqrt(0.75)], -1)
    return places[np.hypot(*places.T) < 0.97]


def drawn(places: NDArray[np.float64], radius: float) -> Disc:
    """Dark discs on pale ground, shaded like round things: darkest in the middle."""
    x, y = disc_grid()
    away = cKDTree(places).query(np.stack([x, y], -1))[0]
    dark = np.clip(1 - np.square(away / radius), 0, 1)[..., None]
    return Disc((PALE + np.sqrt(dark) * (DARK - PALE)).astype(np.float32))


@pytest.mark.parametrize("radius", [0.04, 0.06])
def test_drawn_grains_are_found_where_and_as_large_as_they_are(radius: float) -> None:
    """Found smaller than drawn, as a round thing is faint at its rim."""
    places = laid_out(2.1 * radius)
    grains = Grains.of(drawn(places, radius), NEVER)
    wanted = places[np.hypot(*places.T) < 0.8]
    away = np.array([np.hypot(*(grains.places - place).T).min() for place in wanted])
    assert (away < 0.01).mean() > 0.9
    assert 0.6 * radius < np.median(grains.radii) < radius
    assert len(grains.radii) < len(places)


def test_few_things_on_calm_ground_are_no_grains() -> None:
    """Scattered seeds and a plain face: none of them is packed anew."""
    assert not len(Grains.of(drawn(laid_out(0.3), 0.04), NEVER).radii)
    assert not len(Grains.of(Disc(np.broadcast_to(PALE, (*NEVER.shape[:2], 3)).copy()), NEVER).radii)


def packed(radius: float, seed: int = 0) -> Packing:
    """The packing of a radial picture full of grains, wherever they fit."""
    disc = drawn(laid_out(2.1 * radius), radius)
    things, rng = [Grains.of(disc, NEVER).things(disc)], np.random.default_rng(seed)
    made = pack(things, [], strewn(things, 0, rng), lambda tried: np.ones(len(tried.stamps), bool), rng)
    assert made is not None
    return made


def test_balls_are_cut_as_large_as_the_picture_shows_grains() -> None:
    """The mean radius of a ball's cuts by random planes is pi/4 of its own."""
    laid = packed(0.05).laid
    rng = np.random.default_rng(0)
    distance = rng.uniform(-0.5, 0.5, (200, 1))
    normal = rng.standard_normal((200, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off = np.abs(normal @ laid.middles.T - distance)
    cut = off < laid.radii
    sections = np.sqrt(np.square(laid.radii) - off**2, where=cut, out=np.zeros_like(off))
    shown = Grains.of(drawn(laid_out(0.105), 0.05), NEVER).radii
    assert sections[cut].mean() == pytest.approx(shown.mean(), rel=0.05)


def test_balls_lie_apart_and_fill_what_they_may() -> None:
    made = packed(0.05)
    middles, radii = made.laid.middles, made.laid.radii
    for n in range(0, len(radii), 50):
        away = np.linalg.norm(middles - middles[n], axis=1)
        away[n] = np.inf
        assert (away >= NEAR[1] * (radii + radii[n]) - 1e-5).all()
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (20_000, 3)).astype(np.float32)
    _, cover = made.read(points)
    assert cover.mean() > 0.7


def test_a_ball_shows_a_grain_from_its_middle_to_its_rim() -> None:
    """Cut by any plane, it is as dark in every direction as the grain is at that distance."""
    radius = 0.05
    picture, axes = drawn(np.zeros((1, 2)), radius), np.full((1, 2), radius)
    things = Things.of(picture, np.zeros((1, 2)), axes, np.zeros(1))
    frame = np.eye(3, dtype=np.float32)
    one = Candidates(
        frame[:1] * 0, np.asarray(SECTION * axes, np.float32), frame[:1], frame[1:2], np.zeros(1, int), np.ones(1, bool)
    )
    made = pack([things], [one], one.chosen(np.zeros(0, int)), lambda tried: tried.are_close, np.random.default_rng(0))
    assert made is not None
    direction = np.random.default_rng(2).standard_normal((500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for share in (0.3, 0.6):
        shown, cover = made.read((share * SECTION * radius * direction).astype(np.float32))
        assert cover.min() == 1
        wanted = PALE + np.sqrt(1 - share**2) * (DARK - PALE)
        # Except on the line across the picture's plane, which has the colour of the grain's middle.
        assert np.quantile(np.abs(shown - wanted).max(1), 0.95) < 0.06


@pytest.mark.parametrize(
    ("name", "made_of_them"),
    [("pomegranate_h1", True), ("pomegranate_v4", True), ("orange_v4", False), ("watermelon_h8", False)],
)
def test_of_photographs_pomegranates_are_made_of_grains(name: str, made_of_them: bool) -> None:
    assert made_of_grains(photograph(name), "_h" in name) == made_of_them


@pytest.mark.parametrize("kind", ["horizontal", "radial"])
def test_grains_of_one_picture_alone_are_as_tall_as_wide(
    kind: Kind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No rods, rings or streaks: dark places extend as far across the picture's plane as in it."""
    monkeypatch.setattr(quilt, "LEVELS", (16, 32))
    rgb = drawn(laid_out(0.15), 0.07).rgb[..., ::-1, :].swapaxes(0, 1)
    x, y = disc_grid()
    path = save(tmp_path / "grains.png", np.where((np.hypot(x, y) < 1)[..., None], rgb, 1))
    volume = ExemplarPrior().solve(ball(32), UP, [Family(kind, 40, (path,))], 112, 0, lambda part: None)
    assert isinstance(volume.inside, QuiltInside)
    starts = np.random.default_rng(0).uniform(-0.45, 0.45, (500, 3))
    lengths = []
    for direction in np.eye(3):
        line = starts[:, None] + np.arange(-20, 20)[:, None] * 0.01 * direction
        dark = volume.at(line)[..., 1] < 0.22  # only the middles of grains, as their rims touch
        lengths.append(dark.sum() / (dark[:, 0].sum() + (dark[:, 1:] > dark[:, :-1]).sum()))
    assert max(lengths) < 1.2 * min(lengths)  # 1.10 and 1.12; if layers continued, 1.12 and 1.32
