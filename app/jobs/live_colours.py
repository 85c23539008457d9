"""The colours that a running training job has reached so far, read from its checkpoints."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from engine.scene.atoms import Atoms, InteriorAtoms

__all__ = ["LiveColours"]

STAGES = ("surface", "labels", "training")
"""Checkpoints that hold colours, in the order in which a run writes them; later ones override earlier ones."""


class LiveColours:
    """Reads colours from a result folder whenever they have changed."""

    def __init__(self, out: Path) -> None:
        self.folder = out / "checkpoint"
        self._seen: tuple[tuple[str, int], ...] = ()

    def reset(self) -> None:
        """Makes `newer` read the checkpoints again, for atoms that do not have these colours yet."""
        self._seen = ()

    def newer(self, atoms: Atoms) -> Atoms | None:
        """The atoms with the latest colours; None if there are no new ones, or if they do not fit.

        The trainer makes the surface atoms from the same scene by the same steps, so they have the same order; colours
        for a different number of atoms (from another detail or version) do not fit. A checkpoint may bring interior
        atoms of its own, as fine as the colours require, and spherical harmonics of another degree for the surface.
        """
        written = []
        for stage in STAGES:
            with contextlib.suppress(OSError):
                written.append((stage, (self.folder / f"{stage}.safetensors").stat().st_mtime_ns))
        if not written or tuple(written) == self._seen:
            return None
        self._seen = tuple(written)
        tensors: dict[str, NDArray[np.float32]] = {}
        for stage, _ in written:
            with (
                contextlib.suppress(SafetensorError, OSError, ValueError, TypeError, RecursionError),
                safe_open(self.folder / f"{stage}.safetensors", framework="np") as file,
            ):
                names = {"means", "sigmas", "rgb", "sh"} & set(file.keys())
                tensors |= {name: file.get_tensor(name) for name in names}
        surface, interior = atoms.surface, atoms.interior
        means, sigmas = tensors.get("means", interior.means), tensors.get("sigmas", interior.sigmas)
        rgb, sh = tensors.get("rgb", interior.rgb), tensors.get("sh", surface.sh)
        # The folder may come from anybody: arrays that do not fit, or cannot be drawn, are ignored.
        finite = all(values.dtype == np.float32 and np.isfinite(values).all() for values in (means, sigmas, rgb, sh))
        fits = sigmas.ndim == 1 and rgb.shape == means.shape == (len(sigmas), 3) and bool((sigmas > 0).all())
        fits = fits and sh.shape in {(len(surface), (degree + 1) ** 2, 3) for degree in range(4)}
        if not (tensors and finite and fits):
            return None
        if not np.array_equal(means, interior.means):
            interior = InteriorAtoms(means, sigmas, rgb)
        return Atoms(replace(surface, sh=sh), replace(interior, rgb=rgb.clip(0, 1)), atoms.pitch)
