"""Seeds of a face, found and placed as whole solids: against drawn ellipses and the closed forms of stereology."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tests.helpers.exemplar_faces import coarse_quilt, photograph
from training.priors.exemplar.quilting.disc import Disc, disc_grid, even_around, even_sides
from training.priors.exemplar.quilting.labels import Source
from training.priors.exemplar.quilting.quilt import Quilt
from training.priors.exemplar.quilting.relief import Relief
from training.priors.exemplar.quilting.rinds import rind_of
from training.priors.exemplar.quilting.texture import FINE, take_apart
from training.priors.exemplar.quilting.things.candidates import CANDIDATES, SECTION, Candidates, in_own_planes, strewn
from training.priors.exemplar.quilting.things.packing import pack
from training.priors.exemplar.quilting.things.seeds import Seeds
from training.priors.exemplar.quilting.things.stamps import Things

FLESH, SEED, RIND = np.array([0.9, 0.3, 0.3]), np.array([0.15, 0.1, 0.1]), np.array([0.8, 0.9, 0.5])
AXES = 0.05, 0.03
RING = 0.5
"""Radius at which most tests have their seeds."""


def face(seeds: list[tuple[float, float, float]], axes: tuple[float, float] = AXES) -> Disc:
    """Flesh with a rind, some grain, and dark ellipses (x, y, direction of the longer axis)."""
    x, y = disc_grid()
    rgb = np.where((np.hypot(x, y) > 0.92)[..., None], RIND, FLESH)
    for u, v, turn in seeds:
        s = ((x - u) * np.cos(turn) + (y - v) * np.sin(turn)) / axes[0]
        t = ((y - v) * np.cos(turn) - (x - u) * np.sin(turn)) / axes[1]
        rgb[np.hypot(s, t) < 1] = SEED
    grain = 0.01 * np.random.default_rng(0).standard_normal((*x.shape, 1))
    return Disc((rgb + grain).astype(np.float32))


def around(count: int, radius: float = RING) -> list[tuple[float, float, float]]:
    """Seeds evenly around the middle, each pointing outwards."""
    turns = np.arange(count) / count * 2 * np.pi + 0.1
    return [(radius * np.cos(t), radius * np.sin(t), t) for t in turns]


def all_of(tried: Candidates) -> NDArray[np.bool_]:
    """All of them may be laid."""
    return np.ones(len(tried.stamps), bool)


def found(disc: Disc, is_horizontal: bool = True) -> Seeds:
    """The seeds of a face, of which nothing else is looked for."""
    rind = rind_of(disc, is_horizontal)[0]
    parts = take_apart(even_around(disc) if is_horizontal else even_sides(disc), FINE)
    return Seeds.of(Relief.of(parts.things, parts.strength, rind), is_horizontal, rind)


def test_drawn_seeds_are_found_as_they_lie() -> None:
    wanted = around(8)
    seeds = found(face(wanted))
    assert len(seeds.places) == len(wanted)
    for u, v, turn in wanted:
        away = np.hypot(*(seeds.places - [u, v]).T)
        n = int(away.argmin())
        assert away[n] < 0.004
        assert seeds.axes[n] == pytest.approx(AXES, rel=0.12)
        assert abs(np.sin(seeds.turns[n] - turn)) < 0.1


def test_seeds_that_touch_are_several() -> None:
    """A row as in melons, joined by places half as dark."""
    row = [(0.5, y, 0.0) for y in np.arange(-0.2, 0.21, 0.08)]
    disc = face(row)
    x, y = disc_grid()
    between = (np.abs(x - 0.5) < 0.02) & (np.abs(y) < 0.2) & (disc.rgb[..., 0] > 0.5)
    disc.rgb[between] = (FLESH + SEED) / 2
    assert len(found(disc, False).places) == len(row)


def test_no_seeds_are_what_is_joined_to_the_core_the_rind_or_nothing() -> None:
    star = [(0.2 * np.cos(t), 0.2 * np.sin(t), t) for t in np.arange(5) * 2 * np.pi / 5]
    assert not len(found(face(star, (0.15, 0.05))).places)
    assert not len(found(face([(0.92, 0.0, 0.0)])).places)
    assert not len(found(face([])).places)


def test_without_its_seeds_a_face_is_flesh() -> None:
    bare = Source.of(face(around(8)), True).bare
    inside = np.hypot(*disc_grid()) < 0.85
    for rgb in (bare.even.rgb, bare.relief.levels[0, ..., :3]):
        assert np.abs(rgb - FLESH)[inside].max() < 0.1
    assert Source.of(face([]), True).bare.even.rgb.mean() == pytest.approx(bare.even.rgb.mean(), abs=0.01)


@pytest.mark.parametrize("horizontal", [True, False])
def test_cuts_show_as_many_seeds_as_pictures_and_as_large(horizontal: bool) -> None:
    """Ellipsoids by Saltykov's rule: in held-out planes, as many cuts per area as in the picture, and of the same area;
    in radial ones where the picture has them."""
    places = around(16) if horizontal else [(0.5, y, 0.0) for y in np.linspace(-0.5, 0.5, 9)]
    things = [found(face(places), horizontal).things(face(places))]
    counts, areas = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        made = pack(things, [], strewn(things, int(horizontal), CANDIDATES, rng, in_rows=True), all_of, rng)
        assert made is not None
        size = 400
        at = ((np.arange(size) + 0.5) / size * 2 - 1).astype(np.float32)
        u, v = np.meshgrid(at, at, indexing="ij")
        flat = np.full_like(u, 0.1)
        points = np.stack([u, v, flat] if horizontal else [u, flat * 0, v], -1).reshape(-1, 3)
        cover = made.read(points)[1].reshape(size, size) > 0.5
        _, count = ndimage.label(cover)
        counts.append(count)
        areas.append(cover.sum() * (2 / size) ** 2 / max(count, 1))
    assert np.mean(counts) == pytest.approx(len(places), rel=0.2)
    assert np.mean(areas) == pytest.approx(np.pi * AXES[0] * AXES[1], rel=0.2)


def test_a_seed_is_whole_in_every_plane_through_it() -> None:
    """Its cuts are convex and dark throughout: an ellipse along the picture, a disc across its longer axis."""
    disc = face([(0.5, 0.0, 0.0)])
    seeds = found(disc)
    things = [seeds.things(disc)]
    laid = in_own_planes(things, [0.0], 0)[0].laid
    made = pack(things, [laid], laid.chosen(np.zeros(0, int)), all_of, np.random.default_rng(0))
    assert made is not None
    middle, (long, short) = laid.middles[0], seeds.axes[0]
    assert middle == pytest.approx([0.5, 0, 0], abs=0.01)
    turns = np.linspace(0, 2 * np.pi, 90)
    for first, second, half in ((0, 1, (long, short)), (0, 2, (long, short)), (1, 2, (short, short))):
        for share, inside in ((0.85, True), (1.15, False)):
            points = np.repeat(middle[None], len(turns), 0)
            points[:, first] += share * half[0] * np.cos(turns)
            points[:, second] += share * half[1] * np.sin(turns)
            rgb, cover = made.read(points.astype(np.float32))
            assert (cover > 0.5).mean() > 0.95 if inside else (cover < 0.5).mean() > 0.95
            if inside:
                assert np.abs(rgb - SEED * cover[:, None]).max(1).mean() < 0.15


@pytest.fixture(scope="module")
def grown() -> Quilt:
    """A quilt of two fruits: the first has seeds around the axis, the second in rows half way out."""
    rows = [(x, y, 0.0) for x in (-0.5, 0.5) for y in (-0.2, 0.0, 0.2)]
    return coarse_quilt(face(around(8)), face(rows))


def dark(made: Quilt, points: NDArray[np.floating]) -> NDArray[np.bool_]:
    return made.read(points.astype(np.float32))[:, 1] < 0.2


def test_own_planes_show_their_seeds_where_they_are(grown: Quilt) -> None:
    for u, v, _ in around(8):
        if abs(v) > 0.1:  # away from the radial picture's plane
            assert dark(grown, np.array([[u, v, 0.0]])).all()
    assert dark(grown, np.array([[0.5, 0.0, 0.2], [-0.5, 0.0, 0.2], [0.5, 0.0, -0.2]])).all()


def test_seeds_lie_where_both_pictures_have_them(grown: Quilt) -> None:
    """In rings around the axis, at the heights of the radial picture; nowhere else in the flesh."""
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (200_000, 3))
    points = points[np.linalg.norm(points, axis=1) < 0.8]
    there = dark(grown, points)
    radius = np.hypot(*points[:, :2].T)
    assert there.sum() > 100
    assert (np.abs(radius[there] - RING) < 0.2).mean() > 0.98
    assert (np.abs(points[there, 2]) < 0.4).mean() > 0.8  # 0.45 if heights were ignored


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [("watermelon_h8", 24, 30), ("watermelon_v11", 7, 12), ("apple_h1", 0, 0), ("orange_v4", 0, 0)],
)
def test_of_photographs_seeds_are_found_and_stars_and_cores_are_none(name: str, least: int, most: int) -> None:
    assert least <= len(found(photograph(name), "_h" in name).places) <= most


def test_things_of_no_picture_are_none() -> None:
    empty = Seeds.none().things(face([]))
    assert isinstance(empty, Things)
    rng = np.random.default_rng(0)
    assert pack([empty], [], strewn([empty], 1, CANDIDATES, rng, in_rows=True), all_of, rng) is None


def test_balls_that_radial_cuts_show_are_as_many_wherever_they_lie() -> None:
    """Uniform in a ball: as many are strewn as there are, as often near the poles and the axis as elsewhere."""
    rng, radius = np.random.default_rng(0), 0.03
    middles = rng.uniform(-1, 1, (40_000, 3))
    middles = middles[np.linalg.norm(middles, axis=1) < 0.93]
    laid = []
    for turn in rng.uniform(0, np.pi, 30):
        x = middles[:, 0] * np.cos(turn) + middles[:, 1] * np.sin(turn)
        met = np.abs(middles[:, 1] * np.cos(turn) - middles[:, 0] * np.sin(turn)) < radius
        places = np.stack([x[met], middles[met, 2]], -1).astype(np.float32)
        axes = np.full((len(places), 2), radius / SECTION, np.float32)
        things = Things(places, axes, np.zeros(len(places), np.float32), np.zeros((len(places), 1, 1, 4), np.float32))
        laid.append(strewn([things], 0, 1.0, rng, in_rows=False).middles)
    there = np.concatenate(laid)
    assert len(there) / 30 == pytest.approx(len(middles), rel=0.1)
    for part in (polar, beside_the_axis):
        assert part(there).mean() == pytest.approx(part(middles).mean(), rel=0.15)


def polar(at: NDArray[np.floating]) -> NDArray[np.bool_]:
    return np.abs(at[:, 2]) > 0.6


def beside_the_axis(at: NDArray[np.floating]) -> NDArray[np.bool_]:
    return np.hypot(at[:, 0], at[:, 1]) < 0.25
