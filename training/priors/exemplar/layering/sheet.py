"""The layers of a picture in the form that an inside reads: at any place, at any fineness, and from a file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from training.priors.exemplar.layering.decompose import Layers
from training.priors.exemplar.outline import ANGLES, Outline
from training.priors.exemplar.patches import OVER
from training.priors.exemplar.record import RecordReader
from training.priors.exemplar.sampling import read_bilinear, reduced

__all__ = ["DETAIL", "GROUND", "PICTURE", "STRUCTURE", "TEXTURE", "THROUGH", "Sheet"]

GROUND, TEXTURE, STRUCTURE, THROUGH, HEIGHT = slice(0, 3), slice(3, 6), slice(6, 7), slice(7, 10), slice(10, 11)
"""Channels of a sheet: a smooth ground, its texture, and the opacity, colour and height of the structures."""

PICTURE, DETAIL = slice(11, 14), slice(14, 15)
"""Channels of the picture itself, and of the opacity of the details that end."""

CHANNELS = 15

MOST_PIXELS = 2048
"""Largest number of pixels along a side of a sheet in a file."""


@dataclass(frozen=True)
class Sheet(Outline):
    """A decomposed picture (`Layers`). Its levels are whole steps of 1/255, as a file keeps them."""

    rind: float
    """Thickness of the layers along the skin, over the body's inradius."""
    inradius: float
    """Inradius of the picture's face, over that of the body."""
    thickness: float
    """Typical half thickness of long structures, cells."""
    channels: NDArray[np.float32]
    """(H, W, CHANNELS). See the slices above."""
    labels: NDArray[np.int32]
    """Number of the detail that each pixel of the picture (OVER pixels per cell) belongs to, 0 for none."""
    coarseness: int = 1
    """Pixels of the picture per pixel of `channels`, along a side."""

    @classmethod
    def of(cls, layers: Layers) -> Sheet:
        """The sheet of a picture's layers."""
        source = layers.source
        structure, heights, detail = (a[..., None] for a in (layers.structure, layers.heights, layers.detail))
        parts = layers.ground, layers.texture, structure, layers.through, heights, source.rgb, detail
        levels = np.round(np.concatenate(parts, axis=-1) * 255).astype(np.int16)
        return cls(
            source.middle,
            source.half,
            source.rims,
            source.insets,
            layers.rind,
            float(source.depth.max()),
            layers.thickness,
            _from_levels(levels),
            layers.labels,
        )

    def reduced(self, n: int) -> Sheet:
        """The sheet with pixels n times as large."""
        return replace(self, channels=reduced(self.channels, n), coarseness=n)

    def read(self, x: NDArray[np.floating], y: NDArray[np.floating], channels: slice) -> NDArray[np.float32]:
        """(M, K). Some channels at places in cells."""
        n = self.coarseness
        # A pixel of the picture lies at a whole number, an enlarged one at the mean of those that it covers.
        rows, columns = ((at * OVER - (n - 1) / 2) / n for at in (y, x))
        return read_bilinear(self.channels, rows, columns, channels)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same sheet."""
        levels = np.round(self.channels * 255).astype(np.int16)
        signed = levels[..., TEXTURE]
        plain = np.delete(levels, np.r_[TEXTURE], axis=-1).astype(np.uint8)
        arrays: dict[str, NDArray[Any]] = {
            "rims": self.rims,
            "insets": self.insets,
            "levels": plain,
            "texture": signed,
            "labels": self.labels,
        }
        facts = {"rind": self.rind, "inradius": self.inradius, "thickness": self.thickness}
        return arrays, facts | {"middle": list(self.middle), "half": list(self.half)}

    @classmethod
    def restored(cls, record: RecordReader) -> Sheet:
        """The sheet in a `record`. Raises ValueError if the record is not valid."""
        plain = record.array("levels", np.uint8, (None, None, CHANNELS - 3))
        height, width = plain.shape[:2]
        if not 2 <= min(height, width) <= max(height, width) <= MOST_PIXELS:
            raise ValueError("a wrong size of a picture")
        signed = record.array("texture", np.int16, (height, width, 3))
        levels = np.concatenate([plain[..., :3], signed, plain[..., 3:]], axis=-1)
        return cls(
            record.pair("middle"),
            record.pair("half"),
            record.array("rims", np.float32, (ANGLES,)),
            record.array("insets", np.float32, (ANGLES, None)),
            record.number("rind", 0, 10),
            record.number("inradius", 0, 10),
            record.number("thickness", 0, 10),
            _from_levels(levels),
            record.array("labels", np.int32, (height, width)),
        )


def _from_levels(levels: NDArray[np.int16]) -> NDArray[np.float32]:
    """Numbers from levels in steps of 1/255."""
    return levels.astype(np.float32) / np.float32(255)
