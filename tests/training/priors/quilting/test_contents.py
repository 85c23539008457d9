"""Cores in one piece and what lies in them: against drawn solids, of which two individuals are photographed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.helpers.exemplar_faces import coarse_quilt
from training.priors.exemplar.quilting.disc import Disc, disc_grid
from training.priors.exemplar.quilting.labels import Source
from training.priors.exemplar.quilting.quilt import Quilt
from training.priors.exemplar.quilting.things.core import COMPACT, Core, Profile, find_shape

Solid = Callable[[NDArray[np.floating], int], NDArray[np.floating]]
"""Colours (..., 3) at points (..., 3) of the unit ball, of the individual of a number."""

FLESH, SKIN = np.array([0.95, 0.6, 0.25]), np.array([0.55, 0.6, 0.2])
HOLLOW, SEED = np.array([0.75, 0.4, 0.18]), np.array([0.12, 0.11, 0.1])
WIDE, TALL = 0.42, 0.62
"""Half axes of the hollow."""

SEED_RADIUS = 0.055


def place(x: NDArray[np.floating], y: NDArray[np.floating], *, horizontal: bool) -> NDArray[np.floating]:
    """(..., 3). Places (...), (...) of a picture through the middle of the ball."""
    return np.stack([x, y, 0 * x] if horizontal else [x, 0 * x, y], -1)


def pictured(solid: Solid) -> tuple[Disc, Disc]:
    """The horizontal cut of one individual and the radial one of another."""
    x, y = disc_grid()
    inwards = np.minimum(1, 0.985 / np.maximum(np.hypot(x, y), 1e-6))
    across, along = (solid(place(x * inwards, y * inwards, horizontal=h), n) for n, h in enumerate((True, False)))
    grain = 0.005 * np.random.default_rng(0).standard_normal((*x.shape, 1))
    return Disc((across + grain).astype(np.float32)), Disc((along + grain).astype(np.float32))


def grown(solid: Solid) -> Quilt:
    return coarse_quilt(*pictured(solid))


def seeds_of(number: int) -> NDArray[np.floating]:
    """(B, 3). Middles of seeds, close together on the wall of the hollow."""
    rng = np.random.default_rng(number)
    on_wall = rng.normal(size=(220, 3))
    on_wall /= np.linalg.norm(on_wall, axis=1, keepdims=True)
    return np.asarray(on_wall * [WIDE, WIDE, TALL] * rng.uniform(0.78, 0.86, (220, 1)))


def papaya(points: NDArray[np.floating], number: int) -> NDArray[np.floating]:
    rgb = np.broadcast_to(FLESH, points.shape).copy()
    rgb[np.linalg.norm(points, axis=-1) > 0.95] = SKIN
    rgb[np.linalg.norm(points / [WIDE, WIDE, TALL], axis=-1) < 1] = HOLLOW
    for middle in seeds_of(number):
        rgb[np.linalg.norm(points - middle, axis=-1) < SEED_RADIUS] = SEED
    return rgb


def egg(points: NDArray[np.floating], number: int) -> NDArray[np.floating]:
    """A yolk that is not round, beside the middle, and reaches out to more than half of the radius."""
    turn = np.arctan2(points[..., 1], points[..., 0])
    off = points - [0.12, -0.08 + 0.04 * number, 0.06 * number]
    yolk = np.linalg.norm(off, axis=-1) < 0.53 + 0.03 * np.cos(5 * turn)
    return np.where(yolk[..., None], [0.97, 0.78, 0.25], [0.96, 0.95, 0.92])


def stone(points: NDArray[np.floating], number: int) -> NDArray[np.floating]:
    """A brown stone in a red layer that ends sharply."""
    size = np.linalg.norm(points / [0.4, 0.4, 0.5], axis=-1)[..., None]
    layers = np.where(size < 0.75, [0.5, 0.3, 0.15], np.where(size < 1, [0.75, 0.12, 0.12], FLESH))
    return np.where((np.linalg.norm(points, axis=-1) > 0.95)[..., None], SKIN, layers)


def inside_ball(count: int) -> NDArray[np.float32]:
    """(M, 3). Points all over the ball, but for its skin."""
    points = np.random.default_rng(1).uniform(-0.85, 0.85, (count, 3)).astype(np.float32)
    return points[np.linalg.norm(points, axis=1) < 0.85]


@pytest.fixture(scope="module")
def papayas() -> Quilt:
    return grown(papaya)


def nearest(rgb: NDArray[np.floating], *colours: NDArray[np.floating]) -> NDArray[np.integer]:
    """(M,). Which of the colours each of (M, 3) is closest to."""
    return np.argmin([np.linalg.norm(rgb - colour, axis=1) for colour in colours], axis=0)


def test_a_hollow_lined_with_seeds_is_a_solid_and_its_seeds_lie_in_it(papayas: Quilt) -> None:
    points = inside_ball(60_000)
    kind = nearest(papayas.read(points), FLESH, HOLLOW, SEED)
    size = np.linalg.norm(points / [WIDE, WIDE, TALL], axis=1)
    assert (kind[size < 0.6] == 1).mean() > 0.97
    assert (kind[size < 0.95] > 0).mean() > 0.97
    assert (kind[size > 1.15] == 0).mean() > 0.995
    wanted = nearest(papaya(points, 0), FLESH, HOLLOW, SEED) == 2
    assert 0.25 * wanted.sum() < (kind == 2).sum() < 1.5 * wanted.sum()


def test_seeds_that_touch_are_parted_and_none_runs_along_the_hollow(papayas: Quilt) -> None:
    """No cut shows a seed much longer than a seed is, away from the pictures' planes."""
    laid = papayas.seeds
    assert laid is not None
    assert len(laid.laid.stamps) > 40
    assert np.quantile(laid.laid.axes[:, 0], 0.9) < 2 * SEED_RADIUS


