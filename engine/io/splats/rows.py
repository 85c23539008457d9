"""Checks the rows of a capture file and turns them into Gaussians, for all splat formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.origin import Vector, origin_for
from engine.scene.gaussians import Gaussians

__all__ = ["COLOUR", "GEOMETRY", "gaussians_from_rows", "logits"]

Float = NDArray[np.float32]

GEOMETRY = ("x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
COLOUR = ("f_dc_0", "f_dc_1", "f_dc_2")
"""The first columns of a row, in this order; SH above degree 0 follow, channel-major. As in INRIA's .ply, opacities are
logits and scales are logs."""

MAX_LOG_SCALE = 30.0
"""Largest plausible |log scale|: e^-30 is below what float32 resolves in a scene of size 1; flat ones reach e^-25."""

MAX_POSITION = 1e9
"""Largest plausible coordinate, world units from the scene's origin: its square still fits into float32."""

MAX_SH = 1e4
"""Largest plausible SH coefficient: a colour thousands of times brighter than white."""

MAX_SPREAD = 1e5
"""A Gaussian this many times farther out, or larger, than the median distance is no part of any object. Skies reach
1e4."""

SPREAD_ROWS = 100
"""Least number of rows for which the median position and distance mean something. Just under half of the rows may lie
anywhere."""

REACH = (1e-7, 1e8)
"""World units. Least and greatest median distance of a usable scene. Closer to the limits above, these would cut
through the scene itself."""

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
    path: Path, table: Float, positions: NDArray[np.floating] | None = None
) -> tuple[Gaussians, list[str]]:
    """The Gaussians of rows (N, 14 + 3 ((d+1)^2 - 1)), and a line for the user on each kind of change to them.

    `positions` (N, 3) replace those of the table if the file has them in higher precision. Rows are dropped that have
    NaN or Inf (except an infinite opacity logit, which means 0 or 1), a zero quaternion, or implausible sizes,
    positions or colours. A scene so far from zero that float32 would round it is moved (engine.io.origin). Raises
    InputError if most rows would be dropped, or if the scene is too small or too large for float32.
    """
    positions = table[:, :3] if positions is None else positions
    reasons = _flaws(table, positions)
    keep = ~np.logical_or.reduce(list(reasons.values()))
    _mark_outliers(path, table, positions, keep, reasons)
    keep = ~np.logical_or.reduce(list(reasons.values()))
    origin, lines = _find_origin(path, table, positions, keep, reasons)
    if any(origin):
        positions = positions - np.asarray(origin)
    keep, dropped = _select(path, reasons)
    with np.errstate(over="ignore"):
        table[:, :3] = positions
    return _activate(table if keep.all() else table[keep], origin), [*lines, *dropped]


def logits(opacities: NDArray[np.floating]) -> NDArray[np.floating]:
    """Logits of opacities in [0, 1]; infinite at both ends."""
    with np.errstate(divide="ignore"):
        return np.log(opacities) - np.log1p(-opacities)


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
        "absurd positions": np.zeros(len(table), bool),
        "absurd colours": (np.abs(sh) > MAX_SH).any(1),
    }


def _mark_outliers(
    path: Path,
    table: Float,
    positions: NDArray[np.floating],
    keep: NDArray[np.bool_],
    reasons: dict[str, NDArray[np.bool_]],
) -> None:
    """Marks the rows of `keep` (N,) that are too far out or too large compared with the others.

    Raises InputError if the scene itself is too small or too large for float32.
    """
    if keep.sum() < SPREAD_ROWS:
        return
    distances = np.zeros(len(table))
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
    reasons["absurd sizes"] |= keep & (table[:, 4:7].max(1) > np.log(MAX_SPREAD * reach))


def _find_origin(
    path: Path,
    table: Float,
    positions: NDArray[np.floating],
    keep: NDArray[np.bool_],
    reasons: dict[str, NDArray[np.bool_]],
) -> tuple[Vector, list[str]]:
    """The origin of the rows of `keep` (N,), as `origin_for`; rows too far from it are marked.

    The scales of the remaining rows are the size of a detail. Marked rows do not influence the origin.
    """
    while True:
        detail = float(np.exp(np.median(table[keep, 4:7].max(1)))) if keep.any() else 0.0
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


def _activate(table: Float, origin: Vector) -> Gaussians:
    """Gaussians from columns as in the file: logits, logs, quaternions of any length, channel-major SH."""
    n, rest = len(table), table.shape[1] - len(GEOMETRY) - len(COLOUR)
    with np.errstate(over="ignore"):  # exp(-logit) of a large negative logit is Inf, and the opacity then rightly 0
        opacities = (1 / (1 + np.exp(-table[:, 3]))).astype(np.float32)
    quats = table[:, 7:11].astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = np.empty((n, 1 + rest // 3, 3), np.float32)
    sh[:, 0] = table[:, 11:14]
    sh[:, 1:] = table[:, 14:].reshape(n, 3, rest // 3).transpose(0, 2, 1)
    scales = np.exp(table[:, 4:7].astype(np.float64))
    means = np.ascontiguousarray(table[:, :3])
    return Gaussians(means, scales.astype(np.float32), quats.astype(np.float32), opacities, sh, origin=origin)
