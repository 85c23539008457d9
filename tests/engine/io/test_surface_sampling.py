"""Points on any faces: as many as asked for, in a time that does not grow with how the faces lie."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.io.meshes.surface_sampling import scatter


def stacked(copies: int, offset: float) -> NDArray[np.float64]:
    """(copies, 3, 3). The same face repeated, each copy a little above the last."""
    face = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    return face + offset * np.arange(copies)[:, None, None] * [0, 0, 1]


@pytest.mark.parametrize("offset", [0.0, 1e-12, 1e-6])
def test_faces_on_faces_take_no_longer(offset: float) -> None:
    """No longer than three passes for each halving of the distance explain; it was once the square of their number."""

    def seconds(copies: int) -> float:
        start = process_time()
        face, weights = scatter(stacked(copies, offset), 10_000, np.random.default_rng(0))
        assert len(np.unique(np.column_stack([face, weights]), axis=0)) == 10_000
        return process_time() - start

    seconds(1)
    assert seconds(1000) < 12 * min(seconds(1) for _ in range(3)) + 0.5


@pytest.mark.parametrize("width", [1e-6, 1e-20, 1e-60])
def test_needles_and_what_lies_at_their_end_are_sampled(width: float) -> None:
    """A needle has more cells in a row than integers can count; half of the points crowd on a square at its end."""
    side = width**0.5 / 1000
    corner = np.array([[0, 0, 0], [side, 0, 0], [0, side, 0]])
    needle = np.array([[0, 0, 0], [1, 0, 0], [1, width / 1e6, 0]])
    start = process_time()
    face, _ = scatter(np.stack([needle, corner]), 20_000, np.random.default_rng(0))
    assert 0.1 < face.mean() < 0.9
    assert process_time() - start < 10
