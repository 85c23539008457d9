"""Checks the rows of a capture file and turns them into Gaussians, for all splat formats."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.origin import Vector, origin_for
from engine.scene.gaussians import Gaussians

__all__ = [
    "BLOCK_ROWS",
    "COLOUR",
    "FLATNESS",
    "GEOMETRY",
    "gaussians_from_rows",
    "log_sizes",
    "logits",
    "read_rows",
    "row_blocks",
    "stride_for",
]

Float = NDArray[np.float32]

GEOMETRY = ("x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
COLOUR = ("f_dc_0", "f_dc_1", "f_dc_2")
"""The first columns of a row, in this order; SH above degree 0 follow, channel-major. As in INRIA's .ply, opacities are
logits and scales are logs."""

BLOCK_ROWS = 1 << 14
"""Rows read at once: 4 MB of SH-3 rows, which stay in the cache while the columns are extracted."""

FLATNESS = 0.01
"""Thickness of a disc over its smaller standard deviation. A hundredth shows in no view, and is still a Gaussian."""

MAX_LOG_SCALE = 30.0
"""Largest plausible |log scale|: e^-30 is below what float32 resolves in a scene of size 1; flat ones reach e^-25."""

MAX_POSITION = 1e9
"""Largest plausible coordinate, world units from the scene's origin: its square still fits into float32."""

MAX_SH = 1e4
"""Largest plausible SH coefficient: a colour thousands of times brighter than white."""

MAX_SPREAD = 1e5
"""A Gaussian this many times farther out, or larger, than the median distance belongs to no object. Skies reach 1e4."""

SPREAD_ROWS = 100
"""Least number of rows for which the median position and distance mean something. Just under half of the rows may lie
anywhere."""

REACH = (1e-7, 1e8)
"""World units. Least and greatest median distance of a usable scene. Beyond these, the limits above would cut through
the scene itself."""

MAX_UNUSABLE = 0.5
"""Largest share of unusable rows. Floaters, dead Gaussians and damage make up a few per cent; what remains of a mostly
unusable file is no capture."""

REMEDIES = {
    "NaN or Inf": "the file is damaged, export the capture again",
    "zero quaternions": "the file is damaged, export the capture again",
    "absurd sizes": "they should lie between 1e-13 and 1e13 units, export the capture again or scale it",
    "absurd positions": "export the capture again, nearer to zero or in other units",
    "absurd colours": "the file is damaged, export the capture again",
}
"""Each reason for dropping a row, and what the user can do about it."""


def gaussians_from_rows(
    path: Path, blocks: Iterable[NDArray[np.floating]], count: int, columns: int, wide: bool = False
) -> tuple[Gaussians, list[str]]:
    """The Gaussians of `count` rows in blocks (R, columns), and a line for the user on each kind of change to them.

    A row has 14 + 3 ((d+1)^2 - 1) columns. With `wide` the blocks are float64, and positions keep that precision until
    the scene has been moved. Rows are dropped that have NaN or Inf (except an infinite opacity logit, which means 0 or
    1), a zero quaternion, or implausible sizes, positions or colours. A scene so far from zero that float32 would round
    it is moved (engine.io.origin). Raises InputError if most rows would be dropped, or if the scene is too small or
    too large for float32. Besides the result and a block, it takes memory for about ten numbers per row.
    """
    rest = (columns - len(GEOMETRY) - len(COLOUR)) // 3
    positions = np.empty((count, 3), np.float64 if wide else np.float32)
    sizes = np.empty(count, np.float32)
    scene = _Columns(
        np.empty((count, 3), np.float32),
        np.empty((count, 4), np.float32),
        np.empty(count, np.float32),
        np.empty((count, 1 + rest, 3), np.float32),
    )
    reasons = {reason: np.zeros(count, bool) for reason in REMEDIES}
    filled = 0
    # What overflows becomes Inf; so does exp(-logit) of a large negative logit, whose opacity then rightly is 0.
    # Results of flawed rows are never used.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for block in blocks:
            rows = slice(filled, filled + len(block))
            table = block.astype(np.float32, copy=False)
            positions[rows] = block[:, :3]
            sizes[rows] = table[:, 4:7].max(1)
            for reason, flawed in _flaws(table, positions[rows]).items():
                reasons[reason][rows] = flawed
            _activate(table, scene, rows)
            filled = rows.stop
    assert filled == count, (filled, count)
    keep = ~np.logical_or.reduce(list(reasons.values()))
    _mark_outliers(path, sizes, positions, keep, reasons)
    keep = ~np.logical_or.reduce(list(reasons.values()))
    origin, lines = _find_origin(path, sizes, positions, keep, reasons)
    keep, dropped = _select(path, reasons)
    if any(origin):
        positions = positions - np.asarray(origin)
    with np.errstate(over="ignore"):
        means = positions.astype(np.float32, copy=False)
    arrays = (_compact(array, keep) for array in (means, scene.scales, scene.quats, scene.opacities, scene.sh))
    return Gaussians(*arrays, origin=origin), [*lines, *dropped]


