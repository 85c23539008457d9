"""Insides from photographs of different individuals: their laws, on our own solids and on photographs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.grid import Body, Grid
from tests.helpers.exemplar_faces import UP, ball, photograph, save
from tests.paths import SAMPLES
from training.families import Family, Kind
from training.priors.exemplar import ExemplarPrior, read_picture
from training.priors.exemplar.frames import make_space
from training.priors.exemplar.quilting import quilt
from training.priors.exemplar.quilting.agreement import disagreement, show_one_thing
from training.priors.exemplar.quilting.disc import (
    DISC_PIXELS,
    PIXEL,
    BallMap,
    Disc,
    disc_grid,
    even_around,
    even_sides,
    match_light,
)
from training.priors.exemplar.quilting.inside import QuiltInside
from training.priors.exemplar.quilting.labels import Label, grains_of
from training.priors.exemplar.quilting.persistence import find_membranes
from training.priors.exemplar.quilting.quilt import Quilt, make_quilt
from training.priors.exemplar.quilting.texture import FINE, take_apart

FLESH, MEMBRANE, SEED = np.array([0.9, 0.5, 0.2]), np.array([1.0, 0.9, 0.7]), np.array([0.15, 0.1, 0.05])
PAIRS = [("apple_h1", "apple_v1"), ("pomegranate_h1", "pomegranate_v4")]


@pytest.fixture(autouse=True)
def _coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Computes seams on few cells: colours are still read at every point."""
    monkeypatch.setattr(quilt, "LEVELS", (16, 32))


def quilted(*pictures: Disc, seed: int = 0) -> Quilt:
    """The quilt of horizontal pictures and, last, a radial one."""
    return make_quilt(pictures[:-1], pictures[-1:], seed, lambda part: None)


@cache
def quilt_of(pair: tuple[str, str]) -> Quilt:
    """The quilt of two photographs, with the seams of `_coarse`: use it only where that fixture applies."""
    return quilted(*map(photograph, pair))


def segmented(seeds: bool, light: float = 1.0) -> Disc:
    """A face with nine membranes from core to rind and, between the membranes, seeds."""
    x, y = disc_grid()
    radius, angle = np.hypot(x, y), np.arctan2(y, x) * 9 / (2 * np.pi)
    rgb = np.broadcast_to(FLESH, (*x.shape, 3)).copy()
    off = np.abs(angle - np.round(angle)) * 2 * np.pi / 9 * radius
    rgb[(off < 0.02) & (radius < 0.92)] = MEMBRANE
    between = np.abs(angle - np.floor(angle) - 0.5) * 2 * np.pi / 9 * radius
    if seeds:
        rgb[np.hypot((radius - 0.55) / 1.5, between) < 0.05] = SEED
    rgb[radius > 0.94] = MEMBRANE
    return Disc((rgb * light).astype(np.float32))


def level(height: float, count: int = 8_000) -> NDArray[np.float32]:
    """(M, 3). Points of a horizontal cut through the unit ball, under the rind."""
    rng = np.random.default_rng(0)
    radius, angle = 0.75 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)], -1).astype(np.float32)


