"""Lengths as the user reads them: captures have no scale of their own until the user has given one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

__all__ = ["LENGTHS", "UNITS", "Unit", "UnitName", "round_length"]

UnitName = Literal["units", "mm", "cm", "m", "in"]
UNITS: tuple[UnitName, ...] = get_args(UnitName)

LENGTHS = (1e-9, 1e9)
"""Range of the length of a unit of the file: outside it, one of the two lengths it was computed from makes no sense."""

METRES: dict[UnitName, float] = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}

POWERS = {1: "", 2: "²", 3: "³"}


@dataclass(frozen=True)
class Unit:
    """What lengths are given in."""

    name: UnitName = "units"
    """Name of the unit; 'units' are those of the file."""
    length: float = 1.0
    """Length of a unit of the file, in this unit. Range LENGTHS."""

    @property
    def metres(self) -> float:
        """Length of a unit of the file in metres; 1, as other programs assume, if the user has not given it."""
        return self.length * METRES[self.name] if self.name in METRES else 1.0

    def named(self, name: UnitName) -> Unit:
        """The same lengths in another unit; going back to 'units' forgets the length."""
        if name == "units":
            return Unit()
        known = self.length * METRES[self.name] / METRES[name] if self.name in METRES else self.length
        return Unit(name, min(max(known, LENGTHS[0]), LENGTHS[1]))

    def text(self, value: float, power: int = 1) -> str:
        """A length, an area (`power` 2) or a volume (3) in units of the file, as text with three digits."""
        value *= self.length**power
        digits = 2 - math.floor(math.log10(abs(value))) if value else 0
        shown = f"{value:.2e}" if not -7 < digits < 7 else f"{round(value, digits):,.{max(digits, 0)}f}"
        return f"{shown} {self.name}{POWERS[power]}"


def round_length(longest: float) -> float:
    """The longest of 1, 2, 5, 10, 20, ... that is not above `longest`, for a scale bar. Range (0, inf)."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(step * power for step in (1, 2, 5) if step * power <= longest)
