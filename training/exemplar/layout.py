"""The first guess of an inside, which is most of it: every layer of the pictures carried on along the axis in its own way.

Structures run through; the texture drifts sideways on its way, so that it is as fine along the axis as the pictures say;
details are left to `scatter`. What pictures along the axis know of height is added (DESIGN 5.1, step 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.exemplar.decompose import Layers
from training.exemplar.frames import Sheet, Space
from training.exemplar.patches import OVER

__all__ = ["Axis", "along", "carried", "height_correction", "revolved"]

CHUNK = 400_000
"""Voxels laid out at once: bounds the memory of the look-ups."""

SIDEWAYS = 0.6
"""Drift of the texture along the radius over that around the axis. With one alone, cuts across it show stripes."""


@dataclass(frozen=True)
class Axis:
    """Voxels seen along a direction: where each lies on its slice."""

    place: NDArray[np.float32]
    """(N, 2). From the slices' common centre, cells."""
    level: NDArray[np.float32]
    """(N,). Along the direction from the lowest voxel, cells."""
    radius: NDArray[np.float32]
    """(N,)."""
    rim: NDArray[np.float32]
    """(N,). Distance of the skin from the centre at the voxel's angle and level, cells."""
    round: bool
    """Whether its slices may be turned: their outline says nothing of the angle."""


def along(space: Space, basis: NDArray[np.float64], is_round: bool) -> Axis:
    """The voxels seen along the third row of `basis` (3, 3)."""
    planar = ((space.cells - space.centre) @ basis.T).astype(np.float32)
    radius = np.hypot(planar[:, 0], planar[:, 1])
    from training.exemplar.frames import rim_of

    return Axis(planar[:, :2], planar[:, 2] - planar[:, 2].min(), radius, rim_of(planar, radius), is_round)


