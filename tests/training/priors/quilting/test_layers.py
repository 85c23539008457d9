"""Layers that go all the way in, such as those of an onion, against drawn shells and photographs."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.helpers.exemplar_faces import coarse_quilt, photograph
from training.priors.exemplar.quilting.disc import Disc, disc_grid, disc_radius, evened
from training.priors.exemplar.quilting.quilt import Quilt
from training.priors.exemplar.quilting.rinds import goes_inwards, rind_of

FLESH, SKIN = np.array([0.95, 0.92, 0.88]), np.array([0.6, 0.25, 0.45])
SHELLS = 6


def layers(radius: NDArray[np.floating]) -> NDArray[np.floating]:
    """(..., 3). Colours of an onion at distances (...) from its middle."""
    part = radius * SHELLS % 1
    return np.where(((part < 0.3) | (radius > 0.95))[..., None], SKIN, FLESH)


def drawn(radius: NDArray[np.floating]) -> Disc:
    """A face of it, with some grain."""
    grain = 0.02 * np.random.default_rng(0).standard_normal((*radius.shape, 1))
    return Disc(np.clip(layers(radius) + grain, 0, 1).astype(np.float32))


@pytest.fixture(scope="module")
def onion() -> Quilt:
    return coarse_quilt(drawn(disc_radius()), drawn(disc_radius()))


def test_shells_are_closed(onion: Quilt) -> None:
    """A picture across the axis and one along it: what both show at a depth is there in all directions."""
    points = np.random.default_rng(1).uniform(-1, 1, (20_000, 3)).astype(np.float32)
    radius = np.linalg.norm(points, axis=1)
    points, radius = points[(radius > 0.2) & (radius < 0.9)], radius[(radius > 0.2) & (radius < 0.9)]
    from_edge = np.abs((radius * SHELLS % 1)[:, None] - [0, 0.3, 1]).min(1) / SHELLS
    far = from_edge > 0.015
    off = np.linalg.norm(onion.read(points[far]) - layers(radius[far]), axis=1)
    assert np.mean(off > np.linalg.norm(FLESH - SKIN) / 2) < 0.02


def test_layers_are_neither_spokes_nor_waves_nor_grain() -> None:
    x, y = disc_grid()
    radius, turn = disc_radius(), np.arctan2(y, x)
    assert goes_inwards(drawn(radius), 0.0, 0.06)
    assert goes_inwards(drawn(radius * (1 + 0.03 * np.sin(3 * turn))), 0.0, 0.06)
    for other in (turn / 2 + 1, np.abs(x) * radius, np.ones(x.shape)):
        assert not goes_inwards(drawn(other), 0.0, 0.06)
    assert not goes_inwards(drawn(radius), 0.0, 0.95)  # all rind


@pytest.mark.parametrize("name", ["apple_h3", "watermelon_v1", "orange_v2"])
def test_fruit_is_not_made_of_layers(name: str) -> None:
    """Those photographs that come nearest to it."""
    face, is_horizontal = photograph(name), "_h" in name
    assert not goes_inwards(evened(face, is_horizontal), 0.0, rind_of(face, is_horizontal)[0])
