"""Exemplar pictures of a scene's cut faces, cropped as from a photograph."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.io.picture_file import save_png
from engine.scene.camera import Camera, equator, section
from engine.scene.image import to_8bit
from engine.scene.plane import Plane
from sample_scenes.solids import Solid
from training.families import Kind

__all__ = ["crop", "photograph", "planes", "save_photographs", "snapshot"]

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


WHITE_BALANCE = (1.06, 1.0, 0.82)
"""Channel gains that lamplight gives a picture white-balanced for daylight."""

SQUASHED = 0.9
"""Height of a snapshot's face over that of the solid's: no two fruits have the same outline."""

SHADOW, SHADOW_OFFSET, SHADOW_BLUR = 0.35, (0.03, 0.02), 0.015
"""Darkness of a drop shadow, its offset (down, right) and its blur, the last two over the picture's side."""


def planes(solid: Solid, kind: Kind) -> list[Plane]:
    """The planes of a family's two or three exemplars."""
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
    return to_8bit(rgb)


def save_photographs(solid: Solid, kind: Kind, folder: Path, size: int) -> tuple[Path, ...]:
    """Writes the photographs of a family of cuts, and returns their paths."""
    paths = []
    for number, plane in enumerate(planes(solid, kind), start=1):
        paths.append(folder / f"{kind}_{number}.png")
        save_png(paths[-1], photograph(solid, plane, size), optimize=True)
    return tuple(paths)


def snapshot(solid: Solid, plane: Plane, size: int) -> NDArray[np.uint8]:
    """(size, size, 3). The face as somebody else might photograph it: in lamplight, squashed, over its drop shadow."""
    rgb, inside = solid.slice(plane, crop(solid, plane, size), supersample=SUPERSAMPLE)
    at = np.mgrid[:size, :size].astype(np.float64)
    at[0] = (at[0] - (size - 1) / 2) / SQUASHED + (size - 1) / 2
    face = np.stack([ndimage.map_coordinates(rgb[..., c], at, order=1, cval=1.0) for c in range(3)], -1)
    cover = ndimage.map_coordinates(inside.astype(np.float64), at, order=1)[..., None]
    shifted = ndimage.shift(cover[..., 0], np.array(SHADOW_OFFSET) * size, order=1)
    ground = 1 - SHADOW * ndimage.gaussian_filter(shifted, SHADOW_BLUR * size)[..., None]
    lit = np.where(cover > 0, face * WHITE_BALANCE, 1)
    return to_8bit(cover * lit + (1 - cover) * ground)
