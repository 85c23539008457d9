"""Sliding medians equal SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from training.priors.exemplar.medians import Ranks


@pytest.mark.parametrize("radius", [1.0, 3.4, 6.0])
def test_they_are_the_bits_of_scipy(radius: float) -> None:
    values = ndimage.gaussian_filter(np.random.default_rng(0).random((37, 52, 3)), (2, 2, 0)).astype(np.float32)
    values[:9, :, 1] = 0.5  # ties
    reach = int(radius)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    around = np.hypot(x, y) <= radius
    want = [ndimage.median_filter(values[..., c], footprint=around, mode="nearest") for c in range(3)]
    np.testing.assert_array_equal(Ranks.of(values).medians(around.sum(1) // 2), np.stack(want, -1))


def test_one_colour_stays() -> None:
    values = np.full((5, 6, 2), 0.25, np.float32)
    np.testing.assert_array_equal(Ranks.of(values).medians(np.array([4])), values)
