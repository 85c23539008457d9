"""The constants of the image as shader defines, by name: the same that the kernels use."""

from __future__ import annotations

from engine.scene import constants as formula
from engine.scene import sh

__all__ = ["CONSTANTS"]

CONSTANTS: dict[str, int | float] = {
    **{name: float(getattr(formula, name)) for name in formula.__all__},
    "SH_C0": sh.C0,
    "SH_C1": sh.C1,
    **{f"SH_C2_{k}": value for k, value in enumerate(sh.C2)},
    **{f"SH_C3_{k}": value for k, value in enumerate(sh.C3)},
}
"""Defines of every shader."""
