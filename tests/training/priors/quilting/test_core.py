"""The core of a face as a solid: against drawn stars and columns, closed forms, and photographs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.measure import label, regionprops

from tests.helpers.exemplar_faces import coarse_quilt, photograph
from training.priors.exemplar.quilting import quilt
from training.priors.exemplar.quilting.disc import PIXEL, Disc, disc_grid, disc_radius, even_sides, match_light
from training.priors.exemplar.quilting.labels import Source
from training.priors.exemplar.quilting.quilt import Quilt, make_quilt
from training.priors.exemplar.quilting.rinds import rind_of
from training.priors.exemplar.quilting.things.column import Column
from training.priors.exemplar.quilting.things.core import MARGIN, Core
from training.priors.exemplar.quilting.things.cores import find_core

FLESH, DARK, RIND = np.array([0.9, 0.8, 0.6]), np.array([0.2, 0.1, 0.05]), np.array([0.7, 0.2, 0.2])
REACH = 0.3
TALL = 0.16


def face(dark: NDArray[np.bool_]) -> Disc:
    """Flesh with a rind, dark at these places, with some grain."""
    x, y = disc_grid()
    rgb = np.where(dark[..., None], DARK, np.where((np.hypot(x, y) > 0.94)[..., None], RIND, FLESH))
    return Disc((rgb + 0.01 * np.random.default_rng(0).standard_normal((*x.shape, 1))).astype(np.float32))


def star(arm: float = 0.045) -> NDArray[np.bool_]:
    """Five arms of this half width around the middle, none of them in the radial picture's plane."""
    x, y = disc_grid()
    dark = np.hypot(x, y) < 0.05
    for turn in 0.3 + np.arange(5) * 2 * np.pi / 5:
        s, t = x * np.cos(turn) + y * np.sin(turn) - 0.16, y * np.cos(turn) - x * np.sin(turn)
        dark |= np.hypot(s / 0.14, t / arm) < 1
    return dark


def pips(wide: float = 0.05) -> NDArray[np.bool_]:
    """Pips of this half width on both sides of the axis."""
    x, y = disc_grid()
    return np.hypot((np.abs(x) - 0.12) / wide, y / TALL) < 1


def found_in(disc: Disc, *radial: Disc) -> Core | Column:
    """The core of a horizontal picture, with what radial ones show of it."""
    rinds = [rind_of(disc, True)[0], max((rind_of(one, False)[0] for one in radial), default=0.0)]
    return find_core(disc, rinds[0], radial, rinds[1], 0.0)


def core_of(disc: Disc, *radial: Disc) -> Core:
    """The same where it ends."""
    core = found_in(disc, *radial)
    assert isinstance(core, Core)
    return core


def test_pictures_are_looked_at_in_threads_so_no_warning_of_the_process_is_hidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If two threads hid warnings, the last to end would leave them hidden."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("hides warnings")

    with monkeypatch.context() as patch:
        patch.setattr("warnings.catch_warnings", refuse)
        star_shaped = face(star())
        assert Source.of(star_shaped, True).with_core(core_of(star_shaped)).core.reach


def test_a_core_is_as_tall_as_its_area_is_wide_or_as_radial_pictures_show_it() -> None:
    x, y = disc_grid()
    half = 0.13
    disc = face(np.hypot(x, y) < half)
    alone = core_of(disc)
    assert alone.reach == pytest.approx(half + MARGIN, abs=0.01)
    assert alone.ends == pytest.approx((half, half), rel=0.05)
    for tall, size in ((0.06, 1.0), (0.12, 1.0), (0.12, 0.7)):
        shown = face(np.hypot(x / half, y / tall) < size)
        assert core_of(disc, shown).ends == pytest.approx((size * tall,) * 2, abs=0.015)


def test_what_is_taller_than_wide_in_radial_pictures_is_a_column() -> None:
    x, y = disc_grid()
    column = face((np.abs(x) < 0.1) & (np.abs(y) < 0.7))
    disc = face(np.hypot(x, y) < 0.12)
    assert core_of(disc).reach > 0
    assert isinstance(found_in(disc, column), Column)