def far_from(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Share of points whose colours differ visibly."""
    return float((np.linalg.norm(a - b, axis=1) > 0.08).mean())


@pytest.mark.parametrize("pair", PAIRS)
def test_photographs_come_back_in_their_own_planes(pair: tuple[str, str]) -> None:
    across, made = photograph(pair[0]), quilt_of(pair)
    points = level(0)
    away = np.abs(points[:, 1]) > 0.1  # where the two meet, tones are even and the horizontal one wins
    shown = across.read(points[:, 0], points[:, 1])
    assert far_from(made.read(points[away]), shown[away]) < 0.02
    upright = points[:, [0, 2, 1]]
    shown = match_light(photograph(pair[1]), across).read(points[:, 0], points[:, 1])
    if made.grains is not None:  # in one light as far as grains are grains, with the rind that all pictures have
        even = [made.rinds.even(across, made.rinds.across[0], True)]
        even.append(made.rinds.even(photograph(pair[1]), made.rinds.along[0], False))
        chambers = [grains_of(disc, disc is even[0]).regions for disc in even]
        there = made.rinds.evened(upright)
        shown = match_light(even[1], even[0], chambers[::-1]).read(there[:, 0], there[:, 2])
    assert far_from(made.read(upright[away]), shown[away]) < 0.05


def test_no_plane_cuts_a_bar_out_of_another() -> None:
    made = quilt_of(PAIRS[0])
    x = np.linspace(-0.7, 0.7, 4_000)
    radial = made.labels[1].sources[0].even
    for off in (-0.015, 0.015):
        upright = np.stack([x, np.zeros_like(x), np.full_like(x, off)], -1).astype(np.float32)
        quilted_at = made.rinds.evened(upright)
        assert far_from(made.read(upright), radial.read(quilted_at[:, 0], quilted_at[:, 2])) < 0.1


def test_what_one_plane_alone_shows_is_as_thin_as_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for walls between chambers, which go on."""
    no_walls = np.float32(np.inf)
    monkeypatch.setattr(Label, "depth_in_chambers", lambda _, places: np.full(len(places.x), no_walls))
    points = level(0)
    points = points[np.abs(points[:, 1]) > 0.1]  # not where the radial picture is shown
    found = []

    def shown(height: float, film: float = PIXEL) -> NDArray[np.float32]:
        return made.read(points + np.array([0, 0, height], np.float32), film)

    def apart(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.floating]:
        return np.linalg.norm(a - b, axis=1)

    for seed in range(3):  # of one, 0.38 to 0.53 is thin: arils lie elsewhere
        made = quilted(*map(photograph, PAIRS[1]), seed=seed)
        own, above, below = (shown(height) for height in (0, 0.07, -0.07))
        alone = (apart(own, above) > 0.25) & (apart(own, below) > 0.25)
        for height, beside in ((0.012, above), (-0.012, below)):
            thin, thick = (
                (apart(there, own) < apart(there, beside))[alone].mean()
                for there in (shown(height, film) for film in (PIXEL, 0.05))
            )
            found.append((thin, thick))
    thin, thick = np.array(found).reshape(3, 2, 2).mean(0).T
    assert (thin < 0.5).all() and (thick > 0.7).all()


def test_walls_between_chambers_go_on_beside_their_plane() -> None:
    """Also those in colours that the radial picture does not show there."""
    made, points = quilt_of(PAIRS[1]), level(0)
    points = points[np.abs(points[:, 1]) > 0.1]
    own = made.labels[0]
    walls = points[own.depth_in_chambers(own.chunks.places(made.ball(made.rinds.evened(points)))) < -0.05]
    for height in (0.025, -0.025):
        moved = walls + np.array([0, 0, height], np.float32)
        assert (np.linalg.norm(made.read(moved) - made.read(walls), axis=1) < 0.3).mean() > 0.75


def test_tones_make_no_step_at_seams(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quilt, "match_light", lambda disc, _: disc)  # as if the light could not be matched
    made = quilted(*(Disc(np.full((DISC_PIXELS, DISC_PIXELS, 3), value, np.float32)) for value in (0.5, 0.56)))
    rng = np.random.default_rng(0)
    points = np.concatenate([level(height) for height in rng.uniform(-0.5, 0.5, 10)])
    near = points + rng.uniform(-0.005, 0.005, points.shape).astype(np.float32)
    shown = made.read(points)
    assert shown.std() > 0.01  # both pictures are used
    assert np.abs(made.read(near) - shown).max() < 0.015


def test_membranes_run_through_and_seeds_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quilt, "LEVELS", (32, 64))  # the membranes are a twenty-fifth of a radius thick
    x, y = disc_grid()
    plain = np.where((np.hypot(x, y) > 0.94)[..., None], MEMBRANE, FLESH) * [0.8, 0.9, 1.0]  # in another light
    made = quilted(segmented(seeds=True), Disc(plain.astype(np.float32)))
    dark, pale = [], []
    for height in (0.0, 0.3, -0.4):
        points = level(height)
        radius = np.hypot(points[:, 0], points[:, 1])
        shown = made.read(points[(radius > 0.25) & (radius < 0.6)])
        dark.append(shown[:, 0] < 0.4)
        pale.append((shown[:, 2] > 0.4).mean())
    assert dark[0].mean() > 0.08
    for other in dark[1:]:
        assert other[dark[0]].mean() < 0.3  # a rod would give 1
    # One of the two pictures has no seeds, so half as many are right.
    assert 0.25 < np.mean(dark[1:]) / dark[0].mean() < 0.75
    assert min(pale[1:]) > 0.7 * pale[0]


