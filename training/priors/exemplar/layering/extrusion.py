"""Extrudes the layers of a picture along the axis that it does not show.

Structures run straight through; texture lies in thin layers (`strata`), as fine along the axis as the pictures show;
details are left to `scatter`. Radial pictures then correct the result by height (`correction`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from training.priors.exemplar.layering.closed import RUNS_THROUGH
from training.priors.exemplar.layering.core_shell import CoreShell
from training.priors.exemplar.layering.correction import Correction
from training.priors.exemplar.layering.grain import SWING, Grain, Strata
from training.priors.exemplar.layering.height_mask import HeightMask
from training.priors.exemplar.layering.places import Places, Shape
from training.priors.exemplar.layering.sheet import GROUND, HEIGHT, PICTURE, STRUCTURE, TEXTURE, Sheet
from training.priors.exemplar.outline import ANGLES, UNDER
from training.priors.exemplar.record import MOST_SEED, RecordReader, nested
from training.priors.exemplar.sampling import read_trilinear, smoothstep
from training.priors.exemplar.strata import Rows, beside_own, read_layers

__all__ = ["Extrusion"]

WAVINESS = 0.035
"""Waviness of structures along the axis, radians: a cut along a straight membrane one voxel thick shows the grid."""


SHARES = 17
"""Shares of the rim at which it is known how far the picture's edge bends what lies under it."""

FASTEST = 6
"""Order from which waves of the outline fall off no faster. One of order k and relative height h folds what lies under
it where k h > 1, so higher ones are cut at 1 / FASTEST: the notches of a crust, the legs of a body, or a slice that
does not hold the centre."""

LEAST_STRETCH = 0.1
"""Stretch of a picture along a side up to which its texture is stretched with it: nobody sees that."""


