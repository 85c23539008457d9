"""Exemplar pictures of a scene's cut faces, cropped as from a photograph."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from engine.scene.camera import Camera, equator, section
from engine.scene.plane import Plane
from sample_scenes.solids import Solid
from training.families import Kind

__all__ = ["crop", "photograph", "planes"]

FRAME = 0.85
"""Longer side of the face over that of the picture."""

SUPERSAMPLE = 4
"""Samples along a side of a pixel: enough for smooth edges at 8 bits."""

HEIGHTS = (0.04, 0.42, -0.5)
"""Heights of horizontal faces, as fractions of the half height; the first is nearly the widest."""

AZIMUTHS = (25.0, 100.0, 155.0)
"""Azimuths of radial faces in degrees; spread so that no two show the same parts."""

ALONG = (-0.35, 0.1, 0.55)
"""Positions of parallel faces, as fractions of the half length."""


def planes(solid: Solid, kind: Kind) -> list[Plane]:
    """The planes of this family's two or three exemplars."""
    low, high = solid.bounds
    centre, half = (low + high) / 2, (high - low) / 2
    up = np.asarray(solid.up)
    if kind == "horizontal":
        return [Plane.through(centre + f * half * up, up) for f in HEIGHTS[:2]]
    e1, e2 = equator(up)
    if kind == "radial":
        angles = [math.radians(a) for a in AZIMUTHS[:2]]
        return [Plane.through(centre, np.cross(math.cos(a) * e1 + math.sin(a) * e2, up)) for a in angles]
    longest = e1 if abs(half @ e1) >= abs(half @ e2) else e2
    return [Plane.through(centre + f * half * longest, longest) for f in ALONG]


def crop(solid: Solid, plane: Plane, size: int) -> Camera:
    """The camera that looks straight at the face, centred on it, with the face filling FRAME of size x size pixels."""
    wide = section(plane, solid.up, solid.bounds, 256)
    rows, columns = np.nonzero(solid.silhouette(plane, wide))
    low = np.array([columns.min(), rows.min()])
    high = np.array([columns.max(), rows.max()]) + 1
    zoom = FRAME * size / float((high - low).max())
    centre = size / 2 + ((np.array([wide.cx, wide.cy]) - (low + high) / 2) * zoom)
    scale = wide.fx * zoom
    return Camera(wide.viewmat, scale, scale, float(centre[0]), float(centre[1]), size, size, orthographic=True)


def photograph(solid: Solid, plane: Plane, size: int) -> NDArray[np.uint8]:
    """(size, size, 3). The face over white, antialiased, 8 bits."""
    rgb, _ = solid.slice(plane, crop(solid, plane, size), supersample=SUPERSAMPLE)
    return (np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
