"""Points beside own planes, against geometry written plainly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from training.priors.exemplar.quilting.chunks import Ball, OwnAzimuths, OwnHeight
from training.priors.exemplar.quilting.disc import PIXEL
from training.priors.exemplar.quilting.films import Beside

CELL = 2 / 96


def points(count: int = 2_000) -> NDArray[np.float32]:
    return np.random.default_rng(0).uniform(-0.7, 0.7, (count, 3)).astype(np.float32)


@pytest.mark.parametrize("pictures", [0, 1, 2, 3])
def test_a_step_back_along_the_normal_leads_to_the_nearest_plane(pictures: int) -> None:
    rng = np.random.default_rng(0)
    chunks = OwnAzimuths(pictures, rng) if pictures else OwnHeight(0.1, np.zeros((8, 8), np.float32), rng)
    at = points()
    far, normals = chunks.off(at)
    np.testing.assert_allclose(np.abs(far), chunks.distance(Ball.of(at)), atol=1e-6)
    assert chunks.distance(Ball.of(at - far[:, None] * normals)).max() < 1e-6


def test_labels_come_closer_and_stay_in_order() -> None:
    heights = np.linspace(-0.2, 0.2, 2_001).astype(np.float32)
    column = np.stack([np.full_like(heights, 0.3), np.full_like(heights, 0.4), heights], -1)
    beside = Beside(np.array([0], np.int32), heights[None], [np.array([[0, 0, 1]], np.float32)])
    for film in (0.0, 0.01, 1.0):
        there = beside.beyond_films(column, film, CELL)
        assert (there[:, :2] == column[:, :2]).all()
        assert (np.diff(there[:, 2]) > 0).all()
        half = min(max(film, PIXEL) / 2, CELL)
        # The film's own border, a cell from the plane, is shown at half of its thickness; far away nothing moves.
        assert np.interp(half, heights, there[:, 2]) == pytest.approx(CELL, abs=2e-4)
        away = np.abs(heights) > 3 * CELL
        assert (there[away] == column[away]).all()
