"""A cut face reduced to a few pixels, in which to look for symmetry: that is a matter of a face's layout, and finer
detail never repeats."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

__all__ = ["SIDE", "contrast_layers", "reduce_face"]

SIDE = 96
"""Pixels along a side of a reduced face."""


def reduce_face(
    rgb: NDArray[np.float32], mask: NDArray[np.bool_], light: Literal["plane", "curved"], tall: float = 1.0
) -> tuple[NDArray[np.float32], NDArray[np.float64], float]:
    """(SIDE, SIDE, 4) the layers of a face (H, W, 3), (H, W); the middle (x, y) of the box around the face in pixels;
    and how many pixels of the picture make a reduced one.

    `light`: the form of the light, which is removed. `tall`: how many times wider, and lower, than in the picture the
    face is drawn.
    """
    rows, columns = np.nonzero(mask)
    middle = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
    side = 1.2 * max(np.ptp(rows) / tall, np.ptp(columns) * tall)  # room to turn in
    half = side / 2 * np.array([1 / tall, tall])
    box = (*(middle - half), *(middle + half))
    layers = contrast_layers(rgb, mask, light) * np.array([1, 1, 1, 2], np.float32)
    channels = [
        Image.fromarray(np.ascontiguousarray(layers[..., c])).transform(
            (SIDE * 4, SIDE * 4), Image.Transform.EXTENT, box, Image.Resampling.BILINEAR
        )
        for c in range(4)
    ]
    small = [np.asarray(c.resize((SIDE, SIDE), Image.Resampling.BOX)) for c in channels]
    return np.stack(small, -1), middle, side / SIDE


def contrast_layers(
    rgb: NDArray[np.float32], mask: NDArray[np.bool_], light: Literal["plane", "curved"]
) -> NDArray[np.float32]:
    """(H, W, 4). Colours less the light, a surface fitted to the face's colours, then the mask weighted by their
    contrast; 0 outside.

    Light from one side is a plane. Over a cut that stands on a table it is curved, and darkens towards the table and
    its own mirror image: if less than that is removed, an apple's star is more like its mirror image than like itself
    turned. But where a core line is looked for, a curve would remove the pale core itself.
    """
    y, x = np.indices(mask.shape, np.float32)
    x, y = x / mask.shape[1] * 2 - 1, y / mask.shape[0] * 2 - 1
    surface = np.stack([np.ones_like(x), x, y] + [x * x, x * y, y * y] * (light == "curved"), -1)
    basis = surface[mask].astype(np.float64)
    # By the normal equations: for a face one pixel wide, several surfaces fit equally well.
    fitted, *_ = np.linalg.lstsq(basis.T @ basis, basis.T @ rgb[mask], rcond=None)
    colours = rgb - surface @ fitted.astype(np.float32)
    layers = np.concatenate([colours, np.full((*mask.shape, 1), colours[mask].std(axis=0).mean())], -1)
    return np.where(mask[..., None], layers, 0).astype(np.float32)
