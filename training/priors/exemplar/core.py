"""The line around a core, as an apple has one: a closed shell, of which a horizontal picture shows a ring.

Carried straight along the axis the ring would be a tube and the radial pictures' outline a barrel beside it. So the
line is taken out of all pictures and drawn as the one shell that both are sections of; the ground bends with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.decompose import Layers
from training.priors.exemplar.frames import ANGLES, Space
from training.priors.exemplar.patches import OVER

__all__ = ["Core", "take_core"]

TURNS = 91
"""Directions from straight down to straight up in which an outline is known."""

CLOSED = 0.9
"""Share of its way along which something must be seen for an outline to be a line around a core: an apple's is 1.0."""

RINGED = 0.6
"""The same of a ring, which is fainter: an apple's is 0.81, a pomegranate's membranes cross one on 0.35 of its way."""

INNER, OUTER = 0.15, 0.75
"""Where an outline is looked for, of the way to the skin: a rind is none, nor is a pith."""

AROUND = 0.35
"""How far a ring may be from where the outlines cross its plane, of their distance from the axis."""

WIDTH = 2.0
"""Half width in cells of the band that is taken out of a picture with a line in it."""


@dataclass(frozen=True)
class Core:
    """The shell, and the line as the horizontal picture shows it."""

    ring: NDArray[np.float32]
    """(ANGLES,). Its distance from the centre of the horizontal picture, counter-clockwise from the right, cells."""
    outline: NDArray[np.float32]
    """(TURNS,). Its distance from the centre of a radial picture, from straight down to straight up, cells."""
    half: tuple[float, float]
    """Half width and half height of the radial pictures' cut face in cells."""
    line: NDArray[np.float32]
    """(H, W). Opacity of the line in the horizontal picture."""

    def shell(
        self, space: Space, part: slice, angle: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(M,), (M,), (M,). How far voxels at angles (M,) lie beyond the shell; its distance from the centre there.

        And that of the ring in the horizontal picture; all in cells.
        """
        across = space.radius[part] / space.widest * self.half[0]
        up = space.height[part] * self.half[1]
        turn = (np.arctan2(up, across) / np.pi + 0.5) * (TURNS - 1)
        outline = np.interp(turn, np.arange(TURNS), self.outline)
        ring = np.interp(angle, (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi, self.ring, period=2 * np.pi)
        # The ring at the height of the centre, round at the poles.
        away = np.hypot(across, up)
        wide = 1 + (ring / self.outline[TURNS // 2] - 1) * across / np.maximum(away, 1e-6)
        return away - outline * wide, outline * wide, ring


def take_core(carrier: Layers, radial: Sequence[Layers]) -> tuple[Core | None, Layers, list[Layers]]:
    """The shell that a horizontal and the radial pictures show sections of, and the pictures without it.

    None, and the pictures as they are, where the radial ones do not all show one closed outline or the horizontal one
    no ring where it would be met.
    """
    nothing = (None, carrier, list(radial))
    half = radial[0].sheet.half
    turn = np.linspace(-np.pi / 2, np.pi / 2, TURNS)
    reach = np.arange(max(1, int(min(half) * OVER))) / OVER
    outlines, without = [], []
    for parts in radial:
        (across, up), scale = parts.sheet.middle, np.divide(parts.sheet.half, half)
        lines, structure = _lines(parts), parts.structure
        away, at = _polar(parts)
        for side in (1, -1):
            x = across + side * scale[0] * reach * np.cos(turn)[:, None]
            y = up - scale[1] * reach * np.sin(turn)[:, None]
            seen = _at(lines, x, y)
            rim = parts.sheet.rim(turn if side == 1 else np.pi - turn)[:, None] / scale.mean()
            seen[(reach < INNER * rim) | (reach > OUTER * rim)] = 0
            path = _path(seen)
            if seen[np.arange(TURNS), path].mean() < CLOSED:
                return nothing
            outlines.append(reach[path])
            there = np.interp(np.arctan2(np.sin(at), side * np.cos(at)), turn, scale.mean() * reach[path])
            structure = structure * ((np.abs(away - there) > WIDTH) | (side * np.cos(at) < 0))
        without.append(replace(parts, structure=structure))
    outline = ndimage.gaussian_filter1d(np.mean(outlines, axis=0), 1.5, mode="nearest").astype(np.float32)
    expected = float(outline[TURNS // 2])
    sheet = carrier.sheet
    angle = (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi
    near = (1 - AROUND) * expected + np.arange(max(1, int(2 * AROUND * expected * OVER))) / OVER
    x = sheet.middle[0] + near * np.cos(angle)[:, None]
    y = sheet.middle[1] - near * np.sin(angle)[:, None]
    shown = _at(_lines(carrier), x, y)
    around = _path(np.concatenate([shown] * 3))[ANGLES : 2 * ANGLES]
    if shown[np.arange(ANGLES), around].mean() < RINGED:
        return nothing
    ring = ndimage.gaussian_filter1d(near[around], 1.0, mode="wrap").astype(np.float32)
    away, at = _polar(carrier)
    band = np.abs(away - np.interp(at, angle, ring, period=2 * np.pi)) < WIDTH
    contrast = np.linalg.norm(sheet.rgb - carrier.ground, axis=-1) * band
    # Thin and faint as it is, a line is opaque where it is clearest around.
    line = np.clip(contrast / np.maximum(ndimage.maximum_filter(contrast, round(4 * WIDTH * OVER)), 0.02), 0, 1)
    dots = ndimage.maximum(band, carrier.labels, [d.label for d in carrier.details])
    details = [d for d, inside in zip(carrier.details, dots, strict=True) if not inside]
    keep = np.isin(carrier.labels, [d.label for d in details])
    plain = replace(
        carrier,
        structure=carrier.structure * ~band,
        detail=carrier.detail * keep,
        labels=carrier.labels * keep,
        details=details,
    )
    core = Core(ring, outline, half, line.astype(np.float32))
    return core, plain, without


def _lines(parts: Layers) -> NDArray[np.float32]:
    """(H, W). What may be a line inside of the rind; the middle of a thin one is not quite opaque."""
    marks = np.maximum(parts.structure, parts.detail) * (parts.sheet.depth > 1.2 * parts.rind)
    return np.minimum(2 * marks, 1)


def _polar(parts: Layers) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(H, W), (H, W). Distance of each pixel from the picture's centre in cells, and angle, up being positive."""
    height, width = parts.structure.shape
    x = np.arange(width) / OVER - parts.sheet.middle[0]
    y = parts.sheet.middle[1] - np.arange(height)[:, None] / OVER
    return np.hypot(x, y), np.arctan2(y, x)


def _at(picture: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(...). Bilinear values of (H, W) at places in cells."""
    return ndimage.map_coordinates(picture, np.stack([y, x]) * OVER, order=1, output=np.float32)


def _path(seen: NDArray[np.float32]) -> NDArray[np.intp]:
    """(R,). The path of greatest sum down the rows of (R, C), from row to row two columns sideways at most."""
    total, came = seen[0], []
    for row in seen[1:]:
        padded = np.pad(total, 2, constant_values=-np.inf)
        # Of equals the one that goes straight on.
        steps = np.stack([padded[2 + d : len(padded) - 2 + d] - 1e-3 * abs(d) for d in (0, -1, 1, -2, 2)])
        came.append(np.array([0, -1, 1, -2, 2])[steps.argmax(0)])
        total = row + steps.max(0)
    path = [int(total.argmax())]
    for step in came[::-1]:
        path.append(path[-1] + int(step[path[-1]]))
    return np.array(path[::-1])