@dataclass(frozen=True)
class Extrusion:
    """A picture extruded along an axis: ground and structures straight, texture in layers across it.

    A point near the skin shows the picture at equal depth, a deeper one at about an equal share of the slice's radius:
    where one outline has a bump that the other lacks, only what lies under it bends.
    """

    shape: Shape
    sheet: Sheet
    grain: Grain
    seed: int
    """Seed of the texture's layers and of the structures' waves."""
    height_mask: HeightMask | None
    """Where its structures end, by radial pictures."""
    core: CoreShell | None
    """The shell around a core, of which the pictures show lines."""
    correction: Correction | None = None
    """Correction by radial pictures."""

    def reduced(self, n: int) -> Extrusion:
        """The same extrusion with pixels n times as large in its pictures."""
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
        """(M, 3). Colours by the picture alone."""
        sheet, depth, size = self.sheet, places.depth, self.shape.inradius
        angle, share = self._angle(places), self._share(places)
        x, y = sheet.position(angle, share, depth, size, sheet.rind)
        under = (
            (x, y)
            if self.core is None
            else sheet.position(angle, self._bent(places, self.core, angle), depth, size, sheet.rind)
        )
        rgb = sheet.read(*under, GROUND)
        rgb += self._texture(places, angle, share, x, y)
        opacity, through, _ = self._structures(places, angle, share)
        return np.clip(rgb + opacity * (through - rgb), 0, 1)

    def structures(self, places: Places) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """(M,) and (M,). Opacity of the structures at points, and whether they end in the body."""
        opacity, _, height = self._structures(places, self._angle(places), self._share(places))
        return opacity[:, 0], height < RUNS_THROUGH

    def _structures(
        self, places: Places, angle: NDArray[np.floating], share: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """(M, 1), (M, 3) and (M,). Opacity, colour and height of structures at points that show the picture at this
        angle and share of its rim."""
        sheet, depth = self.sheet, places.depth
        x, y = sheet.position(angle, share, depth, self.shape.inradius, sheet.rind, reaches_rind=True)
        structure = sheet.read(x, y, _STRUCTURES)
        opacity, through, height = structure[:, :1], structure[:, 1:4], structure[:, 4]
        # On a small slice the picture shrinks, but a membrane keeps its thickness.
        rim = sheet.rim(angle)
        small = np.flatnonzero(rim > 1.15 * places.rim)
        offset = np.minimum(rim[small] / places.rim[small] - 1, 2) * sheet.thickness
        for side in (-1.0, -0.5, 0.5, 1.0):
            dx, dy = -np.sin(angle[small]) * offset * side, -np.cos(angle[small]) * offset * side
            more = sheet.read(x[small] + dx, y[small] + dy, _STRUCTURES)
            thicker = more[:, 0] > opacity[small, 0]
            structure[small[thicker]] = more[thicker]
        if self.height_mask is not None:
            # The rind follows the skin, not the axis.
            inner = np.flatnonzero((opacity[:, 0] > 0) & (depth > UNDER * sheet.rind))
            opacity_left, colours = self.height_mask.at(
                through[inner], x[inner], y[inner], places.across[inner], places.height[inner]
            )
            opacity[inner, 0] *= opacity_left
            through[inner] = colours
        else:
            over = np.abs(self._above_own(places)) - height * (sheet.inradius * self.shape.inradius)
            opacity *= np.where(height < RUNS_THROUGH, 1 - smoothstep(over), 1)[:, None]
        return opacity, through, height

    @property
    def own_normal(self) -> NDArray[np.float64]:
        """(3,). Normal of the own plane: the one through the body's centre in which the picture is shown as it is."""
        return self.shape.basis[2]

    def position(self, places: Places) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M,), (M,). Place of points in the picture, cells."""
        return self.sheet.position(
            self._angle(places), self._share(places), places.depth, self.shape.inradius, self.sheet.rind
        )

    def _above_own(self, places: Places) -> NDArray[np.float32]:
        """(M,). Height over the own plane, cells."""
        return places.level + np.float32(self.shape.lowest)

    def _angle(self, places: Places) -> NDArray[np.floating]:
        """(M,). Angle in the picture, radians."""
        if not self.shape.is_round:
            return places.angle
        level = self._above_own(places) / (0.55 * self.sheet.inradius * self.shape.inradius)
        slow, fast = self._strata.phases[0], 5 * places.share + self._strata.phases[1]
        wave = np.sin(level + slow) - np.sin(slow) + np.sin(1.7 * level + fast) - np.sin(fast)
        return places.angle + WAVINESS * wave

    def _share(self, places: Places) -> NDArray[np.float32]:
        """(M,). Share of the picture's rim at which it shows points."""
        turn = places.angle / np.float32(2 * np.pi) % 1 * ANGLES + np.float32(0.5)
        at = np.stack([places.level, places.share * np.float32(SHARES - 1), turn], -1)
        return np.minimum(places.share * read_trilinear(self._evened, at)[:, 0], 1)

    @cached_property
    def _evened(self) -> NDArray[np.float32]:
        """(L, SHARES, ANGLES + 2, 1). That share over the share of the slice's rim, by level, share and angle.

        How much farther the picture's edge is than the slice's is taken inwards as a harmonic function, whose waves of
        order k fall off as the k-th power of the share.
        """
        farther = np.log(self.sheet.rims / np.maximum(self.shape.rims[:, 1:-1], 0.5))
        farther -= np.median(farther, axis=1, keepdims=True)
        farther = np.clip(farther, -1 / FASTEST, 1 / FASTEST)
        orders = np.minimum(np.arange(ANGLES // 2 + 1), FASTEST)
        waves = np.fft.rfft(farther, axis=1)[:, None] * np.linspace(0, 1, SHARES)[:, None] ** orders
        evened = np.exp(np.fft.irfft(waves, ANGLES, axis=2) - farther[:, None])
        return np.pad(evened, ((0, 0), (0, 0), (1, 1)), mode="wrap")[..., None].astype(np.float32)

    @cached_property
    def _strata(self) -> Strata:
        levels, thickness = len(self.shape.rims), self.grain.thickness
        return Strata(int(levels / thickness) + 4, thickness / self._radius, self.seed)

    @property
    def _radius(self) -> float:
        """Approximate radius of a ball around the body, cells."""
        return max(self.shape.widest, len(self.shape.rims) / 2)

    def _texture(
        self,
        places: Places,
        angle: NDArray[np.floating],  # [M]
        share: NDArray[np.floating],  # [M]
        x: NDArray[np.floating],  # [M]
        y: NDArray[np.floating],  # [M]
    ) -> NDArray[np.float32]:
        """(M, 3). The texture of points that show the picture at x and y, at this angle and share of its rim."""
        sheet, grain, strata, size = self.sheet, self.grain, self._strata, self.shape.inradius
        swing, is_stretched = self._swing, np.abs(self._stretch - 1).max() > LEAST_STRETCH
        upright = places.level - len(self.shape.rims) / 2
        points = np.concatenate([places.place, upright[:, None]], axis=1) / self._radius
        height = places.level / grain.thickness + strata.waves.at(points.astype(np.float32))

        def read(layer: NDArray[np.int64], rows: Rows) -> NDArray[np.float32]:
            out, around = strata.draw(layer)
            out = swing * grain.share_a * out
            if not self.shape.is_round:
                u, v = x[rows] + out, y[rows] + swing * grain.share_b * around
                if not is_stretched:
                    return sheet.read(u, v, TEXTURE)
                return self._unstretched_texture(places.place[rows], u, v, strata.draw(layer)[::-1].T / 2)
            other = angle[rows] + np.pi * grain.share_a * around
            depth = np.maximum(places.depth[rows], sheet.rind)
            u, v = sheet.position(other, share[rows], depth, size, sheet.rind)
            # Swing less at the axis, where all directions meet.
            out *= np.minimum(np.hypot(u - sheet.middle[0], v - sheet.middle[1]) / (2 * swing), 1)
            return sheet.read(u + out * np.cos(other), v - out * np.sin(other), TEXTURE)

        own = sheet.read(x, y, TEXTURE)
        return beside_own(read_layers(height, read), own, self._above_own(places) / grain.thickness)

    def _unstretched_texture(
        self,
        place: NDArray[np.float32],  # [R, 2] as in Places
        x: NDArray[np.floating],  # [R] where the picture shows them
        y: NDArray[np.floating],  # [R]
        phases: NDArray[np.floating],  # [R, 2] of the patches
    ) -> NDArray[np.float32]:
        """(R, 3). The texture in its own proportions, though the body's are others: in patches that are each moved to
        where the picture shows their middle."""
        size = 2 * self._swing / np.abs(self._stretch - 1)
        at = place / (self._stretch * size) + phases + 0.5
        shrink = (1 - self._stretch) * size

        def column(across: NDArray[np.int64], rows: Rows) -> NDArray[np.float32]:
            of_column = np.arange(len(at))[rows]

            def patch(up: NDArray[np.int64], some: Rows) -> NDArray[np.float32]:
                these = of_column[some]
                right, high = (shrink * (at[these] - 0.5 - np.stack([across[some], up], -1))).T
                return self.sheet.read(x[these] + right, y[these] - high, TEXTURE)

            return read_layers(at[rows, 1], patch)

        return read_layers(at[:, 0], column)

    @property
    def _stretch(self) -> NDArray[np.float64]:
        """(2,). How much the body is stretched in a slice to have the picture's proportions."""
        return np.linalg.norm(self.shape.basis[:2], axis=1)

    @property
    def _swing(self) -> float:
        """Largest shift of a layer's texture in cells."""
        return SWING * self.sheet.inradius * self.shape.inradius

    def _draw_core_line(self, rgb: NDArray[np.float32], places: Places, core: CoreShell) -> None:
        """Draws the line around a core into colours (M, 3), in place."""
        angle = places.angle
        away, _, ring = core.shell(places, angle)
        r = ring + away
        x, y = self.sheet.middle[0] + r * np.cos(angle), self.sheet.middle[1] - r * np.sin(angle)
        rgb += core.line_at(x, y) * (self.sheet.read(x, y, PICTURE) - rgb)

    def _bent(self, places: Places, core: CoreShell, angle: NDArray[np.floating]) -> NDArray[np.floating]:
        """(M,). The share of the rim at which the picture shows the ground at an equal distance from the core."""
        away, shell, ring = core.shell(places, angle)
        at = ring / self.sheet.rim(angle)
        out = np.maximum(away, 0)
        outside = out / (out + places.depth * self.shape.inradius + 1e-6)
        return np.where(away < 0, at * (1 + away / shell), at + (1 - at) * outside)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same extrusion."""
        parts = {"sheet": self.sheet.record()}
        more = {"mask": self.height_mask, "core": self.core, "correction": self.correction}
        arrays, facts = nested(parts | {name: part.record() for name, part in more.items() if part is not None})
        return arrays, facts | {"grain": asdict(self.grain), "seed": self.seed}

    @classmethod
    def restored(cls, record: RecordReader, shape: Shape) -> Extrusion:
        """The extrusion in a `record`. Raises ValueError if the record is not valid."""
        sheet = Sheet.restored(record.part("sheet"))
        return cls(
            shape,
            sheet,
            Grain.restored(record.part("grain")),
            record.count("seed", MOST_SEED),
            HeightMask.restored(record.part("mask"), sheet.labels.shape) if record.has("mask") else None,
            CoreShell.restored(record.part("core"), sheet.labels.shape) if record.has("core") else None,
            Correction.restored(record.part("correction")) if record.has("correction") else None,
        )


_STRUCTURES = slice(STRUCTURE.start, HEIGHT.stop)
"""Channels of the structures' opacity, colour and height."""
