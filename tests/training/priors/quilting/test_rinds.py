"""Evening out the rinds of all pictures: against drawn rinds of known depth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.helpers.exemplar_faces import photograph
from training.priors.exemplar.quilting import quilt
from training.priors.exemplar.quilting.chunks import Ball, Depths
from training.priors.exemplar.quilting.disc import Disc, disc_grid
from training.priors.exemplar.quilting.labels import Source, depths_of
from training.priors.exemplar.quilting.quilt import make_quilt
from training.priors.exemplar.quilting.rinds import ANGLES, Rinds
from training.priors.exemplar.quilting.things.core import Core

FLESH, RIND = np.array([0.9, 0.3, 0.3]), np.array([0.8, 0.9, 0.5])
HEIGHT = 0.1


def drawn(thin: float, thick: float) -> Disc:
    """Flesh in a rind that is thick to the right and thin to the left."""
    x, y = disc_grid()
    depth = thin + (thick - thin) * (1 + x / np.maximum(np.hypot(x, y), 1e-6)) / 2
    rgb = np.where((1 - np.hypot(x, y) < depth)[..., None], RIND, FLESH)
    return Disc(rgb.astype(np.float32))


@pytest.fixture(scope="module")
def pictures() -> tuple[Disc, Disc]:
    return drawn(0.08, 0.16), drawn(0.14, 0.22)


@pytest.fixture(scope="module")
def rinds(pictures: tuple[Disc, Disc]) -> Rinds:
    return Rinds.of(pictures[:1], pictures[1:], HEIGHT, 1)


def is_rind(rgb: NDArray[np.float32]) -> NDArray[np.bool_]:
    return rgb[..., 1] > 0.6


def in_plane(at: NDArray[np.floating], horizontal: bool) -> NDArray[np.float32]:
    """(M, 3). Places (M, 2) of a picture, in its own plane through the middle."""
    x, y = at.T
    zero = np.zeros_like(x)
    return np.stack([x, y, zero] if horizontal else [x, zero, y], -1).astype(np.float32)


def test_depths_are_measured(rinds: Rinds) -> None:
    turn = np.arange(ANGLES) / ANGLES * 2 * np.pi
    for depths, thin, thick in ((rinds.across[0], 0.08, 0.16), (rinds.along[0], 0.14, 0.22)):
        wanted = thin + (thick - thin) * (1 + np.cos(turn)) / 2
        assert np.abs(depths - wanted).max() < 0.012


def test_quilted_pictures_have_one_rind(rinds: Rinds, pictures: tuple[Disc, Disc]) -> None:
    """It has the average depth on the equator of both, and the same depth on both sides of the radial one."""
    for disc, depths, horizontal in ((pictures[0], rinds.across[0], True), (pictures[1], rinds.along[0], False)):
        even = rinds.even(disc, depths, horizontal)
        depth = np.arange(0, 0.4, 0.001)
        for turn in (0, np.pi):
            ray = even.read((1 - depth) * np.cos(turn), (1 - depth) * np.sin(turn))
            assert is_rind(ray).sum() * 0.001 == pytest.approx(0.15, abs=0.012)


@pytest.mark.parametrize("horizontal", [True, False])
def test_own_planes_show_their_pictures_as_they_are(
    horizontal: bool, rinds: Rinds, pictures: tuple[Disc, Disc]
) -> None:
    """Except where planes of both families meet; the horizontal one keeps its height all around."""
    disc, depths = (pictures[0], rinds.across[0]) if horizontal else (pictures[1], rinds.along[0])
    even = rinds.even(disc, depths, horizontal)
    rng = np.random.default_rng(0)
    radius, turn = np.sqrt(rng.uniform(0.3, 0.98, 4000)), rng.uniform(0, 2 * np.pi, 4000)
    turn = turn[np.abs(np.sin(turn if horizontal else turn - np.arcsin(HEIGHT))) > 0.2]
    at = np.stack([radius[: len(turn)] * np.cos(turn), radius[: len(turn)] * np.sin(turn)], -1)
    points = in_plane(at, horizontal)
    if horizontal:  # at the picture's height, at the same angles and distances from the middle
        points = np.column_stack([at * np.sqrt(1 - HEIGHT**2), HEIGHT * np.hypot(*at.T)]).astype(np.float32)
    moved = rinds.evened(points)
    scale = np.linalg.norm(moved, axis=1) / np.linalg.norm(points, axis=1)
    shown = even.read(*(at * scale[:, None]).T)
    assert (is_rind(shown) != is_rind(disc.read(*at.T))).mean() < 0.03


def test_at_every_height_horizontal_pictures_have_the_rind_of_radial_ones() -> None:
    """It is thin at the poles. Otherwise the plane of a radial picture would be a notch in the rind beside it."""
    x, y = disc_grid()
    length = np.maximum(np.hypot(x, y), 1e-6)
    thin_ends = Disc(np.where((1 - length < 0.2 - 0.12 * (y / length) ** 2)[..., None], RIND, FLESH).astype(np.float32))
    even_all_around = drawn(0.16, 0.16)
    rinds = Rinds.of([even_all_around], [thin_ends], HEIGHT, 1)
    even = rinds.even(even_all_around, rinds.across[0], True)
    depth = np.arange(0, 0.4, 0.001)
    for up in np.radians([-65, -45, -20, 0, 30, 55]):
        direction = np.array([0, np.cos(up), np.sin(up)])
        ball = Ball.of(((1 - depth)[:, None] * direction).astype(np.float32), rinds)
        wanted = np.interp(np.degrees(up) % 360, np.arange(ANGLES), rinds.usual)
        assert is_rind(even.read(*ball.level.T)).sum() * 0.001 == pytest.approx(wanted, abs=0.012)


def test_a_thick_rind_is_as_thick_near_the_poles() -> None:
    thick = drawn(0.25, 0.25)
    rinds = Rinds.of([thick], [thick], 0.0, 1)
    depth = np.arange(0, 0.4, 0.001)
    for up in np.radians([-70, -50, 25, 65]):
        direction = np.array([0, np.cos(up), np.sin(up)])
        ball = Ball.of(((1 - depth)[:, None] * direction).astype(np.float32), rinds)
        assert is_rind(thick.read(*ball.level.T)).sum() * 0.001 == pytest.approx(0.25, abs=0.012)


def test_horizontal_pictures_are_read_by_depth_where_their_colours_go_by_it() -> None:
    """As a radial picture shows; at the horizontal one's own height they are read as they are, whatever it is."""
    x, y = disc_grid()
    radius = np.minimum(np.hypot(x, y), 1)[..., None]

    def toned(amount: NDArray[np.floating]) -> Source:
        rgb = np.where(np.hypot(x, y)[..., None] > 0.95, RIND, FLESH + amount * [-0.5, 0.4, 0])
        return Source.of(Disc(rgb.astype(np.float32)), is_horizontal=amount is across).with_core(Core.none())

    across = np.square(radius)
    by_share = np.minimum(np.abs(x) / np.sqrt(np.maximum(1 - y * y, 0.01)), 1)[..., None]
    rinds = Rinds.of([drawn(0.05, 0.05)], [drawn(0.05, 0.05)], HEIGHT, 1)
    horizontal = toned(across)
    assert depths_of([horizontal], [toned(radius * radius)], rinds) is Depths.KEPT
    assert depths_of([horizontal], [toned(np.square(by_share))], rinds) is Depths.SHARED
    assert depths_of([horizontal], [], rinds) is Depths.SHARED
    out = np.linspace(0.1, 0.9, 9) * np.sqrt(1 - HEIGHT**2)
    points = np.stack([out, 0 * out, np.full(9, HEIGHT)], -1).astype(np.float32)
    for depths in Depths:
        at = Ball.of(points, rinds, depths).level[:, 0]
        assert at == pytest.approx(np.linspace(0.1, 0.9, 9), abs=0.005)


