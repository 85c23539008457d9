"""Values between pixels, and what else is done to pictures, against SciPy and NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from training.priors.exemplar.sampling import lengths, opened, resampled


@pytest.mark.parametrize("reach", [1, 3])
def test_an_opening_is_scipys(reach: int) -> None:
    mask = ndimage.gaussian_filter(np.random.default_rng(reach).standard_normal((60, 71)), 1.5) > -0.05
    mask[:20, :9] = True  # lies on the border
    y, x = np.ogrid[-reach : reach + 1, -reach : reach + 1]
    found = opened(mask, reach)
    assert np.array_equal(found, ndimage.binary_opening(mask, x * x + y * y <= reach * reach))
    assert 0.1 < found.mean() < mask.mean()


def test_a_picture_is_enlarged_as_scipy_does() -> None:
    values = np.random.default_rng(0).random((11, 13, 2), np.float32)
    at = (np.arange(40) + 0.5) * 0.3 - 0.5
    rows, columns = np.meshgrid(at, at, indexing="ij")
    wanted = np.stack(
        [
            ndimage.map_coordinates(values[..., c].astype(np.float64), [rows, columns], order=1, mode="nearest")
            for c in (0, 1)
        ],
        -1,
    )
    assert np.abs(resampled(values, 40, 0.3) - wanted).max() < 1e-5


def test_lengths_are_numpys_to_the_bit() -> None:
    vectors = np.random.default_rng(0).standard_normal((4, 50, 3)).astype(np.float32)
    assert np.array_equal(lengths(vectors), np.linalg.norm(vectors, axis=-1))
