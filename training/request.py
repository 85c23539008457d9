"""What a run is asked for, and what is fixed once its atoms stand."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from engine.io.files import open_file
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from training.families import Family
from training.settings import DETAILS, Detail, DetailName

__all__ = ["Geometry", "Interrupted", "PriorName", "Request"]

PriorName = Literal["exemplar", "stable-diffusion"]

FORMAT = 2
"""Of what a run keeps to go on from; grows with every change of it, so that no run goes on from another version's."""


class Interrupted(Exception):
    """The user stopped the run; what was done is kept."""


@dataclass(frozen=True)
class Request:
    """Everything that decides the result of a run."""

    scene: Path
    families: tuple[Family, ...]
    detail: DetailName = "standard"
    up: tuple[float, float, float] | None = None
    """None: detected."""
    seed: int = 0
    iterations: int | None = None
    """Most iterations; None: as the detail says."""
    prior: PriorName = "exemplar"
    model: Path | None = None
    """Folder of the model that `stable-diffusion` asks."""
    midas: Path | None = None
    """Folder of a depth estimator, to be heard beside the exact depth."""
    thing: str | None = None
    """What the object is called in prompts; None: as the scene's file."""

    @property
    def fineness(self) -> Detail:
        """The numbers behind the detail's name."""
        return DETAILS[self.detail]

    def fingerprint(self) -> str:
        """A name for input and settings: the same for the same result."""
        digest = hashlib.sha256(f"{FORMAT}".encode())
        for path in [self.scene, *(p for family in self.families for p in family.exemplars)]:
            with open_file(path) as file:
                while block := file.read(1 << 20):
                    digest.update(block)
        for folder in filter(None, (self.model, self.midas)):
            for path in sorted(folder.rglob("*.safetensors")):  # gigabytes: size and time must do for their content
                digest.update(f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}".encode())
        digest.update(json.dumps(asdict(self), sort_keys=True, default=str).encode())
        return digest.hexdigest()[:16]


@dataclass(frozen=True)
class Geometry:
    """What is fixed before anybody paints the inside."""

    gaussians: Gaussians
    """The capture."""
    skin: SurfaceAtoms
    """With the capture's own colours."""
    pitch: float
    """Of the skin, world units."""
    body: Body
    up: NDArray[np.float64]
    """(3,). Unit vector."""

    def filled(self, interior: InteriorAtoms) -> Atoms:
        """The whole object with such an inside."""
        return Atoms(self.skin, interior, self.pitch)