def stride_for(count: int, most: int | None) -> int:
    """The step with which at most `most` rows are chosen evenly from `count`; 1 for all of them."""
    return 1 if most is None else max(1, -(-count // most))


def row_blocks(count: int, stride: int = 1) -> Iterator[range]:
    """Every `stride`-th of `count` rows, in blocks."""
    for first in range(0, count, BLOCK_ROWS * stride):
        yield range(first, min(first + BLOCK_ROWS * stride, count), stride)


def read_rows(file: BinaryIO, offset: int, dtype: np.dtype[np.void], rows: range) -> NDArray[np.void]:
    """These rows of a table that begins at `offset`, in bytes; fewer if the file ends early."""
    size = dtype.itemsize
    if rows.step == 1:
        file.seek(offset + rows.start * size)
        data = file.read(len(rows) * size)
    else:
        parts = []
        for row in rows:
            file.seek(offset + row * size)
            parts.append(file.read(size))
        data = b"".join(parts)
    return np.frombuffer(data, dtype, len(data) // size)


def logits(opacities: NDArray[np.floating]) -> NDArray[np.floating]:
    """Logits of opacities in [0, 1]; infinite at both ends."""
    with np.errstate(divide="ignore"):
        return np.log(opacities) - np.log1p(-opacities)


def log_sizes(sizes: NDArray[np.floating]) -> NDArray[np.floating]:
    """(R, 3). Logs of standard deviations. One of 0 beside another is a disc's, whose thickness is FLATNESS; rows with
    none above 0 are not finite."""
    least = np.where(sizes > 0, sizes, np.inf).min(1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(np.where(sizes == 0, FLATNESS * least, sizes))


def _flaws(table: Float, positions: NDArray[np.floating]) -> dict[str, NDArray[np.bool_]]:
    """For each reason to drop a row, the mask (N,) of rows that it applies to, judged row by row."""
    opacity = GEOMETRY.index("opacity")
    finite = np.isfinite(table[:, 3:])
    finite[:, opacity - 3] = ~np.isnan(table[:, opacity])  # the logits of 0 and 1 are infinite, and both are valid
    log_scales, quats, sh = table[:, 4:7], table[:, 7:11], table[:, 11:]
    return {
        "NaN or Inf": ~(finite.all(1) & np.isfinite(positions).all(1)),
        "zero quaternions": ~quats.any(1),
        "absurd sizes": (np.abs(log_scales) > MAX_LOG_SCALE).any(1),
        "absurd colours": (np.abs(sh) > MAX_SH).any(1),
    }


def _mark_outliers(
    path: Path,
    sizes: Float,  # [N] largest log scales
    positions: NDArray[np.floating],
    keep: NDArray[np.bool_],
    reasons: dict[str, NDArray[np.bool_]],
) -> None:
    """Marks the rows of `keep` (N,) that are too far out or too large compared with the others.

    Raises InputError if the scene itself is too small or too large for float32.
    """
    if keep.sum() < SPREAD_ROWS:
        return
    distances = np.zeros(len(positions))
    with np.errstate(over="ignore"):
        distances[keep] = np.linalg.norm(positions[keep] - np.median(positions[keep], axis=0), axis=1)
    reach = float(np.median(distances[keep]))
    if not reach > 0:
        return
    if not REACH[0] <= reach <= REACH[1]:
        raise InputError(
            f"{path}: half of its Gaussians lie within {reach:.1g} units of its middle; scale the scene, "
            f"from {REACH[0]:g} to {REACH[1]:g} can be used"
        )
    reasons["absurd positions"] |= distances > MAX_SPREAD * reach
    reasons["absurd sizes"] |= keep & (sizes > np.log(MAX_SPREAD * reach))


def _find_origin(
    path: Path,
    sizes: Float,  # [N] largest log scales
    positions: NDArray[np.floating],
    keep: NDArray[np.bool_],
    reasons: dict[str, NDArray[np.bool_]],
) -> tuple[Vector, list[str]]:
    """The origin of the rows of `keep` (N,), as `origin_for`; rows too far from it are marked.

    The median scale of the remaining rows is the size of a detail. Marked rows do not influence the origin.
    """
    while True:
        detail = float(np.exp(np.median(sizes[keep]))) if keep.any() else 0.0
        origin, lines = origin_for(path, positions[keep], detail)
        far = np.zeros_like(keep)
        far[keep] = (np.abs(positions[keep] - np.asarray(origin)) > MAX_POSITION).any(1)
        if not far.any():
            return origin, lines
        reasons["absurd positions"] |= far
        keep = keep & ~far


def _select(path: Path, reasons: dict[str, NDArray[np.bool_]]) -> tuple[NDArray[np.bool_], list[str]]:
    """Mask (N,) of the usable rows, and a line on each reason why others are not.

    A row counts for the first reason that applies. Raises InputError if most rows are unusable.
    """
    n = len(next(iter(reasons.values())))
    warnings = []
    keep = np.ones(n, bool)
    for reason, bad in reasons.items():
        fresh = int((bad & keep).sum())
        keep &= ~bad
        if fresh:
            warnings.append(f"{path}: {fresh:,} of {n:,} Gaussians dropped: {reason}")
    unusable = int((~keep).sum())
    if unusable > MAX_UNUSABLE * n:
        worst = max(reasons, key=lambda reason: int(reasons[reason].sum()))
        count = "none" if unusable == n else f"only {n - unusable:,}"
        raise InputError(f"{path}: {count} of the {n:,} Gaussians can be used: {worst}; {REMEDIES[worst]}")
    return keep, warnings


class _Columns(NamedTuple):
    """The activated rows, without the positions: arrays as in `Gaussians`."""

    scales: Float
    quats: Float
    opacities: Float
    sh: Float


def _activate(table: Float, scene: _Columns, rows: slice) -> None:
    """Fills rows of the scene from the file's: logits, logs, quaternions of any length, channel-major SH."""
    n, rest = len(table), table.shape[1] - len(GEOMETRY) - len(COLOUR)
    scene.opacities[rows] = 1 / (1 + np.exp(-table[:, 3]))
    quats = table[:, 7:11].astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scene.quats[rows] = quats
    scene.sh[rows, 0] = table[:, 11:14]
    scene.sh[rows, 1:] = table[:, 14:].reshape(n, 3, rest // 3).transpose(0, 2, 1)
    scene.scales[rows] = np.exp(table[:, 4:7].astype(np.float64))


def _compact(array: Float, keep: NDArray[np.bool_]) -> Float:
    """The rows of `keep` (N,), moved together in place, so that a large scene is never in memory twice."""
    if keep.all():
        return array
    filled = 0
    for first in range(0, len(array), BLOCK_ROWS):
        part = array[first : first + BLOCK_ROWS][keep[first : first + BLOCK_ROWS]]
        array[filled : filled + len(part)] = part
        filled += len(part)
    return array[:filled]
