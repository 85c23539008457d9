"""Values between pixels, and what else is done to pictures, against SciPy and NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from engine.threads import for_each
from training.priors.exemplar.sampling import lengths, opened, read_as_scipy, resampled
from training.priors.exemplar.sharpen import sharpen_layer


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


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_picture_is_read_as_scipy_does_to_the_bit(dtype: type) -> None:
    random = np.random.default_rng(1)
    values: NDArray[np.floating] = random.standard_normal((31, 47, 3)).astype(dtype)
    rows, columns = random.uniform(-5, 60, (2, 90, 80)).astype(dtype)
    rows[0, :47], columns[0, :47] = 30, np.arange(47)  # on pixels of the last row
    rows[1, :31], columns[1, :31] = np.arange(31), 46
    wanted = [
        ndimage.map_coordinates(values[..., c], [rows, columns], order=1, mode="nearest", output=np.float32)
        for c in range(3)
    ]
    assert np.array_equal(read_as_scipy(values, rows, columns), np.stack(wanted, -1))
    assert np.array_equal(read_as_scipy(values[:, ::2], rows[0], columns[0])[:, 1],
                          ndimage.map_coordinates(values[:, ::2, 1], [rows[0], columns[0]], order=1, mode="nearest",
                                                  output=np.float32))  # fmt: skip


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_lengths_are_numpys_to_the_bit(dtype: type) -> None:
    vectors: NDArray[np.floating] = np.random.default_rng(0).standard_normal((4, 500, 4)).astype(dtype)
    for some in (vectors[..., :3], vectors[::2, :, 1:], np.ascontiguousarray(vectors[..., :3])):
        assert np.array_equal(lengths(some), np.linalg.norm(some, axis=-1))
        assert lengths(some).dtype == dtype


def test_a_volume_is_sharpened_within_scipys_range_of_its_neighbours_to_the_bit() -> None:
    rgb = np.random.default_rng(0).random((19, 24, 31, 3), np.float32)
    values, gain, found = np.ascontiguousarray(rgb[..., 1]), np.float32(1.7342318), np.zeros_like(rgb)
    edge = values - ndimage.gaussian_filter(values, 0.8)
    for_each(sharpen_layer, len(values), values, edge, gain, found[..., 1])
    low, high = ndimage.minimum_filter(values, 3), ndimage.maximum_filter(values, 3)
    assert np.array_equal(found[..., 1], np.clip(np.clip(values + gain * edge, low, high), 0, 1))
    assert not found[..., ::2].any()