def test_pictures_share_their_middle_with_the_body() -> None:
    """In a body wider above, the centroid of its cuts lies above its middle; pictures' heights start at that point."""
    grid = Grid.around(np.array([[-1.0, -1, -1], [1, 1, 1]]), 1 / 16, 4)
    x, y, z = np.moveaxis(grid.centres(), -1, 0)
    wide = 1 + 0.3 * z  # half width of the ellipse at each height
    depth = 1 - np.sqrt((x / wide) ** 2 + (y / wide) ** 2 + z**2)
    space = make_space(Body(grid, (0.8 * depth).astype(np.float32)), UP, 32)
    ball = BallMap.of(space)
    points, height = ball.to_ball(space.planar), ball.height
    inside = np.sqrt(1 - np.linspace(-1, 1, 2001) ** 2) * (1 + 0.3 * np.linspace(-1, 1, 2001))
    centroid = (inside * np.linspace(-1, 1, 2001)).sum() / inside.sum()
    assert height == pytest.approx(-centroid, abs=0.02)
    middle = np.abs(space.planar).max(1) < 0.6
    assert np.abs(points[middle, 2] - height).max() < 0.05
    skin = space.depth < 0.01
    assert np.linalg.norm(points[skin], axis=1) == pytest.approx(1, abs=0.12)


@pytest.mark.slow
def test_every_picture_is_used_and_a_seed_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = disc_grid()
    faces = [
        Disc((FLESH * (1 + 0.2 * np.sin((n + 1) * 6 * x + y))[..., None]).clip(0, 1).astype(np.float32))
        for n in range(3)
    ]
    monkeypatch.setattr(quilt, "LEVELS", (16, 32))
    made = make_quilt(faces[:2], faces[2:], 1, lambda part: None)
    # Preparing the sources takes longest and uses no seed.
    sources = made.rinds, made.labels[0].sources, made.labels[1].sources
    monkeypatch.setattr(quilt, "_make_sources", lambda *_: sources)
    again, other = (make_quilt(faces[:2], faces[2:], seed, lambda part: None) for seed in (1, 2))
    points = level(0.3)
    assert (made.read(points) == again.read(points)).all()
    assert far_from(made.read(points), other.read(points)) > 0.1
    used = {
        n for label in made.labels if label.is_horizontal for n in label.chunks.places(quilt.Ball.of(_all())).picture
    }
    assert used == {0, 1}


def _all() -> NDArray[np.float32]:
    return np.concatenate([level(z, 1000) for z in np.linspace(-0.9, 0.9, 30)])


def test_a_little_more_light_changes_little() -> None:
    across, along = map(photograph, PAIRS[0])
    points = level(0.2)
    before = quilt_of(PAIRS[0]).read(points)
    after = quilted(across, replace(along, rgb=np.clip(along.rgb * np.float32(1.05), 0, 1))).read(points)
    assert far_from(before, after) < 0.05


def test_pictures_of_one_thing_agree_where_they_meet() -> None:
    def sample(name: str) -> Disc:
        kind: Kind = "horizontal" if name.startswith("horizontal") else "radial"
        return Disc.of(read_picture(SAMPLES / "orange" / f"{name}.png", kind))

    one, two = sample("horizontal_1"), sample("radial_1")
    assert show_one_thing([one], [two])
    redder = replace(two, rgb=np.clip(two.rgb * np.array([1, 0.8, 0.6], np.float32), 0, 1))
    assert disagreement(one, redder) > 2 * disagreement(one, two)
    assert not show_one_thing([one], [two, redder])


@pytest.mark.parametrize("pair", [("orange_h6", "orange_v4"), PAIRS[1]])
def test_photographs_of_two_fruits_do_not(pair: tuple[str, str]) -> None:
    across, along = map(photograph, pair)
    assert not show_one_thing([across], [along])


