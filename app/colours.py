"""The colours that a running training has reached, from its checkpoints."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from engine.atoms import Atoms

__all__ = ["Watch"]

STAGES = ("surface", "labels", "training")
"""Checkpoints that hold colours, in the order in which they appear; the later one counts."""


class Watch:
    """Looks into a result folder for colours newer than the last ones."""

    def __init__(self, out: Path) -> None:
        self.folder = out / "checkpoint"
        self._seen: tuple[tuple[str, int], ...] = ()

    def forget(self) -> None:
        """Everything is new again: for atoms that have none of the colours yet."""
        self._seen = ()

    def newer(self, atoms: Atoms) -> Atoms | None:
        """The same atoms in the latest colours; None where there is nothing new, or nothing that fits.

        The trainer makes its atoms from the same scene by the same steps, so they come in the same order. Where the
        counts differ (another detail, another version) the colours are left alone. The skin may come with spherical
        harmonics of another degree.
        """
        written = []
        for stage in STAGES:
            with contextlib.suppress(OSError):
                written.append((stage, (self.folder / f"{stage}.safetensors").stat().st_mtime_ns))
        if not written or tuple(written) == self._seen:
            return None
        self._seen = tuple(written)
        found: dict[str, NDArray[np.float32]] = {}
        for stage, _ in written:
            with (
                contextlib.suppress(SafetensorError, OSError),
                safe_open(self.folder / f"{stage}.safetensors", framework="np") as file,
            ):
                found |= {name: file.get_tensor(name) for name in ("rgb", "sh") if name in set(file.keys())}
        surface, interior = atoms.surface, atoms.interior
        rgb, sh = found.get("rgb", interior.rgb), found.get("sh", surface.sh)
        if not found or rgb.shape != interior.rgb.shape or sh.ndim != 3 or len(sh) != len(surface):
            return None
        return Atoms(replace(surface, sh=sh), replace(interior, rgb=rgb.clip(0, 1)), atoms.pitch)
