"""antimatter15's .splat files: 32 bytes per Gaussian, no header, no spherical harmonics above degree 0."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import open_file
from engine.io.splats.rows import gaussians_from_rows, log_sizes, logits, read_rows, row_blocks, stride_for
from engine.scene.gaussians import Gaussians
from engine.scene.sh import rgb_to_sh

__all__ = ["read_splat"]

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
"""Scales are standard deviations; the components of a quaternion, wxyz, are bytes around 128."""


def read_splat(path: str | Path, most: int | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of a .splat, and one line about each kind of row that had to be dropped.

    With `most`, at most that many, evenly chosen. Raises InputError if the size is not a whole number of rows, the
    only check the format allows, or if no row can be used.
    """
    path = Path(path)
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        if not size:
            raise InputError(f"{path}: the file is empty")
        if size % ROW.itemsize:
            raise InputError(
                f"{path}: truncated, or no .splat: {size:,} bytes are no whole number of 32-byte Gaussians"
            )
        count = size // ROW.itemsize
        stride = stride_for(count, most)
        blocks = (_table(read_rows(file, 0, ROW, rows)) for rows in row_blocks(count, stride))
        return gaussians_from_rows(path, blocks, -(-count // stride), 14)


def _table(rows: NDArray[np.void]) -> NDArray[np.float32]:
    """(R, 14). Rows as in a .ply."""
    table = np.empty((len(rows), 14), np.float32)
    table[:, :3] = rows["means"]
    table[:, 3] = logits(rows["rgba"][:, 3] / 255)
    table[:, 4:7] = log_sizes(rows["scales"])
    table[:, 7:11] = (rows["quat"].astype(np.float32) - 128) / 128
    table[:, 11:] = rgb_to_sh(rows["rgba"][:, :3] / 255)
    return table
