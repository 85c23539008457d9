"""Recognises pictures that are slices of one object and interpolates between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.inside import InsideRecord
from training.priors.exemplar.frames import ScaledPicture
from training.priors.exemplar.layering.places import Places, Shape
from training.priors.exemplar.outline import skin_weight
from training.priors.exemplar.record import MOST_SHEETS, RecordReader, nested
from training.priors.exemplar.sampling import read_bilinear, reduced, smoothstep

__all__ = ["Slices", "match_slices"]

DISC_SIZE = 160
"""Pixels along a side of the unit disc on which slices are compared: fine enough to follow a muscle."""

FACE_SIZE = 512
"""Pixels along a side of the disc from which colours are read: as many as most pictures on the web have."""

MIN_CORRELATION, MIN_LEAD = 0.3, 0.2
"""Smallest correlation of neighbouring slices of one object, and smallest lead over other angles.

Slices of a thigh 5 cm apart have 0.4 to 0.6 and those of one orange 0.6. Those of one melon or loaf, whose seeds and
pores come and go, have 0.1, like slices of different objects.
"""

DEFAULT_RIND = 0.15
"""Thickness in inradii of the layer that follows the skin where no picture shows its thickness."""

FLOW_SIGMA = 0.03
"""Smoothing of the flow, in disc diameters: neighbours move together, yet a bone may pass a muscle."""


@dataclass(frozen=True)
class SliceStack:
    """Pictures in order along an axis, evenly spaced, with the flow between neighbours."""

    faces: NDArray[np.float32]
    """(K, P, P, 3). Their faces, outlines stretched to the unit circle; whole steps of 1/255, as a file keeps them."""
    flows: NDArray[np.float32]
    """(K - 1, 2, DISC_SIZE, DISC_SIZE, 2). From each slice to the next and back, on the disc."""

    @classmethod
    def of(cls, pictures: Sequence[ScaledPicture]) -> SliceStack:
        """The stack of at least two pictures, in their order."""
        discs = [_disc(picture, DISC_SIZE) for picture in pictures]
        faces = np.round(np.stack([_disc(picture, FACE_SIZE) for picture in pictures]) * 255).astype(np.float32)
        flows = np.stack([np.stack([_flow(a, b), _flow(b, a)]) for a, b in pairwise(discs)])
        return cls(faces / np.float32(255), flows.astype(np.float16).astype(np.float32))

    def reduced(self, n: int) -> SliceStack:
        """The same stack with pixels n times as large in its faces."""
        return replace(self, faces=np.stack([reduced(face, n) for face in self.faces]))

    def read(
        self,
        x: NDArray[np.floating],  # [M] on the unit disc
        y: NDArray[np.floating],  # [M]
        t: NDArray[np.floating],  # [M] along the axis, range [0, 1]
    ) -> NDArray[np.float32]:
        """(M, 3). Colours; slice k of n stands at (k + 1/2) / n, with constant extrapolation beyond the first and
        last."""
        at = np.clip(t * len(self.faces) - 0.5, 0, len(self.faces) - 1)
        out = np.empty((len(x), 3), np.float32)
        below = np.minimum(at.astype(int), len(self.faces) - 2)
        for k, (forth, back) in enumerate(self.flows):
            rows = below == k
            f = (at[rows] - k).astype(np.float32)
            u, v = x[rows], y[rows]
            # Both slices are warped to the position between them, so that common features coincide.
            a = _sample(self.faces[k], *_origin(forth, u, v, f))
            b = _sample(self.faces[k + 1], *_origin(back, u, v, 1 - f))
            # A quick cross-fade half way blurs less than a slow one all the way.
            out[rows] = a + smoothstep((f - 0.5) / 0.4 + 0.5)[:, None] * (b - a)
        return out

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same stack."""
        return {"faces": np.round(self.faces * 255).astype(np.uint8), "flows": self.flows.astype(np.float16)}, {}

    @classmethod
    def restored(cls, record: RecordReader) -> SliceStack:
        """The stack in a `record`. Raises ValueError if the record is not valid."""
        faces = record.array("faces", np.uint8, (None, FACE_SIZE, FACE_SIZE, 3))
        if not 2 <= len(faces) <= MOST_SHEETS:
            raise ValueError("a wrong number of slices")
        flows = record.array("flows", np.float16, (len(faces) - 1, 2, DISC_SIZE, DISC_SIZE, 2))
        return cls(faces.astype(np.float32) / np.float32(255), flows.astype(np.float32))


