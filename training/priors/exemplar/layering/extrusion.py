"""Extrudes the layers of a picture along the axis that it does not show.

Structures run straight through; the texture drifts sideways, so that it is as fine along the axis as the pictures
show; details are left to `scatter`. Radial pictures then correct the result by height (`correction`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from training.priors.exemplar.layering.core_line import Core
from training.priors.exemplar.layering.correction import Correction
from training.priors.exemplar.layering.decompose import Layers
from training.priors.exemplar.layering.height_mask import HeightMask
from training.priors.exemplar.layering.places import Places, Shape
from training.priors.exemplar.layering.sheet import GROUND, PICTURE, STRUCTURE, TEXTURE, THROUGH, Sheet
from training.priors.exemplar.record import RecordReader, nested

__all__ = ["Drift", "Extrusion"]

WAVINESS = 0.035
"""Waviness of structures along the axis, radians: a cut along a straight membrane one voxel thick shows the grid."""

RADIAL_DRIFT = 0.6
"""Texture drift along the radius over that around the axis. With either alone, cuts across it show stripes."""

SWING = 0.12
"""Of the drifting texture to either side, in inradii of the picture."""


@dataclass(frozen=True)
class Drift:
    """How the texture of slices moves along the axis, so that it ends along it as it does in the slices."""

    rate: float
    """Cells per cell."""
    share_a: float
    """Share of the full swing along the picture's direction a, and along b: rings and stripes are cut shells and
    sheets, which do not drift through themselves."""
    share_b: float
    grain: float
    """Half a wavelength of the texture around the axis, cells."""
    is_stranded: bool
    """Whether its grains are elongated along the radius, like juice sacs."""

    @classmethod
    def of(cls, carrier: Sequence[Layers], radial: Sequence[Layers], shape: Shape) -> Drift:
        """The drift that gives the texture the slope along the axis which radial pictures show; without any, the
        carrier's own mean slope, but that of rings around them."""
        spread, a, b = np.mean([p.spread for p in carrier], axis=0)
        share_a = share_b = 1.0
        if radial:
            deviation, _, steep = np.mean([p.spread for p in radial], axis=0)
            wanted = steep / deviation
        else:
            share_a, share_b = min(b / a, 1.0), 1.0 if shape.is_round else min(a / b, 1.0)
            wanted = np.hypot(share_a * a, b) / np.sqrt(2) / spread
        rate = wanted / (np.hypot(RADIAL_DRIFT * share_a * a, b) / spread)
        inradius = float(carrier[0].source.depth.max()) * shape.inradius
        deviation, slope_a, slope_b = carrier[0].spread
        return cls(
            float(np.clip(rate, 0.1, 1.5)),
            float(share_a),
            float(share_b),
            float(np.clip(np.pi * deviation / slope_b, 2, 0.3 * inradius)),
            bool(slope_b > 1.8 * slope_a),
        )


