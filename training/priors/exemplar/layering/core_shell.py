"""The closed shell around a core, such as an apple's: a line in pictures, which is a ring in horizontal ones.

Extruded along the axis the ring would become a tube, and the outline in the radial pictures a barrel beside it. The
line is therefore removed from all pictures and drawn as the one shell of which both are sections; the ground is bent
to follow it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.inside import InsideRecord
from training.priors.exemplar.layering.decompose import Layers
from training.priors.exemplar.layering.places import Places
from training.priors.exemplar.outline import ANGLES, UNDER
from training.priors.exemplar.patches import OVER
from training.priors.exemplar.record import RecordReader
from training.priors.exemplar.sampling import read_bilinear

__all__ = ["CoreShell", "extract_core_shell"]

OUTLINE_ANGLES = 91
"""Directions, from straight down to straight up, in which an outline is sampled."""

MIN_CLOSED = 0.9
"""Share of an outline's length that must show a line for it to enclose a core: an apple's is 1.0."""

MIN_RING = 0.6
"""Share of the ring's length that must show a line. The ring is fainter: an apple's is 0.81; a pomegranate's membranes
reach 0.35."""

INNER, OUTER = 0.15, 0.75
"""Range of the search for an outline, as shares of the way to the skin: excludes rind and pith."""

RING_TOLERANCE = 0.35
"""Largest distance of the ring from where the outlines cross its plane, relative to their distance from the axis."""

HALF_WIDTH = 2.0
"""Half width, in cells, of the band removed around a line."""


@dataclass(frozen=True)
class CoreShell:
    """The shell around a core, and its line in the horizontal picture."""

    ring: NDArray[np.float32]
    """(ANGLES,). Distance of the ring from the centre of the horizontal picture, counter-clockwise from the right,
    cells."""
    outline: NDArray[np.float32]
    """(OUTLINE_ANGLES,). Distance of the outline from the centre of a radial picture, from straight down to straight
    up, cells."""
    half: tuple[float, float]
    """Half width and half height of the radial pictures' cut face in cells."""
    line: NDArray[np.float32]
    """(H, W). Opacity of the line in the horizontal picture."""

    def shell(
        self, places: Places, angle: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(M,), (M,), (M,). For points at angles (M,): signed distance beyond the shell, the shell's distance from the
        centre in that direction, and the ring's in the horizontal picture. All in cells.
        """
        across = places.across * self.half[0]
        up = places.height * self.half[1]
        turn = (np.arctan2(up, across) / np.pi + 0.5) * (OUTLINE_ANGLES - 1)
        outline = np.interp(turn, np.arange(OUTLINE_ANGLES), self.outline)
        ring = np.interp(angle, (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi, self.ring, period=2 * np.pi)
        # Follows the ring at the height of the centre and becomes round at the poles.
        away = np.hypot(across, up)
        wide = 1 + (ring / self.outline[OUTLINE_ANGLES // 2] - 1) * across / np.maximum(away, 1e-6)
        return away - outline * wide, outline * wide, ring

    def line_at(self, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M, 1). Opacity of the line at places in the horizontal picture, cells."""
        return read_bilinear(self.line[..., None], y * OVER, x * OVER)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same shell."""
        return {"ring": self.ring, "outline": self.outline, "line": self.line}, {"half": list(self.half)}

    @classmethod
    def restored(cls, record: RecordReader, pixels: tuple[int, int]) -> CoreShell:
        """The shell in a `record`, for a picture of (H, W) pixels. Raises ValueError if the record is not valid."""
        return cls(
            record.array("ring", np.float32, (ANGLES,)),
            record.array("outline", np.float32, (OUTLINE_ANGLES,)),
            record.pair("half"),
            record.array("line", np.float32, pixels),
        )


def extract_core_shell(carrier: Layers, radial: Sequence[Layers]) -> tuple[CoreShell | None, Layers, list[Layers]]:
    """The shell of which all pictures show sections, and the layers of the pictures without it.

    None and the unchanged layers if a radial picture shows no closed outline, or the horizontal one no ring where the
    outlines cross its plane.
    """
    no_core = (None, carrier, list(radial))
    half = radial[0].source.half
    turn = np.linspace(-np.pi / 2, np.pi / 2, OUTLINE_ANGLES)
    reach = np.arange(max(1, int(min(half) * OVER))) / OVER
    outlines, bare_layers = [], []
    for parts in radial:
        (across, up), scale = parts.source.middle, np.divide(parts.source.half, half)
        lines, structure = _lines(parts), parts.structure
        away, at = _polar(parts)
        for side in (1, -1):
            x = across + side * scale[0] * reach * np.cos(turn)[:, None]
            y = up - scale[1] * reach * np.sin(turn)[:, None]
            seen = _at(lines, x, y)
            rim = parts.source.rim(turn if side == 1 else np.pi - turn)[:, None] / scale.mean()
            seen[(reach < INNER * rim) | (reach > OUTER * rim)] = 0
            path = _best_path(seen)
            if seen[np.arange(OUTLINE_ANGLES), path].mean() < MIN_CLOSED:
                return no_core
            outlines.append(reach[path])
            outline_distance = np.interp(np.arctan2(np.sin(at), side * np.cos(at)), turn, scale.mean() * reach[path])
            structure = structure * ((np.abs(away - outline_distance) > HALF_WIDTH) | (side * np.cos(at) < 0))
        bare_layers.append(replace(parts, structure=structure))
    outline = ndimage.gaussian_filter1d(np.mean(outlines, axis=0), 1.5, mode="nearest").astype(np.float32)
    expected = float(outline[OUTLINE_ANGLES // 2])
    scaled = carrier.source
    angle = (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi
    near = (1 - RING_TOLERANCE) * expected + np.arange(max(1, int(2 * RING_TOLERANCE * expected * OVER))) / OVER
    x = scaled.middle[0] + near * np.cos(angle)[:, None]
    y = scaled.middle[1] - near * np.sin(angle)[:, None]
    shown = _at(_lines(carrier), x, y)
    ring_path = _best_path(np.concatenate([shown] * 3))[ANGLES : 2 * ANGLES]
    if shown[np.arange(ANGLES), ring_path].mean() < MIN_RING:
        return no_core
    ring = ndimage.gaussian_filter1d(near[ring_path], 1.0, mode="wrap").astype(np.float32)
    away, at = _polar(carrier)
    band = np.abs(away - np.interp(at, angle, ring, period=2 * np.pi)) < HALF_WIDTH
    contrast = np.linalg.norm(scaled.rgb - carrier.ground, axis=-1) * band
    # Thin lines are faint: full opacity is the strongest contrast nearby.
    line = np.clip(contrast / np.maximum(ndimage.maximum_filter(contrast, round(4 * HALF_WIDTH * OVER)), 0.02), 0, 1)
    on_line = ndimage.maximum(band, carrier.labels, [d.label for d in carrier.details])
    details = [d for d, inside in zip(carrier.details, on_line, strict=True) if not inside]
    keep = np.isin(carrier.labels, [d.label for d in details])
    bare = replace(
        carrier,
        structure=carrier.structure * ~band,
        detail=carrier.detail * keep,
        labels=carrier.labels * keep,
        details=details,
    )
    core = CoreShell(ring, outline, half, line.astype(np.float32))
    return core, bare, bare_layers


def _lines(parts: Layers) -> NDArray[np.float32]:
    """(H, W). Possible lines inside the rind; doubled, as the middle of a thin line is not fully opaque."""
    marks = np.maximum(parts.structure, parts.detail) * (parts.source.depth > UNDER * parts.rind)
    return np.minimum(2 * marks, 1)


def _polar(parts: Layers) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(H, W), (H, W). Distance of each pixel from the picture's centre in cells, and angle in radians, positive
    upwards."""
    height, width = parts.structure.shape
    x = np.arange(width) / OVER - parts.source.middle[0]
    y = parts.source.middle[1] - np.arange(height)[:, None] / OVER
    return np.hypot(x, y), np.arctan2(y, x)


def _at(picture: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(...). Bilinear values of (H, W) at places in cells."""
    return ndimage.map_coordinates(picture, np.stack([y, x]) * OVER, order=1, output=np.float32)


def _best_path(seen: NDArray[np.float32]) -> NDArray[np.intp]:
    """(R,). Columns of the path of largest sum down the rows of (R, C), at most two columns sideways per row."""
    total, steps_back = seen[0], []
    for row in seen[1:]:
        padded = np.pad(total, 2, constant_values=-np.inf)
        # The small penalty prefers straight paths among equals.
        candidates = np.stack([padded[2 + d : len(padded) - 2 + d] - 1e-3 * abs(d) for d in (0, -1, 1, -2, 2)])
        steps_back.append(np.array([0, -1, 1, -2, 2])[candidates.argmax(0)])
        total = row + candidates.max(0)
    path = [int(total.argmax())]
    for step in steps_back[::-1]:
        path.append(path[-1] + int(step[path[-1]]))
    return np.array(path[::-1])