def test_between_planes_a_rind_has_no_step(rinds: Rinds) -> None:
    """Far from all planes it has the depth common to the pictures."""
    turn = np.linspace(0, 2 * np.pi, 721)
    points = np.stack([0.87 * np.cos(turn), 0.87 * np.sin(turn), np.full_like(turn, -0.4)], -1)
    points *= 0.86 / np.linalg.norm(points, axis=1)[:, None]
    length = np.linalg.norm(rinds.evened(points.astype(np.float32)), axis=1)
    assert np.abs(np.diff(length)).max() < 0.004
    assert np.ptp(length) > 0.02
    pole = np.array([[0.0, 0.84, -0.1], [0.0, -0.84, -0.1]], np.float32)
    assert np.abs(np.linalg.norm(rinds.evened(pole), axis=1) - np.linalg.norm(pole, axis=1)).max() < 0.02


def test_what_is_deep_or_outside_stays(rinds: Rinds) -> None:
    points = np.random.default_rng(0).standard_normal((500, 3)).astype(np.float32)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    for length in (0.0, 0.2, 1.0, 1.05):
        assert rinds.evened(length * points) == pytest.approx(length * points, abs=1e-6)


def test_alike_rinds_are_left_alone() -> None:
    plain = drawn(0.12, 0.12)
    rinds = Rinds.of([plain], [plain], 0.0, 1)
    points = np.random.default_rng(0).uniform(-0.57, 0.57, (2000, 3)).astype(np.float32)
    assert np.abs(rinds.evened(points) - points).max() < 0.01
    assert np.abs(rinds.even(plain, rinds.across[0], True).rgb - plain.rgb).mean() < 0.01


def test_each_radial_picture_has_its_own_plane() -> None:
    """The second picture of two is at a right angle to the first, however many there may be."""
    thin, thick = drawn(0.1, 0.1), drawn(0.2, 0.2)
    rinds = Rinds.of([], [thin, thick], 0.0, 3)
    points = 0.85 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], np.float32)
    depth = 1 - np.linalg.norm(rinds.evened(points), axis=1)
    assert depth[:2] == pytest.approx(0.195, abs=0.02)  # under a thin rind: half of the way from 0.1 to 0.3 in REACH
    assert depth[2:] == pytest.approx(0.1125, abs=0.012)  # three quarters of a thick one


@pytest.mark.parametrize("pair", [("orange_h1", "orange_v6"), ("orange_h6", "orange_v4"), ("orange_h4", "orange_v2")])
def test_of_photographs_a_rind_goes_all_around(pair: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """At the poles as well, where the pith of radial pictures widens into it."""
    monkeypatch.setattr(quilt, "LEVELS", (16, 32))
    made = make_quilt([photograph(pair[0])], [photograph(pair[1])], 0, lambda part: None)
    up = np.random.default_rng(0).normal(size=(20_000, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    up = up[np.abs(up[:, 2]) < 0.98]  # beyond lies the stem
    within = 1 - 0.8 * made.rinds.at(up.astype(np.float32), np.ones(len(up)))
    shown = made.read_evened((within[:, None] * up).astype(np.float32))
    pale = shown[:, 2] > 0.5 * shown[:, 0]
    for low, high in ((0, 0.4), (0.4, 0.7), (0.7, 0.85), (0.85, 0.93), (0.93, 0.98)):
        assert pale[(np.abs(up[:, 2]) >= low) & (np.abs(up[:, 2]) < high)].mean() > 0.9
