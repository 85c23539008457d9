"""Closed things as solids, membranes as walls and texture in layers: against discs, lines and stripes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.chunks import Ball, OwnHeight, Places
from training.priors.exemplar.quilting.disc import Disc, disc_grid
from training.priors.exemplar.quilting.labels import Label, Source
from training.priors.exemplar.quilting.relief import Relief
from training.priors.exemplar.quilting.texture import TextureField
from training.priors.exemplar.quilting.things.core import Core
from training.priors.exemplar.sampling import reduced

FLESH, SEED = np.array([0.9, 0.5, 0.3]), np.array([0.2, 0.1, 0.1])


def relief(dark: NDArray[np.bool_]) -> Relief:
    """The relief of dark places on plain flesh."""
    x, _ = disc_grid()
    rgb = np.where(dark[..., None], SEED, FLESH).astype(np.float32)
    return Relief.of(Disc(rgb), Disc(np.full((*x.shape, 3), 0.1, np.float32)), 0.05)


def dark_share(made: Relief, radius: float, distance: float) -> float:
    """Dark share of a disc around the middle, at this distance from the plane."""
    x, y = disc_grid()
    rows = np.hypot(x, y) < radius
    shown = made.read(x[rows], y[rows], np.full(rows.sum(), distance))
    return float((shown[:, 0] < 0.55).mean())


@pytest.mark.parametrize("half_width", [0.04, 0.08, 0.12])
def test_a_round_thing_is_as_tall_as_it_is_wide(half_width: float) -> None:
    """Its volume is that of a ball within a third, and nothing is left of it at twice its half width."""
    x, y = disc_grid()
    made = relief(np.hypot(x, y) < half_width)
    heights = np.linspace(0, 2 * half_width, 41)
    areas = [dark_share(made, 1.5 * half_width, height) * np.pi * (1.5 * half_width) ** 2 for height in heights]
    assert 2 * np.trapezoid(areas, heights) == pytest.approx(4 / 3 * np.pi * half_width**3, rel=0.35)
    assert areas[0] == pytest.approx(np.pi * half_width**2, rel=0.05)
    assert areas[-1] == 0
    assert all(b <= a + 1e-9 for a, b in pairwise(areas))


def test_of_a_star_flesh_is_left() -> None:
    """A median as wide as the arms are long has half of their colour: a grey smudge from pole to pole."""
    x, y = disc_grid()
    dark = np.zeros(x.shape, bool)
    for turn in np.arange(5) * 2 * np.pi / 5:
        s, t = x * np.cos(turn) + y * np.sin(turn) - 0.11, y * np.cos(turn) - x * np.sin(turn)
        dark |= np.hypot(s / 0.1, t / 0.045) < 1
    made, middle = relief(dark), np.hypot(x, y) < 0.22
    at = x[middle], y[middle]
    assert (made.read(*at, np.zeros(middle.sum()))[:, 0] < 0.55).mean() > 0.3
    shown = made.read(*at, np.full(middle.sum(), 0.4))[:, :3]
    assert np.abs(shown - FLESH).max() < 0.05


def test_what_lies_in_a_thing_gives_way_to_that_thing() -> None:
    """Around a seed in a pale carpel, the carpel remains first, then flesh."""
    x, y = disc_grid()
    radius = np.hypot(x, y)
    rgb = np.where((radius < 0.1)[..., None], 1.0, FLESH)
    rgb = np.where((radius < 0.03)[..., None], SEED, rgb).astype(np.float32)
    made = Relief.of(Disc(rgb), Disc(np.full_like(rgb, 0.1)), 0.05)
    middle = np.zeros(1)
    shown = [made.read(middle, middle, np.full(1, t))[0, :3] for t in (0.0, 0.06, 0.2)]
    for colour, wanted in zip(shown, (SEED, np.ones(3), FLESH), strict=True):
        assert np.abs(colour - wanted).max() < 0.05


def test_a_star_takes_its_seeds_along() -> None:
    """In arms full of red seeds no calm colour can replace a seed, but the whole star lies in flesh."""
    x, y = disc_grid()
    radius, turn = np.hypot(x, y), np.arctan2(y, x) * 5 / (2 * np.pi)
    across = np.abs(turn - np.round(turn)) * 2 * np.pi / 5 * radius
    arms = np.hypot((radius - 0.09) / 0.07, across / 0.035) < 1
    red = np.sin(np.pi * x / 0.012) * np.sin(np.pi * y / 0.012) > 0
    rgb = np.where(arms[..., None], np.where(red[..., None], [0.6, 0.1, 0.1], SEED), FLESH).astype(np.float32)
    made = Relief.of(Disc(rgb), Disc(np.full_like(rgb, 0.1)), 0.05)
    there = dark_share(made, 0.2, 0.0)
    assert there > 0.15
    assert dark_share(made, 0.2, 0.3) < 0.02 * there


def test_a_rind_does_not_close_where_it_is_uneven() -> None:
    """Between segments it reaches further in, which by themselves would be closed things."""
    x, y = disc_grid()
    radius = np.hypot(x, y)
    rgb = np.where((radius > 0.85 - 0.05 * np.cos(10 * np.arctan2(y, x)))[..., None], 1.0, FLESH).astype(np.float32)
    made = Relief.of(Disc(rgb), Disc(np.full_like(rgb, 0.1)), 0.16)
    turn = np.linspace(0, 2 * np.pi, 360)
    at = 0.86 * np.cos(turn), 0.86 * np.sin(turn)
    own, beside = (made.read(*at, np.full(360, away))[:, :3] for away in (0.0, 0.4))
    assert np.abs(own - beside).max() < 1e-6


def test_what_is_laid_whole_gives_way_to_its_surroundings_at_once() -> None:
    """Medians among dark things are dark between them, and would be lines along the plane."""
    x, y = disc_grid()
    dark = np.abs(np.hypot(x, y) - 0.11) < 0.07
    rgb = np.where(dark[..., None], SEED, FLESH).astype(np.float32)
    near = np.hypot(x, y) < 0.25
    made = relief(dark).closing(Disc(rgb), Disc(np.full_like(rgb, 0.1)), near, dark)
    flesh = np.hypot(x, y) < 0.02
    for away in np.linspace(0, 0.05, 26):
        shown = made.read(x[flesh], y[flesh], np.full(flesh.sum(), away))[:, :3]
        assert np.abs(shown - FLESH).max() < 0.02


def test_what_is_dense_does_not_turn_to_mush() -> None:
    """In cells among cells the median is the colour of none, so their picture stays as it is."""
    x, y = disc_grid()
    dark = (np.floor(x / 0.08) + np.floor(y / 0.08)) % 2 == 0
    made = relief(dark)
    rows = np.hypot(x, y) < 0.5
    for distance in (0.04, 0.1, 0.15):
        shown = made.read(x[rows], y[rows], np.full(rows.sum(), distance))
        assert np.abs(shown[:, 0] - np.where(dark[rows], SEED[0], FLESH[0])).mean() < 0.1


def striped() -> Disc:
    """Texture of mean square 1 that is eight times as long along y as along x."""
    noise = ndimage.gaussian_filter(np.random.default_rng(0).standard_normal(disc_grid()[0].shape), (2, 16))
    return Disc(np.repeat((noise / noise.std())[..., None] / np.sqrt(3), 3, -1).astype(np.float32))


def test_a_radial_cut_shows_the_texture_of_radial_pictures() -> None:
    """At any angle, as strong and as long along the axis as in the picture."""
    field = TextureField([striped()], False, np.random.default_rng(1))
    for angle in (0.3, 1.7):
        r, z = np.meshgrid(np.linspace(0.2, 0.6, 200), np.linspace(-0.4, 0.4, 400), indexing="ij")
        points = np.stack([r * np.cos(angle), r * np.sin(angle), z], -1).reshape(-1, 3).astype(np.float32)
        shown = field.at(Ball.of(points))[:, 0].reshape(r.shape)
        across, along = np.diff(shown, axis=0).std(), np.diff(shown, axis=1).std()
        assert across > 2 * along  # 1 without lines, less if layers lie across the axis
        assert 3 * np.square(shown).mean() == pytest.approx(1, rel=0.3)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("n", [1, 2, 3, 8])
def test_a_reduced_picture_is_the_plain_mean_bit_for_bit(n: int, channels: int) -> None:
    values = np.random.default_rng(n).random((35, 50, channels + 1), np.float32)
    for picture in (values, values[..., :channels], np.asfortranarray(values)):
        blocks = picture[: 35 // n * n, : 50 // n * n].reshape(35 // n, n, 50 // n, n, -1)
        assert np.array_equal(reduced(picture, n), blocks.mean((1, 3)))


def test_a_membrane_is_even_along_itself_beside_its_picture_and_as_it_is_in_it() -> None:
    """Cut along, its picture's spots would be rings. It leans by 5 degrees."""
    x, y = disc_grid()
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    lean = 0.2 + 0.2 * radius
    across = np.abs((turn - lean + np.pi / 8) % (np.pi / 4) - np.pi / 8) * radius
    spots = 0.85 + 0.15 * np.sign(np.sin(2 * np.pi * radius / 0.12))
    rgb = np.where((across < 0.012)[..., None], spots[..., None], [0.95, 0.55, 0.1])
    rgb = np.where((radius > 0.9)[..., None], [0.95, 0.9, 0.8], rgb)
    source = Source.of(Disc(rgb.astype(np.float32)), True).with_core(Core.none())
    label = Label(OwnHeight(0, source.membranes, np.random.default_rng(0)), [source], True, True)
    along = np.linspace(0.3, 0.75, 200, dtype=np.float32)
    nothing = np.zeros(200, np.float32)
    u, v = (along * axis(0.2 + 0.2 * along).astype(np.float32) for axis in (np.cos, np.sin))
    shown = [
        label.read_even(Places(nothing.astype(np.int64), u, v, np.full(200, away, np.float32), nothing))
        for away in (0.0, 0.3)
    ]
    assert np.abs(shown[0] - source.parts.things.read(u, v)).max() < 1e-5
    assert shown[1].std(0).max() < 0.2 * shown[0].std(0).max()
    assert np.abs(shown[1].mean(0) - shown[0].mean(0)).max() < 0.05


def test_texture_goes_on_in_the_places_of_things() -> None:
    """Layers are shifted, and around a core they would show where it was: a band without any texture."""
    x = disc_grid()[0]
    noise = np.random.default_rng(0).standard_normal((*x.shape, 3))
    texture = ndimage.gaussian_filter(noise, (2, 2, 0)) * (np.abs(x) > 0.15)[..., None]
    texture[np.abs(x) > 0.15] /= texture[np.abs(x) > 0.15].std()
    field = TextureField([Disc(texture.astype(np.float32))], False, np.random.default_rng(1))
    at = np.linspace(-0.5, 0.5, 200, dtype=np.float32)
    contrast = []
    for away in (0.05, 0.1, 0.5):
        around = np.column_stack([np.full(200, away), np.zeros(200), at]).astype(np.float32)
        contrast.append(field.at(Ball.of(around)).std())
    assert min(contrast[:2]) > 0.7 * contrast[2]
