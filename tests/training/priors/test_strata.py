"""Texture in layers around an axis."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from training.priors.exemplar.strata import Fan

THICKNESS = 0.03
FAN = Fan(THICKNESS, 1.0)


def shown(radius: NDArray[np.floating], turn: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M,). A fan at places of a plane, whose layers each have a number of their own, of standard deviation 1."""
    numbers = np.random.default_rng(0).standard_normal((FAN.count, 3)).astype(np.float32)
    rgb = FAN.read(radius, turn, np.zeros(len(radius)), lambda layer, rows: numbers[layer])
    return rgb[:, 0]


@pytest.mark.parametrize("radius", [0.05, 0.11, 0.25, 0.5, 0.9])
def test_layers_around_an_axis_are_as_thick_near_it_as_under_the_skin(radius: float) -> None:
    turn = np.arange(100_000) / 100_000
    found = shown(np.full(len(turn), radius), turn)
    blends = np.diff(found, append=found[:1]) != 0
    borders = np.count_nonzero(blends & ~np.roll(blends, 1))
    assert 0.7 < 2 * np.pi * radius / borders / THICKNESS < 1.42  # twice as many where the radius has doubled


def test_a_fan_has_no_seam_where_a_turn_ends() -> None:
    radius = np.linspace(0.01, 1, 500)
    assert np.array_equal(shown(radius, np.zeros(500)), shown(radius, np.ones(500)))


def test_a_fan_keeps_the_strength_of_its_texture() -> None:
    x, y = np.random.default_rng(1).uniform(-1, 1, (2, 200_000))
    inside = np.hypot(x, y) < 1
    found = shown(np.hypot(x, y)[inside], np.arctan2(y, x)[inside] / (2 * np.pi))
    assert found.std() == pytest.approx(1, abs=0.05)
