"""Reads arrays and facts of a file and checks each of them: the file may come from anybody."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from engine.scene.inside import InsideRecord

__all__ = ["MOST_SEED", "MOST_SHEETS", "RecordReader", "nested"]

MOST_SHEETS = 40
"""Largest number of pictures of an inside: 20 of each family."""

MOST_SEED = 1 << 63


def nested(parts: Mapping[str, InsideRecord]) -> InsideRecord:
    """One record that holds the records of several parts, by their names."""
    arrays = {f"{name}.{key}": array for name, (own, _) in parts.items() for key, array in own.items()}
    return arrays, {name: facts for name, (_, facts) in parts.items()}


@dataclass(frozen=True)
class RecordReader:
    """Reads an `InsideRecord`. Every method raises ValueError if the record lacks what is asked for."""

    arrays: Mapping[str, NDArray[Any]]
    facts: Mapping[str, Any]

    def array(self, name: str, dtype: DTypeLike, shape: Sequence[int | None]) -> NDArray[Any]:
        """An array of finite numbers of this type and shape; None is any length of at least 1."""
        array = self.arrays.get(name)
        if array is None or array.dtype != dtype or len(array.shape) != len(shape):
            raise ValueError(f"no {name}")
        if any(side < 1 if wanted is None else side != wanted for wanted, side in zip(shape, array.shape, strict=True)):
            raise ValueError(f"a wrong {name}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
        return array

    def number(self, name: str, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number within [low, high]."""
        value: Any = self.facts.get(name)
        if type(value) not in (int, float) or not math.isfinite(value) or not low <= value <= high:
            raise ValueError(f"no {name}, or a wrong one")
        return float(value)

    def pair(self, name: str) -> tuple[float, float]:
        """Two finite numbers."""
        values: Any = self.facts.get(name)
        if not isinstance(values, list) or len(values) != 2:
            raise ValueError(f"no {name}")
        first, second = (RecordReader({}, {name: value}).number(name) for value in values)
        return first, second

    def count(self, name: str, most: int) -> int:
        """A whole number within [0, most]."""
        value: Any = self.facts.get(name)
        if type(value) is not int or not 0 <= value <= most:
            raise ValueError(f"no {name}, or a wrong one")
        return value

    def flag(self, name: str) -> bool:
        """True or false."""
        value: Any = self.facts.get(name)
        if type(value) is not bool:
            raise ValueError(f"no {name}")
        return value

    def has(self, name: str) -> bool:
        """Whether there is a part of this name."""
        return name in self.facts

    def part(self, name: str) -> RecordReader:
        """A reader of the part of this name."""
        start = f"{name}."
        mine = {key.removeprefix(start): array for key, array in self.arrays.items() if key.startswith(start)}
        facts: Any = self.facts.get(name)
        if not isinstance(facts, dict):
            raise ValueError(f"no {name}")
        return RecordReader(mine, facts)