def test_a_column_has_the_shape_of_its_picture_and_is_as_wide_as_radial_ones_show_it() -> None:
    """Half as wide at the top, and at the upper end a flat top; in every cut, the solid that both pictures are of."""

    def wide(z: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.where(np.abs(z) < 0.7, 0.75 - 0.35 * z, 0)

    x, y = disc_grid()
    disc, column = face(np.hypot(x, y / 0.6) < 0.2), face(np.abs(x) < 0.2 * wide(y) / wide(np.array(0.0)))
    made = coarse_quilt(disc, column)
    axis = ((np.arange(160) + 0.5) / 160 * 2 - 1).astype(np.float32) * 0.8
    u, v = (a.ravel() for a in np.meshgrid(axis, axis))
    for points in (
        *(np.column_stack([u, v, np.full(len(u), z)]) for z in (-0.6, -0.3, 0.2, 0.4, 0.6)),
        *(np.column_stack([u * np.cos(t), u * np.sin(t), v]) for t in (0.5, 1.0, np.pi / 2, 2.2)),
        np.column_stack([u, np.full(len(u), 0.06), v]),
    ):
        some = points[np.linalg.norm(points, axis=1) < 0.85].astype(np.float32)
        size = 0.2 * wide(some[:, 2]) / wide(np.array(0.0))
        truth = np.hypot(some[:, 0], some[:, 1] / 0.6) < size
        wrong = is_dark(made, some) != truth
        assert wrong.sum() < 0.1 * max(truth.sum(), 1), (points[0], wrong.sum(), truth.sum())


def test_what_a_radial_picture_shows_in_a_column_makes_no_rings() -> None:
    """A dark hollow whose width changes along the axis has an uneven outline in horizontal cuts, as hollows have."""
    x, y = disc_grid()
    pith, hollow = (np.abs(x) < 0.2) & (np.abs(y) < 0.8), np.abs(x) < 0.08 + 0.05 * np.sin(9 * y)
    column = Disc(np.where((pith & ~hollow)[..., None], 1.0, face(pith).rgb).astype(np.float32))
    disc = Disc(np.where((np.hypot(x, y) < 0.2)[..., None], 1.0, face(np.zeros(x.shape, bool)).rgb).astype(np.float32))
    made = coarse_quilt(disc, column)
    angle = np.linspace(0.2, np.pi - 0.2, 200)
    for height in (-0.4, 0.3):
        ring = np.column_stack([0.08 * np.cos(angle), 0.08 * np.sin(angle), np.full(200, height)])
        assert np.ptp(made.read(ring.astype(np.float32))[:, 0]) > 0.3


def test_the_plane_of_a_horizontal_picture_is_no_bar_across_a_column() -> None:
    """Green that a radial picture shows all along the axis, and the horizontal one not at all, fades towards that."""
    x, y = disc_grid()
    pith, green = (np.abs(x) < 0.2) & (np.abs(y) < 0.8), np.abs(x) < 0.08
    flesh = face(np.zeros(x.shape, bool)).rgb
    along = Disc(np.where(pith[..., None], np.where(green[..., None], (0.8, 1.0, 0.8), 1.0), flesh).astype(np.float32))
    across = Disc(np.where((np.hypot(x, y) < 0.2)[..., None], 1.0, flesh).astype(np.float32))
    made = coarse_quilt(across, along)
    heights = np.linspace(-0.3, 0.3, 61)
    blue = made.read(np.column_stack([0 * heights, 0 * heights + 0.05, heights]).astype(np.float32))[:, 2]
    assert blue[30] - blue[[0, -1]].max() > 0.15
    assert np.abs(np.diff(blue)).max() < 0.15 * np.ptp(blue)  # in a bar, 0.3 from one hundredth to the next


def test_no_line_crosses_a_white_hollow_where_a_radial_picture_shows_it_filled() -> None:
    """Its plane shows what its own core has, in the tone of the other's: a knife meets it in every cut."""
    x, y = disc_grid()
    hollow, filled = np.hypot(x, y) < 0.16, (np.abs(x) < 0.14) & (np.abs(y) < 0.7)
    filling = 0.1 * np.sin(40 * y)[..., None] + [0.55, 0.3, 0.3]
    across = Disc(np.where(hollow[..., None], 1.0, face(hollow).rgb).astype(np.float32))
    along = Disc(np.where(filled[..., None], filling, face(filled).rgb).astype(np.float32))
    made = coarse_quilt(across, along)
    through = np.linspace(-0.08, 0.08, 161, dtype=np.float32)
    for height in (-0.3, 0.2, 0.4):
        shown = made.read(np.stack([np.full_like(through, 0.03), through, np.full_like(through, height)], -1))
        assert shown.mean(1).min() > 0.85
    level = np.linspace(-0.5, 0.5, 400, dtype=np.float32)
    own = made.read(np.stack([0 * level, 0 * level, level], -1)).mean(1)
    assert np.corrcoef(own, np.minimum(0.1 * np.sin(40 * level), 0))[0, 1] > 0.9


def test_where_a_radial_picture_shows_a_wider_column_it_has_tips_and_no_bar() -> None:
    x, y = disc_grid()
    wide, narrow = face((np.abs(x) < 0.25) & (np.abs(y) < 0.7)), face(np.hypot(x, y) < 0.15)
    made = coarse_quilt(narrow, wide)
    off = np.linspace(-0.1, 0.1, 401, dtype=np.float32)
    thick = [is_dark(made, np.stack([0 * off + x, off, 0 * off + 0.3], -1)).mean() for x in (0.17, 0.2, 0.23)]
    assert thick[0] > 1.3 * thick[1] > 1.6 * thick[2] > 0


def test_no_line_crosses_a_hollow_beside_the_plane_of_its_picture() -> None:
    """A pit that a radial picture alone shows in it is dark in that picture's plane, and hardly as thick as that."""
    x, y = disc_grid()
    hollow, filled = np.hypot(x, y) < 0.15, (np.abs(x) < 0.14) & (np.abs(y) < 0.7)
    filling = np.where((np.abs(y - 0.02) < 0.05)[..., None], (0.35, 0.1, 0.1), (0.55, 0.3, 0.3))
    across = Disc(np.where(hollow[..., None], 1.0, face(hollow).rgb).astype(np.float32))
    along = Disc(np.where(filled[..., None], filling, face(filled).rgb).astype(np.float32))
    made = coarse_quilt(across, along)
    through = np.linspace(-0.1, 0.1, 401, dtype=np.float32)
    dark = 1 - made.read(np.stack([0 * through + 0.03, through, 0 * through + 0.01], -1))[:, 1]
    assert dark[200] > 0.15 and 0.2 * dark.mean() < 0.007 * dark[200]  # a third of how thick planes are elsewhere


def test_no_core_is_what_is_joined_to_the_rind_apart_from_the_axis_or_nothing() -> None:
    x, y = disc_grid()
    for dark in (np.abs(y) < 0.04, np.hypot(x - 0.4, y) < 0.08, np.zeros(x.shape, bool)):
        assert core_of(face(dark)).reach == 0


def stone(half_width: float, half_height: float) -> tuple[Disc, NDArray[np.bool_]]:
    """An oval stone in a halo that is twice as large, and where it is."""
    x, y = disc_grid()
    oval = np.hypot(x / half_width, y / half_height)
    halo = np.clip(2 - oval, 0, 1)[..., None] * [0.1, 0.3, 0.3]
    plain = face(oval < 1).rgb
    return Disc(np.where((oval < 1)[..., None], plain, plain - halo).astype(np.float32)), oval < 1


def test_a_stone_in_a_halo_has_its_own_outline_and_height() -> None:
    (across, truth), (along, _) = stone(0.36, 0.22), stone(0.36, 0.42)
    core = core_of(across, along)
    assert (core.shape & truth).sum() > 0.9 * (core.shape | truth).sum()
    assert core.ends == pytest.approx((0.42, 0.42), rel=0.05)


def test_a_stone_that_radial_pictures_show_beside_the_axis_alone_is_as_tall_as_wide() -> None:
    x, y = disc_grid()
    half = 0.2
    core = core_of(face(np.hypot(x, y) < half), face(np.hypot(np.abs(x) - 0.15, y) < 0.06))
    assert core.reach == pytest.approx(half + MARGIN, abs=0.01)
    assert max(core.ends) < 0.25  # and it is not the rind at the poles
    speck = face(np.hypot(x, y) < 0.02)  # which shows no stone
    assert core_of(face(np.hypot(x, y) < half), speck).ends == pytest.approx((half, half), rel=0.05)


def test_what_lies_around_a_core_within_its_reach_is_not_laid_elsewhere_as_a_seed() -> None:
    x, y = disc_grid()
    dark = np.hypot(x / 0.36, y / 0.22) < 1
    for at in (0.31, 0.6):
        dark |= np.hypot(x / 0.035, (y - at) / 0.025) < 1
    source = Source.of(face(dark), True)
    assert len(source.seeds.places) > 1
    assert source.with_core(core_of(source.disc)).seeds.places == pytest.approx(np.array([[0, 0.6]]), abs=0.01)


def test_a_stone_is_one_solid_that_two_pictures_at_different_heights_are_of() -> None:
    """An ellipsoid that lies low: as wide at every height as it is, in its own colours, and without specks around."""
    x, y = disc_grid()
    low, wide, high = -0.2, 0.4, 0.44
    across = np.sqrt(1 - (low / high) ** 2) * wide
    pictures = face(np.hypot(x, y) < across), face(np.hypot(x / wide, (y - low) / high) < 1)
    made = coarse_quilt(*pictures)
    points = np.random.default_rng(0).uniform(-0.75, 0.75, (60_000, 3)).astype(np.float32)
    points = points[np.linalg.norm(points, axis=1) < 0.75]
    depth = 1 - np.linalg.norm((points - np.array([0, 0, low])) / [wide, wide, high], axis=1)
    dark = is_dark(made, points)
    assert dark[depth > 0.05].mean() > 0.99
    assert dark[depth < -0.05].sum() < 0.01 * (depth > 0).sum()


def test_a_shell_around_a_core_is_another_thing() -> None:
    """As in a coconut: closed in from all sides, the flesh between the hollow and the shell is no part of it."""
    radius = disc_radius()
    half = 0.55
    disc = face((radius < half) | (radius > 0.84))
    core = core_of(disc, disc)
    assert core.profile is not None
    assert core.profile.reach == pytest.approx((half, half), abs=0.03)
    level = np.array([-0.4, 0.2, 0.4])
    assert core.profile.grown(level) == pytest.approx(np.sqrt(1 - np.square(level / half)), abs=0.05)


def test_a_core_is_found_where_walls_join_it_to_the_rind() -> None:
    x, y = disc_grid()
    dark = np.hypot(x, y) < 0.2
    for turn in 0.3 + np.arange(3) * 2 * np.pi / 3:
        s, t = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        dark |= (s > 0) & (np.abs(t) < 0.05)
    core = core_of(face(dark))
    assert core.reach == pytest.approx(0.2 + MARGIN, abs=0.08)  # with corners of walls
    assert core.shape.sum() * PIXEL**2 == pytest.approx(np.pi * 0.2**2, rel=0.1)


@pytest.mark.parametrize(("wide", "arm"), [(0.05, 0.06), (0.09, 0.045)])
def test_a_radial_picture_shows_solids_as_thick_as_wide_or_as_the_arms_of_the_star(wide: float, arm: float) -> None:
    """Cut parallel to its picture's plane, a pip shows the ellipse that an ellipsoid has at that distance."""
    shown = face(pips(wide))
    core = Core.along(even_sides(shown), core_of(face(star(arm)), shown), 0.0)
    x, y = (a[::4, ::4].ravel() for a in disc_grid())
    near = np.hypot(x, y) < 0.4
    x, y = x[near], y[near]
    thick = min(wide, arm)
    areas = []
    for away in np.array([0.0, 0.4, 0.7, 1.1]) * thick:
        rgb, deep = core.read(shown, x, y, np.full(len(x), away))
        areas.append((deep > 0).sum() * (4 * PIXEL) ** 2)
        assert np.abs(rgb[deep > 0.005] - DARK).max(initial=0) < 0.2  # of 0.7, at the edge in the picture itself
    full = 2 * np.pi * wide * TALL
    assert areas[0] == pytest.approx(full, rel=0.08)
    assert areas[1] == pytest.approx(full * (1 - 0.4**2), rel=0.12)
    assert areas[2] == pytest.approx(full * (1 - 0.7**2), rel=0.25)
    assert areas[3] < 0.05 * full


@pytest.fixture(scope="module")
def grown() -> Quilt:
    return coarse_quilt(face(star()), face(pips()))


def level(height: float) -> NDArray[np.float32]:
    """(M, 3). Points of a level cut through the flesh."""
    x, y = (a[::3, ::3].ravel() for a in disc_grid())
    points = np.column_stack([x, y, np.full(len(x), height)]).astype(np.float32)
    return points[np.hypot(x, y) < 0.75]


def is_dark(made: Quilt, points: NDArray[np.float32]) -> NDArray[np.bool_]:
    return made.read(points)[:, 0] < 0.55


def test_a_star_is_a_star_at_its_height_and_smaller_above_and_gone(grown: Quilt) -> None:
    areas = []
    for height in (0.0, 0.05, 0.1, 0.14, 0.25):
        points = level(height)
        points = points[np.abs(points[:, 1]) > 0.06]  # away from the radial picture's plane
        dark = is_dark(grown, points)
        areas.append(dark.sum())
        inside = Disc(np.repeat(star()[..., None], 3, -1).astype(np.float32)).read(*points[:, :2].T)[:, 0]
        assert not (dark & (inside < 0.1)).any()  # no smudge, and nothing beside the arms
        if not height:
            assert dark[inside > 0.9].mean() > 0.97
    assert all(b < a for a, b in pairwise(areas[:4]))
    assert areas[3] > 0
    assert areas[4] == 0


def test_nothing_dark_is_left_beside_a_core(grown: Quilt) -> None:
    """No chunk shows pips all around the axis, or a star at another height."""
    points = np.random.default_rng(1).uniform(-0.75, 0.75, (200_000, 3)).astype(np.float32)
    far = (np.hypot(*points[:, :2].T) > REACH + 0.05) | (np.abs(points[:, 2]) > 0.25)
    points = points[far & (np.linalg.norm(points, axis=1) < 0.75)]
    assert not is_dark(grown, points).any()


def test_the_thin_tip_of_an_arm_ends_with_the_star_and_its_stain_fades(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tip is no membrane, which would run from pole to pole, and the stain no layer around the plane."""
    monkeypatch.setattr(quilt, "LEVELS", (16, 32))
    x, y = disc_grid()
    along, across = x * np.cos(0.3) + y * np.sin(0.3), y * np.cos(0.3) - x * np.sin(0.3)
    tipped = star() | ((np.abs(across) < 0.014) & (along > 0.25) & (along < 0.6))
    stain = np.clip(1.2 - 3 * np.hypot(x, y), 0, 1)[..., None] * [0.1, 0.1, 0.15] * ~tipped[..., None]
    made = make_quilt([Disc((face(tipped).rgb - stain).astype(np.float32))], [face(pips())], 0, lambda part: None)
    assert is_dark(made, level(0.0)).any()
    for height in (-0.5, -0.3, 0.3, 0.5):
        assert not is_dark(made, level(height)).any()
    turn = 0.3 + np.pi / 5  # between two arms
    rising = np.linspace(0, 0.12, 25)
    u, v = (0.2 * along(turn) + np.linspace(-0.02, 0.02, 9) for along in (np.cos, np.sin))
    points = np.stack(np.meshgrid(rising, u, v, indexing="ij"), -1)[..., [1, 2, 0]].reshape(-1, 3)
    shown = made.read(points.astype(np.float32)).reshape(25, -1, 3).mean(1)  # without grain
    assert np.linalg.norm(shown[0] - shown[-1]) > 0.08
    assert np.linalg.norm(np.diff(shown, axis=0), axis=1).max() < 0.03


def test_own_planes_show_both_pictures(grown: Quilt) -> None:
    x, y = (a[::3, ::3].ravel() for a in disc_grid())
    inside = (np.hypot(x, y) < 0.75) & (np.abs(y) > 0.03)
    x, y = x[inside], y[inside]
    shown = is_dark(grown, np.column_stack([x, np.zeros_like(x), y]).astype(np.float32))
    wanted = np.hypot((np.abs(x) - 0.12) / 0.05, y / TALL)
    assert shown[wanted < 0.9].mean() > 0.98
    assert not shown[wanted > 1.15].any()


def test_a_stone_is_whole_in_every_cut() -> None:
    """In two fruits with stones at different heights it is one convex piece, and appears nowhere else."""
    x, y = disc_grid()
    pictures = face(np.hypot(x, y) < 0.4), face(np.hypot(x, y + 0.1) < 0.38)
    made = coarse_quilt(*pictures)
    at = np.linspace(-0.75, 0.75, 251, dtype=np.float32)
    u, v = np.meshgrid(at, at, indexing="ij")
    inside = np.hypot(u, v) < 0.75
    flat = np.full_like(u, 0.05)
    for points in ((u, v, flat), (u, v, flat - 0.3), (u, flat, v), (flat, u, v), (u, (u + v) / 2, v)):
        dark = is_dark(made, np.stack(points, -1).reshape(-1, 3)).reshape(u.shape) & inside
        (stone,) = (part for part in regionprops(label(dark)) if part.area > 20)
        assert stone.solidity > 0.95
        assert 0.02 < stone.area / inside.sum() < 0.4


def test_a_long_core_keeps_its_colour_in_the_light_of_another_picture() -> None:
    """Above and below the middle a column crosses rings that are flesh in a horizontal picture."""
    x, y = disc_grid()
    horizontal, radial = face(np.hypot(x, y) < 0.22), face(np.hypot(x / 0.22, y / 0.75) < 1)
    lit = match_light(Disc(radial.rgb * np.array([0.9, 1.0, 1.1], np.float32)), horizontal)
    up = np.array([-0.6, -0.4, 0.0, 0.4, 0.6])
    assert np.abs(lit.read(np.zeros(5), up) - DARK).max() < 0.1
    assert np.abs(lit.read(np.full(5, 0.5), up) - FLESH).max() < 0.1


@pytest.mark.parametrize(("one", "other"), [(0.37, 0.3), (0.3, 0.37), (0.34, 0.34)])
def test_a_stone_keeps_its_colour_whatever_its_width_in_another_picture(one: float, other: float) -> None:
    """The ring that is stone in one of them and flesh in the other is no pair of colours."""
    radius, light = disc_radius(), np.array([1.0, 0.95, 0.8], np.float32)
    lit = match_light(Disc(face(radius < one).rgb * light), face(radius < other))
    assert np.abs(np.median(lit.rgb[radius < one - 0.02], axis=0) - DARK).max() < 0.05
    assert np.abs(np.median(lit.rgb[(radius > 0.45) & (radius < 0.8)], axis=0) - FLESH).max() < 0.02


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [("apple_h1", 0.25, 0.45), ("apple_h2", 0.25, 0.45), ("watermelon_h8", 0, 0)],
)
def test_of_photographs_stars_are_cores(name: str, least: float, most: float) -> None:
    assert least <= core_of(photograph(name)).reach <= most


@pytest.mark.parametrize("pair", [("orange_h1", "orange_v6"), ("orange_h6", "orange_v4"), ("orange_h4", "orange_v2")])
def test_of_photographs_pith_is_a_column_that_no_rind_widens(pair: tuple[str, str]) -> None:
    across, along = (photograph(name) for name in pair)
    column = found_in(across, match_light(along, across))
    assert isinstance(column, Column)
    level = disc_grid()[1][0]
    assert column.widths[np.abs(level) < 0.3].min() > 0.4
    assert column.widths[np.abs(level) > 0.75].max() < 1.0


def test_the_edge_of_a_column_has_no_steps_and_its_outline_no_rings() -> None:
    """Its depth is that of a round one to 0.4 pixels, and fibres beside it in the radial picture widen it nowhere."""
    x, y = disc_grid()
    shown = face(np.abs(x) < 0.16 + 0.06 * (np.sin(80 * y) > 0.5) * (x > 0))
    column = found_in(face(np.hypot(x, y) < 0.16), shown)
    assert isinstance(column, Column)
    turn = np.linspace(0, 2 * np.pi, 2000)
    assert np.abs(column.depth_at(0.16 * np.cos(turn), 0.16 * np.sin(turn))).max() < 0.4 * PIXEL
    level = disc_grid()[1][0]
    assert np.ptp(column.widths[np.abs(level) < 0.7]) < 0.03


def test_the_edge_of_a_core_has_no_steps() -> None:
    """Cut at any distance from its picture, a round one is round to half a pixel."""
    x, y = disc_grid()
    disc = face(np.hypot(x, y) < 0.1)
    core, turn = Core.across(np.hypot(x, y) < 0.1, []), np.linspace(0, 2 * np.pi, 500)
    away = np.linspace(0.07, 0.12, 201)
    for rise in (0.0, 0.03, 0.06):
        u, v = (np.outer(away, along(turn)).ravel() for along in (np.cos, np.sin))
        deep = core.read(disc, u, v, np.full(u.size, rise))[1].reshape(len(away), -1)
        edge = away[(deep > 0).sum(0) - 1]
        assert np.ptp(edge) < PIXEL
