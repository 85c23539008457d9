"""The state from which a run resumes: arrays in safetensors files, written atomically."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from engine.errors import InputError
from engine.io.files import atomic, remove

__all__ = ["CHECKPOINT_SECONDS", "Checkpoint"]

Array = NDArray[Any]

CHECKPOINT_SECONDS = 15.0
"""Seconds between two checkpoints of one stage: the most work that a kill can lose."""


class Checkpoint:
    """A folder with the stages of one run. Stages of another run (other input or settings) are refused."""

    def __init__(self, folder: Path, run: str) -> None:
        """`run` is a fingerprint of input and settings, stored in every stage."""
        self.folder = folder
        self.run = run

    def path(self, stage: str) -> Path:
        """The file of a stage."""
        return self.folder / f"{stage}.safetensors"

    def save(self, stage: str, arrays: dict[str, Array], facts: dict[str, Any]) -> Path:
        """Writes arrays and JSON facts atomically; returns the path."""
        text = json.dumps(facts)
        contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        metadata = {"run": self.run, "facts": text, "crc32": str(_crc32(arrays, text))}
        with atomic(self.path(stage)) as temporary:
            save_file(contiguous, temporary, metadata)
        return self.path(stage)

    def load(self, stage: str) -> tuple[dict[str, Array], dict[str, Any]] | None:
        """Arrays and facts of a stage, None if it was not reached.

        Raises InputError if the file is damaged or belongs to another run.
        """
        path = self.path(stage)
        if not path.exists():
            return None
        try:
            with safe_open(path, framework="np") as file:
                metadata = file.metadata() or {}
                arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
            facts = json.loads(metadata["facts"])
            if metadata["crc32"] != str(_crc32(arrays, metadata["facts"])):
                raise ValueError("checksum")  # safetensors has none: a flipped bit would go unnoticed
        except (SafetensorError, OSError, KeyError, ValueError) as error:
            raise InputError(f"{path}: not a readable checkpoint; start again without --resume") from error
        if metadata.get("run") != self.run:
            raise InputError(f"{path}: made from another input or with other settings; start again without --resume")
        return arrays, facts

    def load_or_make(
        self, stage: str, make: Callable[[], tuple[dict[str, Array], dict[str, Any]]]
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and facts of a stage, from its file or else from `make`, then saved. Raises InputError as `load`."""
        stored = self.load(stage)
        if stored is None:
            stored = make()
            self.save(stage, *stored)
        return stored

    def clear(self) -> None:
        """Deletes every stage."""
        for path in self.folder.glob("*.safetensors"):
            remove(path)


def _crc32(arrays: dict[str, Array], facts: str) -> int:
    """CRC-32 of the contents of a stage."""
    crc = zlib.crc32(facts.encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        crc = zlib.crc32(f"{name} {array.dtype} {array.shape}".encode(), crc)
        crc = zlib.crc32(array.data, crc) if array.size else crc
    return crc
