"""Rows of a capture as its file gives them, judged and turned into Gaussians: what all readers of splats share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.gaussians import Gaussians

__all__ = ["COLOUR", "GEOMETRY", "gaussians_of", "logits"]

Float = NDArray[np.float32]

GEOMETRY = ("x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
COLOUR = ("f_dc_0", "f_dc_1", "f_dc_2")
"""A row's first columns, in this order; SH of degrees above 0 come behind them, channel-major. All as INRIA's .ply has
them: opacities are logits, sizes logs."""

MAX_LOG_SCALE = 30.0
"""Absurd beyond: e^-30 is less than float32 resolves beside a scene of size 1, yet flat captures reach e^-25."""

MAX_POSITION = 1e9
"""Absurd beyond, world units: the earth in millimetres is smaller, and squares still fit into float32."""

MAX_SH = 1e4
"""Absurd beyond: a colour thousands of times brighter than white."""

MAX_SPREAD = 1e4
"""A Gaussian this many times farther off, or larger, than the scene is wide belongs to no object. Skies reach 1e3."""

SPREAD_ROWS = 100
"""Rows from which on the width of the scene, a 90 % quantile, means something."""


def gaussians_of(path: Path, table: Float) -> tuple[Gaussians, list[str]]:
    """The Gaussians of rows (N, 14 + 3 ((d+1)^2 - 1)), and one line about each kind of row that had to be dropped.

    Dropped are rows with NaN or Inf (but an infinite opacity logit is plainly 0 or 1), zero quaternions, and sizes,
    places or colours that no scene has. Raises InputError where none is left.
    """
    keep, warnings = _usable(path, table)
    return _activate(table if keep.all() else table[keep]), warnings


def logits(opacities: NDArray[np.floating]) -> NDArray[np.floating]:
    """Logits of opacities in [0, 1]; infinite at both ends."""
    with np.errstate(divide="ignore"):
        return np.log(opacities) - np.log1p(-opacities)


def _usable(path: Path, table: Float) -> tuple[NDArray[np.bool_], list[str]]:
    """Mask (N,) of the rows that can be drawn, and a line about each reason why others cannot.

    Raises InputError where none is left.
    """
    n = len(table)
    opacity = GEOMETRY.index("opacity")
    finite = np.isfinite(table)
    finite[:, opacity] = ~np.isnan(table[:, opacity])  # the logits of 0 and 1 are infinite, and both are meant
    reasons = {"NaN or Inf": ~finite.all(1)}
    means, log_scales, quats, sh = table[:, :3], table[:, 4:7], table[:, 7:11], table[:, 11:]
    reasons["zero quaternions"] = ~quats.any(1)
    reasons["absurd sizes"] = (np.abs(log_scales) > MAX_LOG_SCALE).any(1)
    reasons["absurd positions"] = (np.abs(means) > MAX_POSITION).any(1)
    reasons["absurd colours"] = (np.abs(sh) > MAX_SH).any(1)
    keep = ~np.logical_or.reduce(list(reasons.values()))
    if keep.sum() >= SPREAD_ROWS:
        distances = np.zeros(n, np.float32)
        distances[keep] = np.linalg.norm(means[keep] - np.median(means[keep], axis=0), axis=1)
        width = float(np.quantile(distances[keep], 0.9))
        if width > 0:
            reasons["absurd positions"] |= distances > MAX_SPREAD * width
            reasons["absurd sizes"] |= keep & (log_scales.max(1) > np.log(MAX_SPREAD * width))
    warnings = []
    keep = np.ones(n, bool)
    for reason, bad in reasons.items():
        fresh = int((bad & keep).sum())
        keep &= ~bad
        if fresh:
            warnings.append(f"{path}: {fresh:,} of {n:,} Gaussians dropped: {reason}")
    if not keep.any():
        worst = max(reasons, key=lambda reason: int(reasons[reason].sum()))
        raise InputError(f"{path}: none of the {n:,} Gaussians can be used: {worst}")
    return keep, warnings


def _activate(table: Float) -> Gaussians:
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
    return Gaussians(
        np.ascontiguousarray(table[:, :3]), scales.astype(np.float32), quats.astype(np.float32), opacities, sh
    )
