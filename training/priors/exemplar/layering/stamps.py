"""Details of pictures, such as seeds and pores, at their places in a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from engine.threads import for_spans
from training.priors.exemplar.layering.decompose import Detail, Layers
from training.priors.exemplar.patches import OVER
from training.priors.exemplar.record import RecordReader
from training.priors.exemplar.sampling import reduced

__all__ = ["COLUMNS", "GROW", "Crops", "Stamps", "paint"]

MAX_GROUND_DISTANCE = 0.5
"""RGB distance from its ground beyond which a detail is not painted: a crumb is cut off at the cream."""

GROW = np.float32(1.15)
"""Factor by which a stamp is larger than its detail in the picture: sections are smaller than what they cut."""

BIN = 8.0
"""Cells along a side of the bins in which stamps are looked up: a few stamps meet a bin."""

MOST_STAMPS, MOST_TEXELS, MOST_CROP = 1_000_000, 50_000_000, 2048
"""Largest numbers in a file: of stamps, of pixels of all crops, and of pixels along a crop."""

POINT, A, B, MIDDLE, REACH, AB, ACROSS, GROUND = 0, 3, 6, 9, 11, 12, 16, 17
"""First columns of a stamp: where its centre goes in cells (3), directions a and b there (3 each), its centre in the
picture in cells (2), the radius of a circle around it, directions a and b in the picture (2 each), its half length
along the picture's normal, and the colour around it (3)."""

COLUMNS = 20


