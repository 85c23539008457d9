"""Values between the cells of a grid, and cells around cells, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.grid import Grid, read_cells, widened


def scipys(values: NDArray[np.float32], at: NDArray[np.floating]) -> NDArray[np.float32]:
    """Values (X, Y, Z) at places (..., 3) in cells."""
    return ndimage.map_coordinates(values, np.moveaxis(at, -1, 0), order=1, mode="nearest", output=np.float32)


@pytest.mark.parametrize("shape", [(21, 17, 30), (1, 5, 2)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_cells_are_read_as_scipy_does_to_the_bit(shape: tuple[int, int, int], dtype: type) -> None:
    random = np.random.default_rng(0)
    values = random.standard_normal((*shape, 3)).astype(np.float32)
    at: NDArray[np.floating] = random.uniform(-4, 35, (70, 90, 3)).astype(dtype)
    at[:5] = np.round(at[:5])  # on the centres of cells
    found = read_cells(values, at)
    assert found.shape == (70, 90, 3)
    for c in range(3):
        assert np.array_equal(found[..., c], scipys(values[..., c], at))
        assert np.array_equal(read_cells(values[..., c], at[0]), found[0, :, c])
    assert read_cells(values, at[:0]).shape == (0, 90, 3)


def test_world_points_are_read_at_their_cells_to_the_bit() -> None:
    random = np.random.default_rng(1)
    grid = Grid(np.array([0.1, -0.3, 2.0]), 0.037, (21, 17, 30))
    values = random.standard_normal(grid.shape).astype(np.float32)
    points = random.uniform(-1, 4, (5000, 3)).astype(np.float32)
    assert np.array_equal(grid.sample(values, points), scipys(values, grid.index(points)))
    np.testing.assert_allclose(grid.sample(values, grid.centres()), values, atol=1e-4)


def test_what_is_no_number_lies_at_the_border() -> None:
    values = np.arange(8, dtype=np.float32).reshape(2, 2, 2)
    assert read_cells(values, np.array([[np.nan, 1, 0], [np.inf, -np.inf, np.nan]])).tolist() == [2, 4]


@pytest.mark.parametrize("reach", [1, 3])
def test_cells_are_widened_as_by_scipys_filters(reach: int) -> None:
    for shape in ((20, 31, 24), (2, 1, 9)):
        cells = np.random.default_rng(reach).random(shape) < 0.01
        cells[0, 0, -1] = True
        cube = np.ones((2 * reach + 1,) * 3, bool)
        assert np.array_equal(widened(cells, reach), ndimage.binary_dilation(cells, cube))
        assert np.array_equal(~widened(cells, reach), ndimage.binary_erosion(~cells, cube, border_value=1))