def carried(
    space: Space, axis: Axis, layers: Sequence[Layers], rate: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """(N, 3). A picture drawn out along an axis: ground and structures straight, the texture drifting `rate` cells a cell.

    Near the skin a voxel reads the picture at its own depth, deeper at its own share of the slice's radius. The first
    picture gives the structures; the texture is taken from all of them, one after another along the axis.
    """
    main = layers[0]
    top = float(axis.level.max())
    turn = rng.uniform(0, 2 * np.pi, 8)
    out = np.empty((len(axis.place), 3), np.float32)
    inradius = float(main.sheet.depth.max()) * space.inradius
    for start in range(0, len(out), CHUNK):
        part = slice(start, start + CHUNK)
        angle = np.arctan2(axis.place[part, 1], axis.place[part, 0])
        share = np.minimum(axis.radius[part] / axis.rim[part], 1)
        depth, level = space.depth[part], axis.level[part]
        x, y = _place(space, main, angle, share, depth)
        colour = _read(main.ground, x, y)
        # The texture's own way: around the axis at an even pace, to and fro across it.
        swing = 0.12 * inradius
        period = 4 * swing / max(SIDEWAYS * rate, 1e-3)
        wobble = 2.0 * np.sin(2 * angle + turn[0]) + 1.3 * np.sin(3 * share * np.pi + turn[1])
        to_and_fro = swing * _triangle((level + 0.15 * inradius * wobble) / period)
        if axis.round:
            # Cells around the axis are an angle by the radius; near the axis no less than a fifth of the rim.
            other = angle + rate * level / np.maximum(share * axis.rim[part], 0.25 * axis.rim[part]) + turn[2]
            u, v = _place(space, main, other, share, np.maximum(depth, main.rind))
            u, v = u + to_and_fro * np.cos(other), v - to_and_fro * np.sin(other)
        else:
            second = (
                0.15
                * inradius
                * _triangle((level + 0.2 * inradius * np.cos(angle + turn[3])) * rate / (0.6 * inradius))
            )
            u, v = x + to_and_fro, y + second
        colour += _read(main.texture, u, v)
        opacity = _read(main.structure[..., None], x, y)
        out[part] = colour + opacity * (_read(main.sheet.rgb, x, y) - colour)
    del top
    return np.clip(out, 0, 1)


def _place(
    space: Space, layers: Layers, angle: NDArray[np.floating], share: NDArray[np.floating], depth: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(M,), (M,). Where in a picture, cells, a voxel at this angle, share of the rim and depth in inradii is found."""
    rim = layers.sheet.rim(angle)
    by_depth = np.clip(1 - depth * space.inradius / rim, 0, 1)
    near = _near_skin(depth, layers.rind)
    r = (near * by_depth + (1 - near) * share) * rim
    return layers.sheet.middle[0] + r * np.cos(angle), layers.sheet.middle[1] - r * np.sin(angle)


def _read(picture: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M, C). Bilinear values of a picture (H, W, C) at places in cells."""
    at = np.stack([y, x]) * OVER
    return np.stack(
        [
            ndimage.map_coordinates(picture[..., c], at, order=1, mode="nearest", output=np.float32)
            for c in range(picture.shape[-1])
        ],
        axis=-1,
    )


def _triangle(phase: NDArray[np.floating]) -> NDArray[np.floating]:
    """To and fro between -1 and 1 at an even pace, once per unit; rounded at the ends."""
    return np.arcsin(0.97 * np.sin(2 * np.pi * phase)) / np.arcsin(0.97)


def _near_skin(depth: NDArray[np.floating], rind: float) -> NDArray[np.floating]:
    """1 in the rind, falling to 0 over as much again and a little."""
    t = np.clip((depth - 1.1 * rind) / (0.7 * rind + 0.1), 0, 1)
    return 1 - t * t * (3 - 2 * t)


def revolved(space: Space, layers: Layers) -> NDArray[np.float32]:
    """(N, 3). The right half of a radial picture turned about the axis."""
    sheet = layers.sheet
    across, up = space.radius / float(space.rim.max()) * sheet.half[0], space.height * sheet.half[1]
    angle, length = np.arctan2(up, across), np.hypot(across, up)
    x, y = _place(space, layers, angle, np.minimum(length / sheet.rim(angle), 1), space.depth)
    colour = _read(layers.ground, x, y) + _read(layers.texture, x, y)
    opacity = _read(layers.structure[..., None], x, y)
    return np.clip(colour + opacity * (_read(sheet.rgb, x, y) - colour), 0, 1)


def height_correction(space: Space, sheets: list[Sheet], rind: float) -> NDArray[np.float32]:
    """(N, 3). What radial pictures know about height: colours to add.

    The halves of all pictures are looks at the same (radius, height) map. What they agree on is the map (Wiener's
    weight), what they do not is chance. Its median over the heights is taken off: the extrusion knows that already.
    """
    halves = []
    n = 128
    t, h = np.meshgrid((np.arange(n // 2) + 0.5) / (n // 2), np.linspace(-1, 1, n), indexing="ij")
    for sheet in sheets:
        for side in (1, -1):
            x, y = sheet.middle[0] + side * t * sheet.half[0], sheet.middle[1] - h * sheet.half[1]
            halves.append(sheet.read(x, y))
    looks = np.stack(halves)
    mean = ndimage.gaussian_filter(looks.mean(0), (1.0, 0.7, 0))
    chance = ndimage.gaussian_filter(looks.var(0, ddof=1).sum(-1), 2.0) / len(looks)
    change = mean - np.median(mean, axis=1, keepdims=True)
    power = ndimage.gaussian_filter((change**2).sum(-1), 2.0)
    weight = np.clip(1 - 2 * chance / np.maximum(power, 1e-6), 0, 1)[..., None]
    change = change * weight
    widest = float(space.rim.max())
    at = np.stack([space.radius / widest * (n // 2) - 0.5, (space.height + 1) / 2 * (n - 1)])
    out = np.stack([ndimage.map_coordinates(change[..., c], at, order=1, mode="nearest") for c in range(3)], -1)
    # The rind follows the skin, not the height.
    return (out * (1 - _near_skin(space.depth, rind))[:, None]).astype(np.float32)