@dataclass(frozen=True)
class Slices:
    """Slices of one object interpolated along an axis, each point at its share of the rim.

    Where the body closes at its ends, a point near the skin shows the slice at equal depth; where it is cut off flat,
    as a limb is, the end shows the inside.
    """

    shape: Shape
    stack: SliceStack

    def reduced(self, n: int) -> Slices:
        """The same slices with pixels n times as large in their pictures."""
        return replace(self, stack=self.stack.reduced(n))

    def read(self, places: Places) -> NDArray[np.float32]:
        """(M, 3). Colours. Range [0, 1]."""
        share, angle = places.share, places.angle
        if not self.shape.has_flat_ends:
            by_depth = np.clip(1 - places.depth * self.shape.inradius / float(self.shape.rims.max()), 0, 1)
            near = skin_weight(places.depth, DEFAULT_RIND)
            share = near * by_depth + (1 - near) * share
        return self.stack.read(
            share * np.cos(angle), share * np.sin(angle), (places.level + 0.5) / len(self.shape.rims)
        )

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same slices."""
        return nested({"stack": self.stack.record()})

    @classmethod
    def restored(cls, record: RecordReader, shape: Shape) -> Slices:
        """The slices in a `record`. Raises ValueError if the record is not valid."""
        return cls(shape, SliceStack.restored(record.part("stack")))


def match_slices(pictures: Sequence[ScaledPicture]) -> SliceStack | None:
    """The pictures as slices of one object, in their order; None if they are not, or if there is only one.

    Slices of one object correlate at the angle at which they were given, and at no other.
    """
    if len(pictures) < 2:
        return None
    discs = [_disc(s, DISC_SIZE) for s in pictures]
    inner = np.hypot(*_grid(DISC_SIZE)) < 0.85
    for a, b in pairwise(discs):
        upright = _correlation(a[inner], b[inner])
        rotated = [_correlation(a[inner], _rotated(b, n * np.pi / 6)[inner]) for n in range(2, 11)]
        if upright < MIN_CORRELATION or upright < np.median(rotated) + MIN_LEAD:
            return None
    return SliceStack.of(pictures)


def _grid(size: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixel centres (size, size) of the disc, x to the right and y up, range (-1, 1)."""
    axis = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(axis, -axis)
    return x, y


def _disc(scaled: ScaledPicture, size: int) -> NDArray[np.float32]:
    """(size, size, 3). The picture with its outline stretched to the unit circle."""
    x, y = _grid(size)
    angle = np.arctan2(y, x)
    r = np.minimum(np.hypot(x, y), 1) * scaled.rim(angle)
    return scaled.read(scaled.middle[0] + r * np.cos(angle), scaled.middle[1] - r * np.sin(angle))


def _rotated(disc: NDArray[np.float32], angle: float) -> NDArray[np.float32]:
    x, y = _grid(DISC_SIZE)
    c, s = np.cos(angle), np.sin(angle)
    return _sample(disc, (c * x - s * y).ravel(), (s * x + c * y).ravel()).reshape(disc.shape)


def _sample(picture: NDArray[np.floating], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M, C). Bilinear values at positions on the disc."""
    size = len(picture)
    return read_bilinear(picture, (1 - y) / 2 * size - 0.5, (1 + x) / 2 * size - 0.5)


def _origin(
    flow: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating], part: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """(M,), (M,). The position that a fraction of the flow moves to (x, y), by fixed-point iteration."""
    u, v = x, y
    for _ in range(4):
        step = _sample(flow, u, v) * part[:, None]
        u, v = x - step[:, 0], y - step[:, 1]
    return u, v


def _correlation(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    """Pearson correlation of two sets of colours (M, 3), each channel centred."""
    a, b = a - a.mean(0), b - b.mean(0)
    return float((a * b).sum() / np.sqrt(max((a * a).sum() * (b * b).sum(), 1e-12)))


def _flow(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """(DISC_SIZE, DISC_SIZE, 2). Optical flow on the disc: a(p) = b(p + flow(p)).

    Demons (Thirion 1998): steps along the gradient of the moved picture, smoothed, from coarse to fine.
    """
    x, y = _grid(DISC_SIZE)
    flow = np.zeros((DISC_SIZE, DISC_SIZE, 2), np.float32)
    for blur in (16.0, 8.0, 4.0, 2.0):
        smooth_a, smooth_b = (ndimage.gaussian_filter(p, (blur, blur, 0)) for p in (a, b))
        sigma = max(FLOW_SIGMA * DISC_SIZE / 2, 0.5 * blur)
        for _ in range(60):
            moved = _sample(smooth_b, (x + flow[..., 0]).ravel(), (y + flow[..., 1]).ravel()).reshape(a.shape)
            rows, columns = np.gradient(moved, 2 / DISC_SIZE, axis=(0, 1))
            gap = smooth_a - moved
            force = np.stack([(gap * columns).sum(-1), -(gap * rows).sum(-1)], -1)
            # Limits a step to about a pixel at any contrast.
            scale = (columns**2 + rows**2).sum(-1) + (gap**2).sum(-1) * (DISC_SIZE / 3) ** 2
            flow += (force / np.maximum(scale, 1e-6)[..., None]).astype(np.float32)
            flow = ndimage.gaussian_filter(flow, (sigma, sigma, 0))
    return flow
