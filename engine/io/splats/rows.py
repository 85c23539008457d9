"""Rows of a capture as its file gives them, judged and turned into Gaussians: what all readers of splats share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.origin import Vector, origin_for
from engine.scene.gaussians import Gaussians

__all__ = ["COLOUR", "GEOMETRY", "gaussians_of", "logits"]

Float = NDArray[np.float32]

GEOMETRY = ("x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
COLOUR = ("f_dc_0", "f_dc_1", "f_dc_2")
"""A row's first columns, in this order; SH of degrees above 0 come behind them, channel-major. All as INRIA's .ply has
them: opacities are logits, sizes logs."""

MAX_LOG_SCALE = 30.0
"""Absurd beyond: e^-30 is less than float32 resolves beside a scene of size 1, yet flat captures reach e^-25."""

MAX_POSITION = 1e9
"""Absurd beyond, world units from the scene's origin: squares still fit into float32, and no scene is so wide."""

MAX_SH = 1e4
"""Absurd beyond: a colour thousands of times brighter than white."""

MAX_SPREAD = 1e5
"""A Gaussian this many times farther off, or larger, than half of the scene reaches belongs to no object. Skies reach
1e4."""

SPREAD_ROWS = 100
"""Rows from which on the middle and the reach of the scene mean something. Both are medians: just under half of the
rows may lie anywhere."""

REACH = (1e-7, 1e8)
"""World units that half of a scene reaches at the least and at the most. Nearer to the limits above these would cut
through the scene itself."""

MOST_UNUSABLE = 0.5
"""Share of the rows that may be unusable. Floaters, dead Gaussians and damage are a few in a hundred; of a file that is
mostly unusable the rest is no capture."""

REMEDIES = {
    "NaN or Inf": "the file is damaged, export the capture again",
    "zero quaternions": "the file is damaged, export the capture again",
    "absurd sizes": "they should lie between 1e-13 and 1e13 units, export the capture again or scale it",
    "absurd positions": "export the capture again, nearer to zero or in other units",
    "absurd colours": "the file is damaged, export the capture again",
}
"""Each reason to drop a row, and what the user can do about it."""


def gaussians_of(path: Path, table: Float, places: NDArray[np.floating] | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of rows (N, 14 + 3 ((d+1)^2 - 1)), and one line about each thing that the user should know.

    `places` (N, 3) are the positions where the file has them finer than the table. Dropped are rows with NaN or Inf
    (but an infinite opacity logit is plainly 0 or 1), zero quaternions, and sizes, places or colours that no scene has.
    A scene so far from zero that float32 would round it is moved (engine.io.origin). Raises InputError where most rows
    would be dropped, or the scene is too small or too large for float32.
    """
    places = table[:, :3] if places is None else places
    reasons = _flaws(table, places)
    keep = ~np.logical_or.reduce(list(reasons.values()))
    _mark_far(path, table, places, keep, reasons)
    keep = ~np.logical_or.reduce(list(reasons.values()))
    origin, lines = _placed(path, table, places, keep, reasons)
    if any(origin):
        places = places - np.asarray(origin)
    keep, dropped = _judged(path, reasons)
    with np.errstate(over="ignore"):
        table[:, :3] = places
    return _activate(table if keep.all() else table[keep], origin), [*lines, *dropped]


def logits(opacities: NDArray[np.floating]) -> NDArray[np.floating]:
    """Logits of opacities in [0, 1]; infinite at both ends."""
    with np.errstate(divide="ignore"):
        return np.log(opacities) - np.log1p(-opacities)


def _flaws(table: Float, places: NDArray[np.floating]) -> dict[str, NDArray[np.bool_]]:
    """For each reason not to draw a row, mask (N,) of those it holds for, as far as a row shows it by itself."""
    opacity = GEOMETRY.index("opacity")
    finite = np.isfinite(table[:, 3:])
    finite[:, opacity - 3] = ~np.isnan(table[:, opacity])  # the logits of 0 and 1 are infinite, and both are meant
    log_scales, quats, sh = table[:, 4:7], table[:, 7:11], table[:, 11:]
    return {
        "NaN or Inf": ~(finite.all(1) & np.isfinite(places).all(1)),
        "zero quaternions": ~quats.any(1),
        "absurd sizes": (np.abs(log_scales) > MAX_LOG_SCALE).any(1),
        "absurd positions": np.zeros(len(table), bool),
        "absurd colours": (np.abs(sh) > MAX_SH).any(1),
    }


def _mark_far(
    path: Path,
    table: Float,
    places: NDArray[np.floating],
    keep: NDArray[np.bool_],
    reasons: dict[str, NDArray[np.bool_]],
) -> None:
    """Adds the rows of `keep` (N,) that the rest of them show to be too far or too large.

    Raises InputError where the rest itself is too small or too large for float32.
    """
    if keep.sum() < SPREAD_ROWS:
        return
    distances = np.zeros(len(table))
    with np.errstate(over="ignore"):
        distances[keep] = np.linalg.norm(places[keep] - np.median(places[keep], axis=0), axis=1)
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


def _placed(
    path: Path,
    table: Float,
    places: NDArray[np.floating],
    keep: NDArray[np.bool_],
    reasons: dict[str, NDArray[np.bool_]],
) -> tuple[Vector, list[str]]:
    """Where the zero of the rows of `keep` (N,) should lie, as `origin_for`, and what lies too far from it is marked.

    The sizes of what is left count as its details. What is marked has no say in the origin.
    """
    while True:
        detail = float(np.exp(np.median(table[keep, 4:7].max(1)))) if keep.any() else 0.0
        origin, lines = origin_for(path, places[keep], detail)
        far = keep & (np.abs(places - np.asarray(origin)) > MAX_POSITION).any(1)
        if not far.any():
            return origin, lines
        reasons["absurd positions"] |= far
        keep = keep & ~far


def _judged(path: Path, reasons: dict[str, NDArray[np.bool_]]) -> tuple[NDArray[np.bool_], list[str]]:
    """Mask (N,) of the rows that can be drawn, and a line about each reason why others cannot.

    A row counts for the first reason that holds for it. Raises InputError where most rows cannot be drawn.
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
    if unusable > MOST_UNUSABLE * n:
        worst = max(reasons, key=lambda reason: int(reasons[reason].sum()))
        count = "none" if unusable == n else f"only {n - unusable:,}"
        raise InputError(f"{path}: {count} of the {n:,} Gaussians can be used: {worst}; {REMEDIES[worst]}")
    return keep, warnings


def _activate(table: Float, origin: Vector) -> Gaussians:
    """Gaussians from columns in the file's terms: logits, logs, quaternions of any length, channel-major SH."""
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
