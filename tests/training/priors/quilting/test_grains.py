"""Grains of a face as balls: against drawn discs of known size, and the closed forms of stereology."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tests.helpers.exemplar_faces import UP, ball, photograph, save
from training.families import Family, Kind
from training.priors.exemplar import ExemplarPrior
from training.priors.exemplar.quilting import quilt
from training.priors.exemplar.quilting.chunks import Ball, OwnAzimuths, OwnHeight
from training.priors.exemplar.quilting.disc import Disc, disc_grid, match_light
from training.priors.exemplar.quilting.films import Beside
from training.priors.exemplar.quilting.inside import QuiltInside
from training.priors.exemplar.quilting.labels import Label, Source, grains_of, made_of_grains
from training.priors.exemplar.quilting.relief import BLEND
from training.priors.exemplar.quilting.things.candidates import in_own_planes, strewn
from training.priors.exemplar.quilting.things.chambers import BESIDE, HALF, NODES, Chambers, room_beside
from training.priors.exemplar.quilting.things.grains import Grains
from training.priors.exemplar.quilting.things.stamps import Things
from training.priors.exemplar.quilting.things.tessellation import BULGE, NEAR, REACHES, TIMES, Tessellation, off_plane

PALE, RED, GAP = (np.array(a, np.float32) for a in ([0.9, 0.75, 0.65], [0.75, 0.15, 0.15], [0.2, 0.0, 0.05]))
SKIN = np.array([0.45, 0.25, 0.15], np.float32)
NEVER = np.full((*disc_grid()[0].shape, 1), 2.0, np.float32)


def laid_out(spacing: float) -> NDArray[np.float64]:
    """(B, 2). A triangular lattice in the disc."""
    steps = np.arange(-30, 31)
    i, j = (a.ravel() for a in np.meshgrid(steps, steps))
    places = spacing * np.stack([i + j / 2, j * np.sqrt(0.75)], -1)
    return places[np.hypot(*places.T) < 0.9]


def drawn(places: NDArray[np.float64], radius: float) -> Disc:
    """Red grains with dark rims that touch one another, in pale ground under a brown skin."""
    x, y = disc_grid()
    away = cKDTree(places).query(np.stack([x, y], -1))[0]
    ground = np.clip((away - 1.2 * radius) / 0.01, 0, 1)[..., None]
    rgb = shade(away / radius) + ground * (PALE - shade(away / radius))
    return Disc(np.where((np.hypot(x, y) > 0.95)[..., None], SKIN, rgb).astype(np.float32))


def shade(share: NDArray[np.floating]) -> NDArray[np.floating]:
    """(..., 3). Colours of a grain at shares of its radius."""
    return GAP + np.clip(1.2 - share[..., None], 0, 1) * (RED - GAP)


def shares_of(spacing: float) -> Disc:
    """How far each place is on the way from the middle of its grain to the border, in the first channel."""
    x, y = disc_grid()
    places = laid_out(spacing)
    nearest = cKDTree(places).query(np.stack([x, y], -1))[1]
    off = np.stack([x, y], -1) - places[nearest]
    turns = np.arange(6) * np.pi / 3
    share = (off @ np.stack([np.cos(turns), np.sin(turns)])).max(-1) / (spacing / 2)
    return Disc(np.stack([share, *[np.zeros_like(share)] * 2], -1).astype(np.float32))


ROOMY = Chambers(np.full((NODES,) * 3, 1.0, np.float32))
"""One chamber without walls."""


@pytest.mark.parametrize("spacing", [0.084, 0.126])
def test_drawn_grains_are_found_where_and_as_large_as_they_are(spacing: float) -> None:
    places = laid_out(spacing)
    grains = Grains.of(drawn(places, spacing / 2.1), NEVER)
    wanted = places[np.hypot(*places.T) < 0.7]
    away = np.array([np.hypot(*(grains.places - place).T).min() for place in wanted])
    assert (away < 0.01).mean() > 0.95
    assert len(grains.radii) == pytest.approx(len(places), rel=0.03)
    area = spacing**2 * np.sqrt(0.75)
    assert np.median(grains.radii) == pytest.approx(np.sqrt(area / np.pi), rel=0.03)
    assert grains.are_usual.mean() > 0.95


def test_few_things_on_calm_ground_are_no_grains() -> None:
    """Scattered seeds and a plain face: none of them is laid anew."""
    for disc in (drawn(laid_out(0.3), 0.04), Disc(np.broadcast_to(PALE, (*NEVER.shape[:2], 3)).copy())):
        assert not made_of_grains(disc, True) and not made_of_grains(disc, False)


@cache
def filled(spacing: float = 0.105, seed: int = 0) -> Tessellation:
    """The grains of a radial picture full of them, wherever they fit."""
    grains, rng = Grains.of(drawn(laid_out(spacing), spacing / 2.1), NEVER), np.random.default_rng(seed)
    things = [grains.things(shares_of(spacing))]
    return Tessellation.of(things, [], strewn(things, 0, TIMES, rng, in_rows=False), ROOMY, no_planes, rng)


def no_planes(points: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.full(len(points), BESIDE, np.float32)


def powers(made: Tessellation, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """(M, B). Powers of all grains at points (M, 3)."""
    middles, radii = made.laid.middles.astype(np.float64), made.laid.radii.astype(np.float64)
    own = radii**2 - np.square(middles).sum(-1)
    return np.asarray(2 * points @ middles.T + own - np.square(points).sum(-1, keepdims=True))


def test_cuts_show_as_many_grains_as_the_picture() -> None:
    made, step = filled(), 0.004
    radii = made.laid.radii.astype(np.float64)
    # The grain with the most power is the nearest one if each is lifted by what it lacks of the largest radius.
    lifted = cKDTree(np.column_stack([made.laid.middles, np.sqrt(radii.max() ** 2 - radii**2)]))
    at = np.arange(-0.5, 0.5, step)
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    counts = []
    for height in (-0.4, -0.1, 0.2, 0.5):
        shown = lifted.query(np.stack([x, y, np.full_like(x, height), np.zeros_like(x)], -1))[1].reshape(len(at), -1)
        counts.append(
            len(np.unique(shown)) - len(np.unique(np.concatenate([shown[0], shown[-1], *shown[:, [0, -1]].T]))) / 2
        )
    assert np.mean(counts) == pytest.approx(1 / (0.105**2 * np.sqrt(0.75)), rel=0.15)


def test_grains_lie_apart_and_fill_their_chamber() -> None:
    made = filled()
    middles, radii = made.laid.middles, made.laid.radii
    for n in range(0, len(radii), 50):
        away = np.linalg.norm(middles - middles[n], axis=1)
        away[n] = np.inf
        assert (away >= NEAR * (radii + radii[n]) - 1e-5).all()
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (20_000, 3)).astype(np.float32)
    assert made.read(points, np.ones(len(points), np.float32), no_planes(points))[1].mean() > 0.95
    assert made.read(points, np.zeros(len(points), np.float32), no_planes(points))[1].max() == 0


def test_a_grain_shows_its_middle_in_its_middle_and_its_rim_at_its_border() -> None:
    """Against borders found step by step, by the powers of all grains."""
    made, shares = filled(), np.linspace(0, 1, 200)
    rng = np.random.default_rng(2)
    inner = np.flatnonzero(np.linalg.norm(made.laid.middles, axis=1) < 0.5)
    for grain in rng.choice(inner, 30):
        direction = rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        middle, most = made.laid.middles[grain], REACHES * made.laid.radii[grain]
        ray = middle + most * shares[:, None] * direction
        ours = powers(made, ray).argmax(1) == grain
        assert ours[0]
        border = shares[ours.argmin()] if not ours.all() else 1.0
        part = np.array([0.15, 0.5, 0.85])
        points = (ray[0] + most * border * part[:, None] * direction).astype(np.float32)
        shown, cover = made.read(points, np.ones(3, np.float32), no_planes(points))
        assert cover.min() == 1
        # The picture is as red at each place as that is far from the middle of its cell.
        assert np.abs(shown[:, 0] - part).max() < 0.12


def test_own_grains_are_cut_by_their_plane_as_their_picture_shows_them() -> None:
    rng = np.random.default_rng(3)
    places, radii = rng.uniform(-0.6, 0.6, (60, 2)), rng.uniform(0.05, 0.1, 60)
    things = Things.of_cells(shares_of(0.105), places, radii, np.zeros(60), np.zeros(NEVER.shape[:2], np.int32))
    placed = in_own_planes([things], [], 0)[0]  # the plane y = 0
    moved = placed._replace(laid=off_plane(placed, rng))
    assert np.abs(moved.laid.middles[:, 1]).max() > 0.03
    made = [
        Tessellation.of([things], [some.laid], placed.laid.chosen(np.zeros(0, int)), ROOMY, no_planes, rng)
        for some in (placed, moved)
    ]
    x, y = rng.uniform(-0.6, 0.6, (2, 3_000))
    points = np.stack([x, np.zeros_like(x), y], -1)
    assert (powers(made[0], points).argmax(1) == powers(made[1], points).argmax(1)).all()
    assert np.abs(powers(made[0], points) - powers(made[1], points)).max() < 1e-5


def one_grain(where: NDArray[np.bool_]) -> Grains:
    """A grain at these pixels (P, P)."""
    return replace(Grains.none(), cells=where.astype(np.int32), radii=np.ones(1, np.float32))


def test_chambers_are_where_both_pictures_have_grains() -> None:
    """A horizontal picture with grains on one side, a radial one with grains in its upper half."""
    x, y = disc_grid()
    halves = [Source.of(Disc(np.full((*x.shape, 3), 0.5, np.float32)), h) for h in (True, False)]
    across, along = (
        replace(source, grains=one_grain(where & (np.hypot(x, y) < 0.9)))
        for source, where in zip(halves, (x > 0.1, y > 0.1), strict=True)
    )
    made = Chambers.of([across], [along], 0.0, Ball.of, np.random.default_rng(0))
    points = np.random.default_rng(1).uniform(-0.7, 0.7, (2_000, 3)).astype(np.float32)
    points = points[(np.linalg.norm(points, axis=1) < 0.8) & (np.hypot(points[:, 0], points[:, 1]) > 0.25)]
    wanted = np.minimum(points[:, 0], points[:, 2]) - 0.1
    near = np.abs(wanted) < 0.12 + 3 * np.minimum(np.abs(points[:, 2]), 0.3) * np.abs(points[:, 1])  # walls wander
    assert ((made.at(points) > 0) == (wanted > 0))[~near].mean() > 0.98
    alone = Chambers.of([halves[0]], [along], 0.0, Ball.of, np.random.default_rng(0))
    upper = np.abs(points[:, 2] - 0.1) > 0.1
    assert ((alone.at(points) > 0) == (points[:, 2] > 0.1))[upper].mean() > 0.98  # one of them is of something else
    low = points[np.abs(points[:, 2]) < 0.05]
    assert (made.at(low) < 0.05).all()  # the radial picture has its wall here


def test_no_grain_reaches_far_through_a_wall() -> None:
    rng = np.random.default_rng(4)
    axis = np.linspace(-HALF, HALF, NODES, dtype=np.float32)
    walled = Chambers(np.broadcast_to(axis[:, None, None], (NODES,) * 3).copy())  # the chamber x > 0
    things = [Grains.of(drawn(laid_out(0.105), 0.05), NEVER).things(shares_of(0.105))]
    made = Tessellation.of(things, [], strewn(things, 0, TIMES, rng, in_rows=False), walled, no_planes, rng)
    points = rng.uniform(-0.5, 0.5, (20_000, 3)).astype(np.float32)
    cover = made.read(points, np.ones(len(points), np.float32), no_planes(points))[1]
    assert cover[points[:, 0] < -BULGE * made.laid.radii.max()].max() == 0
    assert cover[points[:, 0] > 0.05].mean() > 0.95


def test_own_grains_end_where_own_planes_show_walls() -> None:
    """They are as they were far from these, and gone in them."""
    rng = np.random.default_rng(5)
    places, radii = rng.uniform(-0.6, 0.6, (400, 2)), np.full(400, 0.08)
    things = Things.of_cells(shares_of(0.105), places, radii, np.zeros(400), np.zeros(NEVER.shape[:2], np.int32))
    placed = in_own_planes([things], [], 0)[0]  # the plane y = 0

    def beside(points: NDArray[np.floating]) -> NDArray[np.float32]:
        return np.minimum(np.abs(points[:, 2]) - 0.1, BESIDE).astype(np.float32)

    made = Tessellation.of([things], [placed.laid], placed.laid.chosen(np.zeros(0, int)), ROOMY, beside, rng)
    points = np.zeros((3_000, 3), np.float32)
    points[:, [0, 2]] = rng.uniform(-0.5, 0.5, (3_000, 2))
    room = beside(points)
    cover = made.read(points, np.ones(len(points), np.float32), room)[1]
    alone = made.read(points, np.ones(len(points), np.float32), no_planes(points))[1]
    assert alone.mean() > 0.9
    assert cover[room < 0].max() == 0
    assert (cover == alone)[room > BLEND].all()


def test_a_wall_becomes_narrower_as_fast_as_its_plane_is_left() -> None:
    """A horizontal picture with grains on one side, at a height, in planes of a radial one that has none."""
    x = disc_grid()[0]
    halves = [Source.of(Disc(np.full((*x.shape, 3), 0.5, np.float32)), h) for h in (True, False)]
    across = replace(halves[0], grains=one_grain(x > 0.1))
    rng = np.random.default_rng(0)
    chunks = OwnHeight(0.2, across.membranes, rng), OwnAzimuths(1, rng)
    labels = [Label(chunks[0], [across], True, True), Label(chunks[1], halves[1:], False, True)]
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (2_000, 3)).astype(np.float32)
    room = room_beside(labels, points, Beside.of(labels, points), Ball.of)
    away, depth = np.abs(points[:, 2] - 0.2), chunks[0].places(Ball.of(points)).x - 0.1
    near = (np.abs(depth) < 0.15) & (away < BESIDE)
    assert np.abs(room - np.minimum(depth + away, BESIDE))[near].max() < 0.02


def test_grains_are_brought_to_the_light_of_grains_and_ground_to_that_of_ground() -> None:
    """One picture has few grains, the other many: medians at the same depth would make one of the other."""
    x, y = disc_grid()
    few, many = np.abs(x) < 0.3, np.hypot(x, y) < 0.85
    light = np.array([0.9, 1.0, 1.1], np.float32)
    one, other = (Disc(np.where(w[..., None], RED, PALE * 0.9).astype(np.float32)) for w in (few, many))
    made = match_light(Disc(one.rgb * light), other, [few, many]).rgb
    face = np.hypot(x, y) < 0.95
    assert np.abs(made - one.rgb)[face].max() < 0.02
    made = match_light(Disc(one.rgb * light), other).rgb
    assert np.abs(made - one.rgb)[face].max() > 0.2


@pytest.mark.parametrize(
    ("name", "made_of_them"),
    [("pomegranate_h1", True), ("pomegranate_v4", True), ("orange_v4", False), ("watermelon_h8", False)],
)
def test_of_photographs_pomegranates_are_made_of_grains(name: str, made_of_them: bool) -> None:
    assert made_of_grains(photograph(name), "_h" in name) == made_of_them


@pytest.mark.parametrize("name", ["pomegranate_h3", "pomegranate_v5"])
def test_chambers_are_the_same_in_another_light(name: str) -> None:
    is_horizontal, disc = "_h" in name, photograph(name)
    known = grains_of(disc, is_horizontal).regions
    for rgb in (0.6 * disc.rgb, 0.5 * disc.rgb + 0.2, disc.rgb * np.array([0.8, 1.0, 1.15], np.float32)):
        found = grains_of(Disc(np.clip(rgb, 0, 1).astype(np.float32)), is_horizontal).regions
        assert (found & known).sum() > 0.85 * (found | known).sum()


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