@dataclass(frozen=True)
class Crops:
    """What pictures show of their details."""

    texels: NDArray[np.float32]
    """(P, 5). RGB, opacity, and whether the pixel belongs to the detail, crop after crop and row after row; whole steps
    of 1/255."""
    boxes: NDArray[np.int32]
    """(T, 4). First row, first column, height and width of each crop in its picture, in pixels."""
    coarseness: int = 1
    """Pixels of the picture per pixel of a crop, along a side."""

    @classmethod
    def of(cls, details: Sequence[tuple[Layers, Detail]]) -> Crops:
        """The crops of details in their pictures."""
        texels, boxes = [np.zeros((0, 5), np.float32)], [np.zeros((0, 4), np.int32)]
        for layers, detail in details:
            reach = int(np.ceil(detail.reach * OVER)) + 1
            row, column = round(detail.y * OVER), round(detail.x * OVER)
            rows = slice(max(row - reach, 0), row + reach + 1)
            columns = slice(max(column - reach, 0), column + reach + 1)
            owned = (layers.labels[rows, columns] == detail.label)[..., None]
            crop = np.concatenate([layers.source.rgb[rows, columns], layers.detail[rows, columns, None], owned], -1)
            texels.append(np.round(crop * 255).reshape(-1, 5).astype(np.float32) / np.float32(255))
            boxes.append(np.array([[rows.start, columns.start, *crop.shape[:2]]], np.int32))
        return cls(np.concatenate(texels), np.concatenate(boxes))

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """(T,). Row of each crop's first pixel."""
        areas = self.boxes[:, 2].astype(np.int64) * self.boxes[:, 3]
        return np.cumsum(areas) - areas

    def reduced(self, n: int) -> Crops:
        """The same crops of pictures with pixels n times as large."""
        texels, boxes = [np.zeros((0, 5), np.float32)], [np.zeros((0, 4), np.int32)]
        for (row, column, height, width), first in zip(self.boxes.tolist(), self.first.tolist(), strict=True):
            crop = self.texels[first : first + height * width].reshape(height, width, 5).copy()
            crop[..., 3] *= crop[..., 4]
            # Padded to whole large pixels and by one more on all sides, over which the crop fades.
            sides = [(n + start % n, n + -(start + side) % n) for start, side in ((row, height), (column, width))]
            colours = np.pad(crop[..., :3], (*sides, (0, 0)), mode="edge")
            small = reduced(np.concatenate([colours, np.pad(crop[..., 3:], (*sides, (0, 0)))], axis=-1), n)
            small[..., 4] = small[..., 4] > 0
            texels.append(small.reshape(-1, 5))
            boxes.append(np.array([[row // n - 1, column // n - 1, *small.shape[:2]]], np.int32))
        return Crops(np.concatenate(texels), np.concatenate(boxes), n)


@dataclass(frozen=True)
class Stamps:
    """Crops at their places."""

    crops: Crops
    rows: NDArray[np.float32]
    """(S, COLUMNS). The stamps, in the order in which they are painted."""
    crop: NDArray[np.int32]
    """(S,). Number of the crop that each stamp shows."""

    def reduced(self, n: int) -> Stamps:
        """The same stamps with pixels n times as large in their pictures."""
        return replace(self, crops=self.crops.reduced(n))

    def paint(self, rgb: NDArray[np.float32], points: NDArray[np.float32]) -> None:
        """Paints the stamps over colours (M, 3), in place, at points (M, 3) in cells of the grid that they were placed
        in."""
        if len(self.rows):
            low, counts, starts, members = self._bins
            crops = self.crops
            bins = low, counts, starts, members
            shown = crops.texels, crops.boxes, crops.first, crops.coarseness
            for_spans(_paint_points, len(points), rgb, points, *bins, self.rows, self.crop, *shown)

    @cached_property
    def _bins(self) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
        """(3,), (3,), (N + 1,), (E,). Lowest corner and number of the bins; the first entry of each bin among the
        stamps that meet the bins; and these, in order."""
        far = _far(self.rows[:, REACH], self.rows[:, ACROSS])[:, None]
        low, high = (self.rows[:, :A] - far), (self.rows[:, :A] + far)
        corner = low.min(0)
        first, last = (((side - corner) / BIN).astype(np.int64) for side in (low, high))
        counts = last.max(0) + 1
        met: list[NDArray[np.int64]] = []
        for s in range(len(self.rows)):
            i, j, k = (np.arange(first[s, a], last[s, a] + 1) for a in range(3))
            numbers = (i[:, None, None] * counts[1] + j[:, None]) * counts[2] + k
            met.append(np.stack([numbers.ravel(), np.full(numbers.size, s)]))
        numbers, members = np.concatenate(met, axis=1)
        order = np.argsort(numbers, kind="stable")
        starts = np.searchsorted(numbers[order], np.arange(counts.prod() + 1))
        return corner.astype(np.float32), counts, starts.astype(np.int64), members[order].astype(np.int32)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same stamps."""
        texels = np.round(self.crops.texels * 255).astype(np.uint8)
        return {"texels": texels, "boxes": self.crops.boxes, "rows": self.rows, "crop": self.crop}, {}

    @classmethod
    def restored(cls, record: RecordReader) -> Stamps:
        """The stamps in a `record`. Raises ValueError if the record is not valid."""
        texels = record.array("texels", np.uint8, (None, 5))
        boxes, rows = record.array("boxes", np.int32, (None, 4)), record.array("rows", np.float32, (None, COLUMNS))
        crop = record.array("crop", np.int32, (len(rows),))
        crops = Crops(texels.astype(np.float32) / np.float32(255), boxes)
        sizes = boxes[:, 2:]
        if len(rows) > MOST_STAMPS or len(texels) > MOST_TEXELS or boxes.min() < 0 or sizes.max() > MOST_CROP:
            raise ValueError("too many details, or wrong ones")
        if len(texels) != int(sizes.astype(np.int64).prod(1).sum()) or crop.min() < 0 or crop.max() >= len(boxes):
            raise ValueError("details without a picture")
        if np.abs(rows).max() > 1e5 or rows[:, ACROSS].min() <= 0 or _far(rows[:, REACH], rows[:, ACROSS]).max() > 500:
            raise ValueError("wrong places of details")
        return cls(crops, rows, crop)


def _far(reach: NDArray[np.float32], across: NDArray[np.float32]) -> NDArray[np.float32]:
    """(S,). Distance in cells from its centre within which a stamp paints."""
    return np.maximum(reach * GROW, across) + 1


def paint(
    rgb: NDArray[np.float32],  # in out [X, Y, Z, 3]
    number: NDArray[np.int32],  # [X, Y, Z] -1 outside the body
    row: NDArray[np.float32],  # [COLUMNS]
    crops: Crops,
    crop: int,
) -> None:
    """Paints one stamp into a grid, in place."""
    far = float(_far(row[REACH], row[ACROSS]))
    low = np.maximum((row[:A] - far).astype(np.int64), 0)
    high = np.minimum((row[:A] + far).astype(np.int64) + 2, number.shape)
    _paint_cells(rgb, number, low, high, row, crops.texels, crops.boxes[crop], crops.first[crop])


@njit(cache=True)
def _paint_cells(
    rgb: NDArray[np.float32],  # in out [X, Y, Z, 3]
    number: NDArray[np.int32],  # [X, Y, Z]
    low: NDArray[np.int64],  # [3]
    high: NDArray[np.int64],  # [3]
    row: NDArray[np.float32],  # [COLUMNS]
    texels: NDArray[np.float32],  # [P, 5]
    box: NDArray[np.int32],  # [4]
    first: int,
) -> None:
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for k in range(low[2], high[2]):
                if number[i, j, k] >= 0:
                    _paint_one(rgb[i, j, k], np.float32(i), np.float32(j), np.float32(k), row, texels, box, first, 1)


@njit(cache=True, nogil=True)
def _paint_points(
    start: int,
    stop: int,
    rgb: NDArray[np.float32],  # in out [M, 3]
    points: NDArray[np.float32],  # [M, 3]
    low: NDArray[np.float32],  # [3] corner of the bins
    counts: NDArray[np.int64],  # [3] of bins
    starts: NDArray[np.int64],  # [N + 1]
    members: NDArray[np.int32],  # [E]
    rows: NDArray[np.float32],  # [S, COLUMNS]
    crop: NDArray[np.int32],  # [S]
    texels: NDArray[np.float32],  # [P, 5]
    boxes: NDArray[np.int32],  # [T, 4]
    first: NDArray[np.int64],  # [T]
    coarseness: int,
) -> None:
    for m in range(start, stop):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        i, j, k = np.floor((x - low[0]) / BIN), np.floor((y - low[1]) / BIN), np.floor((z - low[2]) / BIN)
        if i < 0 or j < 0 or k < 0 or i >= counts[0] or j >= counts[1] or k >= counts[2]:
            continue
        n = int((i * counts[1] + j) * counts[2] + k)
        for e in range(starts[n], starts[n + 1]):
            s = members[e]
            _paint_one(rgb[m], x, y, z, rows[s], texels, boxes[crop[s]], first[crop[s]], coarseness)


@njit(cache=True)
def _paint_one(
    rgb: NDArray[np.float32],  # in out [3]
    x: np.float32,  # cells
    y: np.float32,
    z: np.float32,
    row: NDArray[np.float32],  # [COLUMNS]
    texels: NDArray[np.float32],  # [P, 5]
    box: NDArray[np.int32],  # [4]
    first: int,
    coarseness: int,
) -> None:
    """Paints one stamp over the colour at a place: its picture in its plane, shrinking like an ellipsoid across it, and
    only over ground like its own."""
    off = np.float32(0)
    for c in range(3):
        off += (rgb[c] - row[GROUND + c]) ** 2
    if off > MAX_GROUND_DISTANCE * MAX_GROUND_DISTANCE:
        return
    dx, dy, dz = x - row[POINT], y - row[POINT + 1], z - row[POINT + 2]
    ax, ay, az, bx, by, bz = row[A], row[A + 1], row[A + 2], row[B], row[B + 1], row[B + 2]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    w = (dx * nx + dy * ny + dz * nz) / row[ACROSS]
    if w * w >= np.float32(0.98):
        return
    scale = GROW * np.sqrt(np.float32(1) - w * w)
    s = (dx * ax + dy * ay + dz * az) / scale
    t = (dx * bx + dy * by + dz * bz) / scale
    if s * s + t * t > row[REACH] * row[REACH]:
        return
    px, py = row[MIDDLE] + s * row[AB] + t * row[AB + 2], row[MIDDLE + 1] + s * row[AB + 1] + t * row[AB + 3]
    half = np.float32(0.5) * np.float32(coarseness - 1)
    column = (px * np.float32(OVER) - half) / np.float32(coarseness) - np.float32(box[1])
    line = (py * np.float32(OVER) - half) / np.float32(coarseness) - np.float32(box[0])
    height, width = box[2], box[3]
    if column < 0 or line < 0 or column >= width - 1 or line >= height - 1:
        return
    c, r = int(column), int(line)
    if texels[first + int(line + np.float32(0.5)) * width + int(column + np.float32(0.5)), 4] == 0:
        return
    u, v = column - np.float32(c), line - np.float32(r)
    alpha = np.float32(0)
    for m in range(2):
        for n in range(2):
            alpha += (v if m else 1 - v) * (u if n else 1 - u) * texels[first + (r + m) * width + c + n, 3]
    for channel in range(3):
        colour = np.float32(0)
        for m in range(2):
            for n in range(2):
                weight = (v if m else 1 - v) * (u if n else 1 - u)
                colour += weight * texels[first + (r + m) * width + c + n, channel]
        rgb[channel] += alpha * (colour - rgb[channel])
