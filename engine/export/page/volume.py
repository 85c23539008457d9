"""The inside as pictures of its layers, which every browser decodes, and the body as bytes."""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from engine.export.colours import WIDEN, Colours
from engine.render.face_detail import RIM
from engine.scene.grid import Body, Grid

__all__ = ["Layers", "PackedInside", "pack_body", "pack_inside"]

MOST_CELLS = 288
"""Most cells along the longest side: two or three pixels of a large window each. A cube has 36 MB on the graphics
card."""

FINER = 0.75
"""Size of a cell over the finest detail of the inside: between cells as large as it, linear interpolation blurs it."""

SHARP = 0.7
"""Cells. Footprint at which the inside is read: interpolation blurs it by the rest."""

BESIDE = 1.5
"""Pitches. The colours continue this far outside the body: the skin's atoms stand as far out, and faces reach them."""

SHEET = 4096
"""Most pixels along a sheet's side: what graphics cards of phones can hold."""

QUALITY = 90
"""WebP quality: a watermelon's brightness in 384 cells takes 3.5 MB; with 95 it takes 4.9."""

REACH = 2.0
"""Cells of the body on either side of its skin in which depths are told apart, in steps of a sixty-fourth."""

OVER = 0.4
"""Pitches. How far beyond the skin of the body faces reach: in pictures, which draw them from the atoms, those of a
ball of thin discs end 0.4 beyond it, those of the sample watermelon 0.65."""

LUMA = np.array([0.299, 0.587, 0.114], np.float32)
"""Shares of red, green and blue in the brightness, as in JPEG: volume_face.frag.glsl has the way back."""


@dataclass(frozen=True)
class Layers:
    """A volume of bytes as greyscale WebP sheets: layers along z row by row, x to the right, y downwards."""

    shape: tuple[int, int, int]
    """X, Y, Z."""
    columns: int
    rows: int
    """Layers of a sheet across and down; the last sheet may hold fewer."""
    sheets: tuple[bytes, ...]


@dataclass(frozen=True)
class PackedInside:
    """Colours of the inside: brightness and, half as fine, the differences of blue and red from it."""

    grid: Grid
    luma: Layers
    blue: Layers
    red: Layers


def pack_inside(body: Body, colours: Colours, progress: Callable[[float], None]) -> PackedInside:
    """The inside of a body, as fine as its detail and MOST_CELLS allow. `progress` gets the share that is done."""
    low, high = body.bounds()
    cell = max(FINER * colours.detail, float((high - low).max()) / (MOST_CELLS - 2))
    grid = Grid.around(np.stack([low, high]), cell, 1)
    x, y, z = (count + count % 2 for count in grid.shape)
    grid = Grid(grid.origin, cell, (x, y, z))
    luma = np.zeros((z, y, x), np.uint8)
    hue = np.zeros((2, z // 2, 2, y // 2, x // 2), np.float32)
    atoms = replace(colours, inside=None)
    axes = [grid.origin[i] + (np.arange(grid.shape[i]) + 0.5) * cell for i in range(3)]
    for layer, height in enumerate(axes[2]):  # one at a time: points take ten times the memory of what is kept
        progress(layer / z)
        rgb = _layer(np.stack(np.meshgrid(axes[0], axes[1], [height]), -1)[:, :, 0], body, colours, atoms, cell)
        bright = rgb @ LUMA
        luma[layer] = np.round(255 * bright)
        for kind, (channel, most) in enumerate(((2, 1.772), (0, 1.402))):
            difference = (rgb[..., channel] - bright) / most
            hue[kind, layer // 2, layer % 2] = difference.reshape(y // 2, 2, x // 2, 2).mean((1, 3))
    blue, red = np.round(128 + 255 * hue.mean(2)).clip(0, 255).astype(np.uint8)
    return PackedInside(grid, _layers(luma), _layers(blue), _layers(red))


def pack_body(body: Body, pitch: float) -> bytes:
    """zlib. A byte for each cell, x fastest: 127.5 is where faces end, more is below that, by `REACH`. `pitch`: world
    units.

    A single skewed atom dents the skin by a cell, which a median of 3 x 3 x 3 removes.
    """
    even = ndimage.median_filter(body.depth, 3) + OVER * pitch
    steps = np.round(127.5 + even / (REACH * body.grid.cell) * 127.5).clip(0, 255).astype(np.uint8)
    return zlib.compress(np.ascontiguousarray(steps.transpose(2, 1, 0)).tobytes(), 9)


def _layer(
    points: NDArray[np.float64], body: Body, colours: Colours, atoms: Colours, cell: float
) -> NDArray[np.float32]:
    """(Y, X, 3). Colours at points (Y, X, 3): at the rim those of the atoms alone, as in pictures; far outside those of
    the nearest point that is not, which compress best and leave the edge as it is."""
    pitch, depth = colours.atoms.pitch, body.at(points)
    known = depth > -BESIDE * pitch
    rgb = np.full(points.shape, 0.5, np.float32)
    if known.any():
        rgb[known] = colours.within(points[known], SHARP * cell)
        share = depth / (RIM * pitch)
        rim = known & (share < 1)
        share = share[rim, None].clip(0)
        rgb[rim] = share * rgb[rim] + (1 - share) * atoms.within(points[rim], max(cell, WIDEN * pitch))
        nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        rgb = rgb[tuple(nearest)]
    return rgb


def _layers(volume: NDArray[np.uint8]) -> Layers:
    """The layers of a volume (Z, Y, X)."""
    z, y, x = volume.shape
    columns, most = max(SHEET // x, 1), max(SHEET // y, 1)
    rows = min(most, -(-z // columns))
    sheets = []
    for first in range(0, z, columns * rows):
        part = volume[first : first + columns * rows]
        used = -(-len(part) // columns)
        sheet = np.zeros((used * columns, y, x), np.uint8)
        sheet[: len(part)] = part
        sheets.append(_webp(sheet.reshape(used, columns, y, x).swapaxes(1, 2).reshape(used * y, columns * x)))
    return Layers((x, y, z), columns, rows, tuple(sheets))


def _webp(grey: NDArray[np.uint8]) -> bytes:
    out = io.BytesIO()
    Image.fromarray(grey).save(out, "WEBP", quality=QUALITY)
    return out.getvalue()