def test_what_is_known_to_be_one_thing_is_believed(tmp_path: Path) -> None:
    """`same` takes a different path for exactly the same pictures."""
    x = np.abs((np.mgrid[:128, :128] + 0.5) / 64 - 1)
    inside = np.hypot(*x)[..., None] < 0.8
    faces = [np.where(inside, colour, 1.0) for colour in (FLESH, FLESH * [1, 0.6, 0.6])]
    kinds: tuple[Kind, ...] = ("horizontal", "radial")
    families = [
        Family(kind, 4, (save(tmp_path / f"{kind}.png", face),)) for kind, face in zip(kinds, faces, strict=True)
    ]
    ways = [ExemplarPrior(same).solve(ball(), UP, families, 24, 0, lambda part: None).rgb for same in (False, True)]
    assert (ways[0] != ways[1]).any()


@pytest.mark.parametrize(("tall", "is_quilted"), [(0.4, True), (2.0, False)], ids=["stone", "pith"])
def test_a_core_that_ends_is_a_solid_and_one_that_runs_through_a_layer(
    tmp_path: Path, tall: float, is_quilted: bool
) -> None:
    """Two cuts of one thing, which agree where they meet."""
    y, x = np.abs((np.mgrid[:256, :256] + 0.5) / 128 - 1) / 0.8
    inside = np.hypot(x, y)[..., None] < 1
    faces = {"horizontal": np.hypot(x, y) < 0.3, "radial": np.hypot(x / 0.3, y / tall) < 1}
    families = []
    kinds: tuple[Kind, ...] = ("horizontal", "radial")
    for kind in kinds:
        flesh = np.where((faces[kind] & (np.hypot(x, y) < 0.8))[..., None], SEED, FLESH)
        families.append(Family(kind, 4, (save(tmp_path / f"{kind}.png", np.where(inside, flesh, 1.0)),)))
    made = ExemplarPrior().solve(ball(), UP, families, 24, 0, lambda part: None).inside
    assert isinstance(made, QuiltInside) == is_quilted


def test_what_is_wide_is_no_membrane() -> None:
    x, y = disc_grid()
    inside = (np.hypot(x, y) > 0.1) & (np.hypot(x, y) < 0.94)
    for half_width, least, most in ((0.02, 0.5, 1.0), (0.06, 0.5, 1.0), (0.12, 0.0, 0.1)):
        line = inside & (np.abs(y) < half_width) & (x > 0)
        face = Disc(np.where(line[..., None], MEMBRANE, FLESH).astype(np.float32))
        held = find_membranes(face, walls=True)
        middle = (np.abs(y) < 0.01) & (x > 0.3) & (x < 0.8)
        assert least <= held[middle].mean() <= most


def grainy() -> Disc:
    """Flesh with a texture some thousandths of a radius wide, and one large dark thing."""
    x, y = disc_grid()
    noise = ndimage.gaussian_filter(np.random.default_rng(0).standard_normal(x.shape), 1.5)
    rgb = FLESH + 0.1 * (noise / noise.std())[..., None]
    rgb[np.hypot(x - 0.5, y) < 0.12] = SEED
    return Disc(np.clip(rgb, 0, 1).astype(np.float32))


def test_texture_is_what_no_thing_is() -> None:
    face = grainy()
    parts = take_apart(face, FINE)
    whole = parts.things.rgb + parts.strength.rgb * parts.texture.rgb
    assert np.abs(whole - face.rgb).max() < 1e-5
    x, y = disc_grid()
    flesh, thing = (np.hypot(x, y) < 0.35), (np.hypot(x - 0.5, y) < 0.1)
    assert parts.things.rgb[flesh].std(0).max() < 0.5 * face.rgb[flesh].std(0).max()
    assert np.abs(parts.things.rgb[thing] - SEED).max() < 0.02


def test_texture_changes_along_the_axis_as_it_does_in_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()  # the grid of the product: on few cells, seams cut more texture off
    made = quilted(grainy(), Disc(grainy().rgb[::-1].copy()))
    points = level(0.27)[:4000] * [0.4, 0.4, 1]  # away from the dark thing
    rows = {
        step: made.read((points + np.array([0, 0, step])).astype(np.float32)).mean(-1) for step in (0.0, 0.005, 0.05)
    }
    near, far = (np.corrcoef(rows[0.0], rows[step])[0, 1] for step in (0.005, 0.05))
    assert near > 0.7
    assert far < 0.3
    true = grainy().read(points[:, 0], points[:, 1]).mean(-1)
    assert rows[0.0].std() == pytest.approx(true.std(), rel=0.25)


