"""A piece of an object: the part that planes leave, moved rigidly."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from engine.scene.camera import Camera
from engine.scene.plane import Plane

__all__ = ["Piece"]


@dataclass(frozen=True)
class Piece:
    """A convex part of an object's space with a rigid motion. All pieces of an object share its atoms."""

    planes: tuple[Plane, ...] = ()
    """Half-spaces in object coordinates; the piece is the intersection of their kept sides. Empty: the whole object."""
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    """(4, 4). Rigid. World point = transform @ object point."""
    solid: int = 0
    """Index of the drawn solid that it is a piece of."""

    def camera(self, camera: Camera) -> Camera:
        """The same view with object coordinates as world coordinates."""
        return replace(camera, viewmat=camera.viewmat @ self.transform)