def test_a_large_core_that_is_not_round_is_one_solid() -> None:
    points = inside_ball(40_000)
    made = grown(egg)
    is_yolk = nearest(made.read(points), np.array([0.96, 0.95, 0.92]), np.array([0.97, 0.78, 0.25])) == 1
    length = np.linalg.norm(points - [0.12, -0.06, 0.03], axis=1)
    assert is_yolk[length < 0.42].mean() > 0.99
    assert is_yolk[length > 0.66].mean() < 0.01


def test_a_core_beside_the_axis_is_an_ellipsoid_around_its_own_middle() -> None:
    """In all of its cuts; in one, its colours are looked at as well: rings, as its picture has."""
    x, y = disc_grid()
    middle, (a, b), tall = (0.12, -0.07), (0.3, 0.22), 0.4
    size = np.hypot((x - middle[0]) / a, (y - middle[1]) / b)
    rings = Disc(np.repeat((0.5 + 0.5 * np.sin(6 * size))[..., None], 3, -1).astype(np.float32))
    level = disc_grid()[1][0]
    core = Core.in_one_piece(size < 1, Profile.of(np.sqrt(np.maximum(1 - np.square(level / tall), 0)), 0.0, 1.5))
    for rise in (0.0, 0.15, 0.25, 0.35):
        rgb, deep = core.read(rings, x.ravel(), y.ravel(), np.full(x.size, rise))
        inside = deep.reshape(x.shape) > 0
        width = np.sqrt(1 - (rise / tall) ** 2)
        assert inside.sum() == pytest.approx((size < width).sum(), rel=0.04)
        assert (x[inside].mean(), y[inside].mean()) == pytest.approx(middle, abs=0.004)
        if rise == 0.25:
            wanted = 0.5 + 0.5 * np.sin(6 * np.hypot(size, rise / tall))
            at = inside & (size > 0.3)  # closer to the middle directions fade
            assert np.abs(rgb[:, 0].reshape(x.shape) - wanted)[at].mean() < 0.05


def test_a_layer_around_a_stone_is_no_row_of_seeds() -> None:
    made = grown(stone)
    assert made.seeds is None
    points = inside_ball(40_000)
    size = np.linalg.norm(points / [0.4, 0.4, 0.5], axis=1)
    kind = nearest(made.read(points), FLESH, np.array([0.75, 0.12, 0.12]), np.array([0.5, 0.3, 0.15]))
    assert (kind[size < 0.65] == 2).mean() > 0.97
    assert (kind[(size > 0.82) & (size < 0.93)] == 1).mean() > 0.9
    assert (kind[size > 1.1] == 0).mean() > 0.99


def test_pale_seeds_do_not_part_a_hollow() -> None:
    """Between a hollow and seeds that are paler than the flesh lies the colour of flesh."""
    x, y = disc_grid()
    rgb = np.where((np.hypot(x, y) < 0.4)[..., None], [0.9, 0.5, 0.2], np.array([0.97, 0.65, 0.32]))
    for u, v in np.random.default_rng(2).uniform(-0.26, 0.26, (60, 2)):
        blend = np.clip((1 - np.hypot((x - u) / 0.05, (y - v) / 0.03)) * 6, 0, 1)[..., None]
        rgb = rgb + blend * ([0.95, 0.88, 0.65] - rgb)
    shape = find_shape(Disc(rgb.astype(np.float32)), 0.05)
    assert shape is not None
    truth = np.hypot(x, y) < 0.4
    assert (shape & truth).sum() > 0.97 * (shape | truth).sum()


def test_a_face_keeps_its_contents_in_its_own_plane_alone(papayas: Quilt) -> None:
    across, _ = pictured(papaya)
    source = papayas.labels[0].sources[0]
    assert isinstance(source, Source)
    assert isinstance(source.core, Core)
    assert source.core.ground is not None
    assert source.core.shape.mean() / (np.pi * WIDE**2 / 2.2**2) == pytest.approx(1, abs=0.05)
    assert source.core.shape.sum() > COMPACT * source.core.region.sum()
    shown = source.core.ground.rgb[source.core.shape]
    assert np.linalg.norm(shown - HOLLOW, axis=1).max() < 0.2  # no seed is left
    x, y = (a[::3, ::3].ravel() for a in disc_grid())
    inside = (np.hypot(x, y) < 0.35) & (np.abs(y) > 0.08)
    read = papayas.read(place(x[inside], y[inside], horizontal=True).astype(np.float32))
    is_seed = nearest(read, FLESH, HOLLOW, SEED) == 2
    wanted = nearest(across.read(x[inside], y[inside]), FLESH, HOLLOW, SEED) == 2
    assert (is_seed != wanted).mean() < 0.04