def contrast_around(rgb: NDArray[np.float32], radius: NDArray[np.float64]) -> float:
    """Mean square of what changes around the axis within 0.05 radii, of colours on circles of these radii (R,)."""
    fine = 0.0
    for r, row in zip(radius, rgb.reshape(len(radius), -1, 3), strict=True):
        around = ndimage.gaussian_filter1d(row, 0.05 / (2 * np.pi * r) * len(row), axis=0, mode="wrap")
        fine += float(np.square(row - around).mean())
    return fine


def test_juice_sacs_do_not_fade_beside_the_photograph() -> None:
    names = "orange_h1", "orange_v6"
    radius, turn = np.linspace(0.3, 0.75, 10), np.arange(720) / 720 * 2 * np.pi
    x, y = (radius[:, None] * axis(turn) for axis in (np.cos, np.sin))
    true = contrast_around(photograph(names[0]).read(x.ravel(), y.ravel()), radius)
    made, kept = quilt_of(names), []
    for height in (-0.3, -0.2, -0.1, 0.1, 0.2, 0.3):
        share = np.sqrt(1 - height**2)
        points = np.stack([x * share, y * share, np.full_like(x, height)], -1).reshape(-1, 3)
        kept.append(contrast_around(made.read(points.astype(np.float32)), radius) / true)
    assert np.mean(kept) > 0.58  # 0.48 where texture is what is narrower than 0.02 radii alone


def test_no_chips_of_pith_lie_in_the_pulp() -> None:
    """Pulp shows no more pith across the axis than the horizontal photograph, whatever the radial one has around it."""
    turn, radius = np.arange(360) / 180 * np.pi, np.linspace(0.2, 0.6, 41)[:, None]
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    weight = np.broadcast_to(radius, x.shape).ravel()
    pith = {}
    for height in (-0.5, -0.25, 0, 0.25, 0.5):
        share = np.sqrt(1 - height**2)
        points = np.stack([x * share, y * share, np.full_like(x, height)], -1).reshape(-1, 3).astype(np.float32)
        pith[height] = np.average(quilt_of(("orange_h1", "orange_v6")).read(points)[:, 2] > 0.5, weights=weight)
    assert 0 < pith[0] < 0.05  # its membranes
    assert np.mean([share for height, share in pith.items() if height]) < pith[0]


def test_light_is_told_from_what_is_there() -> None:
    """Lamplight on flesh and rind is removed; a white core that the other picture lacks stays white."""
    x, y = disc_grid()
    radius = np.hypot(x, y)
    plain = np.where((radius > 0.85)[..., None], 0.95, FLESH)
    cored = np.where((np.abs(x) < 0.08)[..., None], 0.95, plain) * [1.0, 0.9, 0.7]
    made = match_light(Disc(cored.astype(np.float32)), Disc(plain.astype(np.float32))).rgb
    flesh, core = (np.abs(x) > 0.1) & (radius < 0.8), (np.abs(x) < 0.07) & (radius < 0.8)
    assert np.abs(made[flesh] - FLESH).max() < 0.02
    assert np.abs(made[core] - 0.95).max() < 0.1
    again = match_light(Disc(plain.astype(np.float32)), Disc(plain.astype(np.float32))).rgb
    assert np.abs(again - plain).max() < 1e-5


def test_what_is_darker_than_flesh_is_moved_in_proportion() -> None:
    """Black seeds and brown stains in lamplight come back as they were: not blue, and not lighter."""
    x, y = disc_grid()
    flesh = np.array([0.95, 0.9, 0.75])
    there = np.where((np.hypot(x - 0.5, y) < 0.1)[..., None], [0.05, 0.04, 0.03], flesh)
    there = np.where((np.hypot(x + 0.5, y) < 0.1)[..., None], [0.6, 0.45, 0.3], there)
    made = match_light(Disc((there * [1.0, 0.9, 0.6]).astype(np.float32)), Disc(there.astype(np.float32))).rgb
    assert np.abs(made - there)[np.hypot(x, y) < 0.95].max() < 0.02


