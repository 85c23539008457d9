"""The colours that a running training has reached, from its checkpoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from safetensors import SafetensorError, safe_open

from engine.atoms import Atoms

__all__ = ["Watch"]

STAGES = ("labels", "training")
"""Checkpoints that hold colours, in the order in which they appear."""


class Watch:
    """Looks into a result folder for colours newer than the last ones."""

    def __init__(self, out: Path) -> None:
        self.folder = out / "checkpoint"
        self._seen: tuple[str, int] | None = None

    def newer(self, atoms: Atoms) -> Atoms | None:
        """The same atoms in the latest colours; None where there is nothing new, or nothing that fits.

        The trainer makes its atoms from the same scene by the same steps, so they come in the same order. Where the
        counts differ (another detail, another version) the colours are left alone.
        """
        latest = None
        for stage in STAGES:
            try:
                latest = (stage, (self.folder / f"{stage}.safetensors").stat().st_mtime_ns)
            except OSError:
                continue
        if latest is None or latest == self._seen:
            return None
        self._seen = latest
        try:
            with safe_open(self.folder / f"{latest[0]}.safetensors", framework="np") as file:
                names = set(file.keys())
                rgb = file.get_tensor("rgb") if "rgb" in names else None
                sh = file.get_tensor("sh") if "sh" in names else None
        except (SafetensorError, OSError):
            return None
        surface, interior = atoms.surface, atoms.interior
        if rgb is None or rgb.shape != interior.rgb.shape or (sh is not None and sh.shape != surface.sh.shape):
            return None
        return Atoms(
            surface if sh is None else replace(surface, sh=sh), replace(interior, rgb=rgb.clip(0, 1)), atoms.pitch
        )