@dataclass(frozen=True)
class Extrusion:
    """A picture extruded along an axis: ground and structures straight, texture drifting sideways.

    A point near the skin shows the picture at equal depth, a deeper one at the equal share of the slice's radius.
    """

    shape: Shape
    sheet: Sheet
    drift: Drift
    phases: NDArray[np.float64]
    """(8,). Radians."""
    height_mask: HeightMask | None
    """Where radial pictures end its structures."""
    core: Core | None
    """A line around the core, drawn as one shell."""
    correction: Correction | None = None
    """By radial pictures."""

    @property
    def sheets(self) -> list[Sheet]:
        """All that it reads."""
        return [self.sheet, *([] if self.correction is None else self.correction.sheets)]

    def reduced(self, n: int) -> Extrusion:
        """The same of pictures with pixels n times as large."""
        correction = None if self.correction is None else self.correction.reduced(n)
        return replace(self, sheet=self.sheet.reduced(n), correction=correction)

    def read(self, places: Places) -> NDArray[np.float32]:
        """(M, 3). Colours. Range [0, 1]."""
        rgb = self.uncorrected(places)
        if self.correction is not None:
            self.correction.apply(rgb, places, self.shape, self.sheet, self.height_mask)
        if self.core is not None:
            # Last: the radial layers no longer show the line and would correct it away.
            self._draw_core_line(rgb, places, self.core)
        return np.clip(rgb, 0, 1)

    def uncorrected(self, places: Places) -> NDArray[np.float32]:
        """(M, 3). What the picture alone says."""
        sheet, angle, share, depth, level = self.sheet, places.angle, places.share, places.depth, places.level
        phases, size = self.phases.tolist(), self.shape.inradius
        inradius = sheet.inradius * size
        if self.shape.is_round:
            wave = level / (0.55 * inradius)
            slow, fast = wave + phases[4], 1.7 * wave + 5 * share + phases[5]
            angle = angle + WAVINESS * (np.sin(slow) + np.sin(fast))
        x, y = sheet.position(angle, share, depth, size)
        under = (
            (x, y) if self.core is None else sheet.position(angle, self._bent(places, self.core, angle), depth, size)
        )
        rgb = sheet.read(*under, GROUND)
        rgb += sheet.read(*self._drifted(places, angle, x, y), TEXTURE)
        structure = sheet.read(x, y, _RUNS)
        opacity, through = structure[:, :1], structure[:, 1:]
        # On a small slice the picture shrinks, but a membrane keeps its thickness.
        rim = sheet.rim(angle)
        small = np.flatnonzero(rim > 1.15 * places.rim)
        offset = np.minimum(rim[small] / places.rim[small] - 1, 2) * sheet.thickness
        for side in (-1.0, -0.5, 0.5, 1.0):
            dx, dy = -np.sin(angle[small]) * offset * side, -np.cos(angle[small]) * offset * side
            more = sheet.read(x[small] + dx, y[small] + dy, _RUNS)
            thicker = more[:, 0] > opacity[small, 0]
            structure[small[thicker]] = more[thicker]
        if self.height_mask is not None:
            # The rind follows the skin, not the axis.
            inner = np.flatnonzero((opacity[:, 0] > 0) & (depth > 1.2 * sheet.rind))
            opacity_left, colours = self.height_mask.at(
                through[inner], x[inner], y[inner], places.radius[inner] / self.shape.widest, places.height[inner]
            )
            opacity[inner, 0] *= opacity_left
            through[inner] = colours
        return np.clip(rgb + opacity * (through - rgb), 0, 1)

    def _drifted(
        self, places: Places, angle: NDArray[np.floating], x: NDArray[np.floating], y: NDArray[np.floating]
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """(M,), (M,). Where the texture of points is taken that show the picture at x and y."""
        sheet, drift, phases, level = self.sheet, self.drift, self.phases.tolist(), places.level
        inradius = sheet.inradius * self.shape.inradius
        swing = SWING * inradius
        phase = 0.3 * inradius * np.sin(angle + phases[0])
        aside = swing * drift.share_a * triangle((level + phase) * RADIAL_DRIFT * drift.rate / (4 * swing))
        if not self.shape.is_round:
            along = swing * drift.share_b * triangle((level - phase) * drift.rate / (4 * swing))
            return x + aside, y + along
        # One rotation for a whole slice, so that nothing is sheared; the rate is exact at half the radius.
        other = angle + drift.rate * level / (0.5 * inradius) + phases[3]
        if drift.is_stranded:
            other = angle + self._strand_angles(angle, level, round(np.pi * inradius / (2 * drift.grain)))
        u, v = sheet.position(other, places.share, np.maximum(places.depth, sheet.rind), self.shape.inradius)
        # Less at the axis, which would otherwise show a star: all directions meet there.
        aside *= np.minimum(np.hypot(u - sheet.middle[0], v - sheet.middle[1]) / (2 * swing), 1)
        return u + aside * np.cos(other), v - aside * np.sin(other)

    def _strand_angles(
        self, angle: NDArray[np.floating], level: NDArray[np.floating], count: int
    ) -> NDArray[np.floating]:
        """(M,). For a texture of long grains: the angle by which each strand's texture is rotated.

        Strands run outwards from the axis, `count` around it and two grains high, with slightly wavy walls; each shows
        another part of the picture. A cut across them shows the ends of grains, where a drift would produce stripes.
        """
        phases, grain = self.phases.tolist(), self.drift.grain
        row = (
            level / (2 * grain) + 0.4 * np.sin((count // 2) * angle + phases[4]) + 0.25 * np.sin(5 * angle + phases[5])
        )
        j = np.floor(row).astype(np.int64)
        turn = angle / (2 * np.pi) * count + 0.5 * (j % 2) + 0.35 * np.sin(level / grain + phases[6])
        i = np.floor(turn).astype(np.int64) % count
        mixed = (i * 73856093 ^ j * 19349663) & 0xFFFFFF
        return (mixed * 2654435761 % 65521) / 65521 * 2 * np.pi

    def _draw_core_line(self, rgb: NDArray[np.float32], places: Places, core: Core) -> None:
        """Draws the line around a core into colours (M, 3), in place."""
        angle = places.angle
        away, _, ring = core.shell(places, self.shape.widest, angle)
        r = ring + away
        x, y = self.sheet.middle[0] + r * np.cos(angle), self.sheet.middle[1] - r * np.sin(angle)
        rgb += core.line_at(x, y) * (self.sheet.read(x, y, PICTURE) - rgb)

    def _bent(self, places: Places, core: Core, angle: NDArray[np.floating]) -> NDArray[np.floating]:
        """(M,). The share of the rim at which the picture shows the ground at equal distance from a core."""
        away, shell, ring = core.shell(places, self.shape.widest, angle)
        at = ring / self.sheet.rim(angle)
        out = np.maximum(away, 0)
        outside = out / (out + places.depth * self.shape.inradius + 1e-6)
        return np.where(away < 0, at * (1 + away / shell), at + (1 - at) * outside)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same."""
        parts = {"sheet": self.sheet.record()}
        more = {"mask": self.height_mask, "core": self.core, "correction": self.correction}
        arrays, facts = nested(parts | {name: part.record() for name, part in more.items() if part is not None})
        return arrays | {"phases": self.phases}, facts | {"drift": asdict(self.drift)}

    @classmethod
    def restored(cls, record: RecordReader, shape: Shape) -> Extrusion:
        """That of a `record`. Raises ValueError if it is none."""
        sheet, drift = Sheet.restored(record.part("sheet")), record.part("drift")
        return cls(
            shape,
            sheet,
            Drift(
                drift.number("rate", 0, 1e4),
                drift.number("share_a", 0, 1),
                drift.number("share_b", 0, 1),
                drift.number("grain", 1e-3, 1e5),
                drift.flag("is_stranded"),
            ),
            record.array("phases", np.float64, (8,)),
            HeightMask.restored(record.part("mask"), sheet.labels.shape) if record.has("mask") else None,
            Core.restored(record.part("core"), sheet.labels.shape) if record.has("core") else None,
            Correction.restored(record.part("correction")) if record.has("correction") else None,
        )


_RUNS = slice(STRUCTURE.start, THROUGH.stop)
"""What runs through: opacity and colour."""


def triangle(phase: NDArray[np.floating]) -> NDArray[np.floating]:
    """Triangle wave of period 1 and range [-1, 1], rounded at its extremes."""
    return np.arcsin(0.97 * np.sin(2 * np.pi * phase)) / math.asin(0.97)