def test_white_pith_stays_white_beside_flesh_and_rind_of_another_colour() -> None:
    """Rings of the rind mix white and peel: brought to a whiter mixture, a whiter core became violet."""
    x, y = disc_grid()
    rind, core = (np.hypot(x, y) > 0.88)[..., None], (np.abs(x) < 0.08)[..., None]
    yellow = np.where(core, [0.98, 0.92, 0.87], np.where(rind, [0.99, 0.91, 0.6], [0.99, 0.67, 0.05]))
    orange = np.where(rind, [0.98, 0.94, 0.81], [0.98, 0.55, 0.02])
    made = match_light(Disc(yellow.astype(np.float32)), Disc(orange.astype(np.float32))).read(*np.zeros((2, 1)))[0]
    assert made[2] <= made[0]
    assert np.abs(made - [0.98, 0.92, 0.87]).max() < 0.1


def test_pale_strands_stay_grey_where_pith_is_far_darker() -> None:
    """As in a backlit slice, whose pith is brown. Each channel found its own way to white: they became cyan."""
    x, y = disc_grid()
    rind = (np.hypot(x, y) > 0.85)[..., None]
    strand = (np.abs(x) < 0.03) & (np.abs(y - 0.5) < 0.2)
    lit = np.where(strand[..., None], [0.9, 0.95, 0.9], np.where(rind, [0.95, 0.9, 0.65], [0.98, 0.6, 0.1]))
    backlit = np.where(rind, [0.55, 0.42, 0.35], [0.98, 0.5, 0.1])
    made = match_light(Disc(lit.astype(np.float32)), Disc(backlit.astype(np.float32))).rgb
    assert np.ptp(made[strand], axis=-1).max() < 0.1


def test_closed_things_are_as_many_as_the_pictures_show() -> None:
    def seeded(seed: int) -> Disc:
        x, y = disc_grid()
        rgb = np.broadcast_to(FLESH, (*x.shape, 3)).copy()
        for a, b in np.random.default_rng(seed).uniform(-0.7, 0.7, (20, 2)):
            rgb[np.hypot(x - a, y - b) < 0.06] = SEED
        return Disc(rgb.astype(np.float32))

    across, along = seeded(1), seeded(2)
    made = quilted(across, along)
    points = np.random.default_rng(0).uniform(-0.95, 0.95, (60_000, 3)).astype(np.float32)
    points = points[np.linalg.norm(points, axis=1) < 0.95]
    shown = (made.read(points)[:, 0] < 0.5).mean()
    x, y = disc_grid()
    weight = np.where(np.hypot(x, y) < 0.95, np.abs(x), 0)  # volume in the ball for each place of a radial picture
    wanted = ((along.rgb[..., 0] < 0.5) * weight).sum() / weight.sum()
    assert 0.5 * wanted < shown < 2 * wanted


def test_even_tones_keep_details() -> None:
    """Light from one side is removed; seeds, membranes and a core line stay as strong as before."""
    face = segmented(seeds=True)
    x, y = disc_grid()
    inside = np.hypot(x, y) < 0.9
    lit = replace(face, rgb=(face.rgb * (0.9 + 0.1 * x)[..., None]).astype(np.float32))
    wrong, even = (np.abs(d.rgb - 0.9 * face.rgb)[inside].mean() for d in (lit, even_around(lit)))
    assert even < 0.3 * wrong
    line = replace(face, rgb=np.where((np.abs(x) < 0.03)[..., None], MEMBRANE, FLESH * (0.9 + 0.1 * x)[..., None]))
    made = even_sides(replace(line, rgb=line.rgb.astype(np.float32))).rgb
    assert np.abs(made - made[::-1])[inside].mean() < 0.3 * np.abs(line.rgb - line.rgb[::-1])[inside].mean()
    contrast = [
        (rgb[np.abs(x) < 0.02].mean(0) - rgb[np.abs(np.abs(x) - 0.1) < 0.02].mean(0)) for rgb in (line.rgb, made)
    ]
    assert contrast[1] == pytest.approx(contrast[0], abs=0.03)
