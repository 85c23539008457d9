"""The layers of a picture carried along the axis that it does not show, each in its own way.

Structures run through; the texture drifts sideways on its way, so that it is as fine along the axis as the pictures
say; details are left to `scatter`. What pictures along the axis know of height is added (DESIGN 5.1, step 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.carve import Carving
from training.priors.exemplar.core import Core
from training.priors.exemplar.decompose import Layers
from training.priors.exemplar.frames import ANGLES, INSET_STEP, SPECK, Space, rim_of
from training.priors.exemplar.morph import Slices
from training.priors.exemplar.patches import OVER
from training.priors.prior import Progress

__all__ = ["Axis", "along", "between", "carried", "heights", "lined", "revolved"]

RINGS, RING_SAMPLES = 64, 1_500_000
"""Rings of a slice, and voxels that are looked at for them: some hundreds for each."""

CHUNK = 400_000
"""Voxels laid out at once: bounds the memory of the look-ups."""

DIFFERENT = 0.10
"""Colour distance from which a place shows another thing and not another shade."""

WAVES = 0.035
"""Waviness of structures along the axis, radians: a cut along a straight sheet a voxel thick shows the grid."""

FLAT_END = 0.4
"""Share of the widest slice from which the end of a body counts as cut off flat and not as grown."""

DEFAULT_RIND = 0.15
"""Depth in inradii to which skin follows the surface where no picture says more."""

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
    return Axis(planar[:, :2], planar[:, 2] - planar[:, 2].min(), radius, rim_of(planar, radius), is_round)


def carried(
    space: Space,
    axis: Axis,
    layers: Sequence[Layers],
    rate: float,
    carve: Carving | None,
    core: Core | None,
    rng: np.random.Generator,
    progress: Progress,
) -> NDArray[np.float32]:
    """(N, 3). A picture drawn out along an axis: ground and structures straight, texture drifting `rate` cells a cell.

    Near the skin a voxel reads the picture at its own depth, deeper at its own share of the slice's radius.
    """
    main = layers[0]
    turn = rng.uniform(0, 2 * np.pi, 8)
    out = np.empty((len(axis.place), 3), np.float32)
    inradius = float(main.sheet.depth.max()) * space.inradius
    # Half a wavelength of the grain; and whether grains are long along the radius, like juice sacs.
    of, slope_a, slope_b = main.spread
    grain = float(np.clip(np.pi * of / slope_b, 2, 0.3 * inradius))
    stranded = slope_b > 1.8 * slope_a
    swing = 0.12 * inradius
    widest = space.widest
    for start in range(0, len(out), CHUNK):
        progress(start / len(out))
        part = slice(start, start + CHUNK)
        angle = np.arctan2(axis.place[part, 1], axis.place[part, 0])
        share = np.minimum(axis.radius[part] / axis.rim[part], 1)
        depth, level = space.depth[part], axis.level[part]
        if axis.round:
            wave = level / (0.55 * inradius)
            angle = angle + WAVES * (np.sin(wave + turn[4]) + np.sin(1.7 * wave + 5 * share + turn[5]))
        x, y = _place(space, main, angle, share, depth)
        bent = (x, y) if core is None else _place(space, main, angle, _bent(space, main, core, part, angle), depth)
        colour = _read(main.ground, *bent)
        # The texture's own way.
        phase = 0.3 * inradius * np.sin(angle + turn[0])
        to_and_fro = swing * _triangle((level + phase) * SIDEWAYS * rate / (4 * swing))
        if axis.round:
            # One angle for a whole slice, so that nothing is sheared; the pace is right at half the radius.
            other = angle + rate * level / (0.5 * inradius) + turn[3]
            if stranded:
                other = angle + _strands(angle, level, grain, round(np.pi * inradius / (2 * grain)), turn)
            u, v = _place(space, main, other, share, np.maximum(depth, main.rind))
            u, v = u + to_and_fro * np.cos(other), v - to_and_fro * np.sin(other)
        else:
            u, v = x + to_and_fro, y + swing * _triangle((level - phase) * rate / (4 * swing))
        colour += _read(main.texture, u, v)
        opacity, theirs = _structure(main, x, y)
        # On a small slice the picture is shrunk, but a membrane is as thick as anywhere.
        small = np.flatnonzero(main.sheet.rim(angle) > 1.15 * axis.rim[part])
        wider = np.minimum(main.sheet.rim(angle[small]) / axis.rim[part][small] - 1, 2) * main.thickness
        for side in (-1.0, -0.5, 0.5, 1.0):
            dx, dy = -np.sin(angle[small]) * wider * side, -np.cos(angle[small]) * wider * side
            more, colours = _structure(main, x[small] + dx, y[small] + dy)
            won = (more > opacity[small])[:, 0]
            opacity[small[won]], theirs[small[won]] = more[won], colours[won]
        if carve is not None:
            # The rind is the skin's, not the axis's.
            inner = np.flatnonzero((opacity[:, 0] > 0) & (depth > 1.2 * main.rind))
            middle = _read(carve.middle, x[inner], y[inner])
            left, colours = carve.at(
                theirs[inner], middle, space.radius[part][inner] / widest, space.height[part][inner]
            )
            opacity[inner, 0] *= left
            theirs[inner] = colours
        out[part] = colour + opacity * (theirs - colour)
    return np.clip(out, 0, 1)


def lined(space: Space, axis: Axis, colours: NDArray[np.float32], carrier: Layers, core: Core) -> None:
    """Draws the line around a core into a carried picture (N, 3), in place."""
    for start in range(0, len(colours), CHUNK):
        part = slice(start, start + CHUNK)
        angle = np.arctan2(axis.place[part, 1], axis.place[part, 0])
        away, _, ring = core.shell(space, part, angle)
        r = ring + away
        x, y = carrier.sheet.middle[0] + r * np.cos(angle), carrier.sheet.middle[1] - r * np.sin(angle)
        colours[part] += _read(core.line[..., None], x, y) * (carrier.sheet.read(x, y) - colours[part])


def _bent(space: Space, layers: Layers, core: Core, part: slice, angle: NDArray[np.floating]) -> NDArray[np.floating]:
    """(M,). The share of the rim at which a horizontal picture shows the ground as far in or out of a core."""
    away, shell, ring = core.shell(space, part, angle)
    at = ring / layers.sheet.rim(angle)
    out = np.maximum(away, 0)
    outside = out / (out + space.depth[part] * space.inradius + 1e-6)
    return np.where(away < 0, at * (1 + away / shell), at + (1 - at) * outside)


def between(space: Space, axis: Axis, stack: Slices) -> NDArray[np.float32]:
    """(N, 3). Slices of one thing turned into one another along an axis, each voxel at its share of the rim.

    Where the body closes at its ends a voxel near the skin reads the slice at its depth; where it is cut off flat, as a
    limb is, the end shows what lies inside.
    """
    out = np.empty((len(space.cells), 3), np.float32)
    levels = np.round(axis.level).astype(int)
    areas = np.bincount(levels)
    ends = np.flatnonzero(areas > SPECK * areas.max())
    inward = 1 + len(ends) // 50  # past an edge that the grid rounds off
    flat = min(areas[ends[inward]], areas[ends[-1 - inward]]) > FLAT_END * areas.max() if len(ends) > 8 else False
    for start in range(0, len(out), CHUNK):
        part = slice(start, start + CHUNK)
        share = np.minimum(axis.radius[part] / axis.rim[part], 1)
        if not flat:
            by_depth = np.clip(1 - space.depth[part] * space.inradius / axis.rim.max(), 0, 1)
            near = _near_skin(space.depth[part], DEFAULT_RIND)
            share = near * by_depth + (1 - near) * share
        angle = np.arctan2(axis.place[part, 1], axis.place[part, 0])
        out[part] = stack.read(share * np.cos(angle), share * np.sin(angle), axis.level[part] / len(areas))
    return out


def _structure(
    layers: Layers, x: NDArray[np.floating], y: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(M, 1), (M, 3). Opacity and colour of what runs through, at places in cells."""
    return _read(layers.structure[..., None], x, y), _read(layers.through, x, y)


def _strands(
    angle: NDArray[np.floating], level: NDArray[np.floating], grain: float, count: int, turn: NDArray[np.float64]
) -> NDArray[np.floating]:
    """(M,). For a texture of long grains: the angle by which each strand's picture is turned.

    Strands run out from the axis, `count` around it and two grains high, their walls a little wavy; each shows another
    part of the picture. So a cut across them shows the ends of grains, where a drift would draw them out to stripes.
    """
    row = level / (2 * grain) + 0.4 * np.sin((count // 2) * angle + turn[4]) + 0.25 * np.sin(5 * angle + turn[5])
    j = np.floor(row).astype(np.int64)
    i = (
        np.floor(angle / (2 * np.pi) * count + 0.5 * (j % 2) + 0.35 * np.sin(level / grain + turn[6])).astype(np.int64)
        % count
    )
    mixed = (i * 73856093 ^ j * 19349663) & 0xFFFFFF
    return (mixed * 2654435761 % 65521) / 65521 * 2 * np.pi


def _place(
    space: Space, layers: Layers, angle: NDArray[np.floating], share: NDArray[np.floating], depth: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(M,), (M,). Where in a picture, cells, a voxel at this angle, share of the rim and depth in inradii is found."""
    rim = layers.sheet.rim(angle)
    by_depth = np.maximum(rim - layers.sheet.inset(angle, depth * space.inradius), 0)
    near = _near_skin(depth, layers.rind)
    r = near * by_depth + (1 - near) * share * rim
    return layers.sheet.middle[0] + r * np.cos(angle), layers.sheet.middle[1] - r * np.sin(angle)


def _read(
    picture: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating], over: int = OVER
) -> NDArray[np.float32]:
    """(M, C). Bilinear values of a picture (H, W, C) at places in cells, with `over` pixels to a cell."""
    at = np.stack([y, x]) * over
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


def revolved(space: Space, layers: Layers, rng: np.random.Generator) -> NDArray[np.float32]:
    """(N, 3). The right half of a radial picture turned about the axis; its texture drifts, or it would show rings."""
    swing = 0.12 * float(layers.sheet.depth.max()) * space.inradius
    # To and fro a whole number of times on the way round, as fast as the texture is fine at half the radius.
    times = max(3, round(np.pi * float(np.median(space.rim)) / (4 * swing)))
    turn = rng.uniform(0, 1, 4)
    out = np.empty((len(space.cells), 3), np.float32)
    for start in range(0, len(out), CHUNK):
        part = slice(start, start + CHUNK)
        x, y = _radial_place(space, layers, part)
        round_ = np.arctan2(space.planar[part, 1], space.planar[part, 0]) / (2 * np.pi)
        # Out of step at other heights and radii, so that no face repeats itself.
        u = swing * _triangle(times * round_ + turn[0] + 0.3 * np.sin(space.height[part] * 4 + turn[1]))
        v = swing * _triangle((times + 1) * round_ + turn[2] + 0.3 * np.sin(space.radius[part] / swing + turn[3]))
        colour = _read(layers.ground, x, y) + _read(layers.texture, x + u, y + v)
        opacity, theirs = _structure(layers, x, y)
        out[part] = colour + opacity * (theirs - colour)
    return np.clip(out, 0, 1)


def heights(
    space: Space,
    axis: Axis,
    colours: NDArray[np.float32],
    carrier: Layers,
    radial: Sequence[Layers],
    carve: Carving | None,
) -> None:
    """Corrects a carried picture (N, 3), in place, by what radial pictures know of height.

    Each half of each radial picture is a look at the same map of (direction, depth). Where most of them show another
    thing than the carried picture's ring at that place (a layer, the end of a core, thick pith at a pole), theirs is
    taken; where they agree on a gentler difference, it is added. Seeds and other chance are in one of them at a time;
    where all of them meet a carpel of an apple, it is one that the carried picture has already, and no ring.
    """
    rings, under = _rings(axis, colours), _under(carrier, space.inradius)
    looks = [(p, side) for p in radial for side in (1, -1)]
    for start in range(0, len(colours), CHUNK):
        part = slice(start, start + CHUNK)
        share = np.minimum(axis.radius[part] / axis.rim[part], 1)
        # The rings of what was carried, by depth and share like the picture itself.
        near = _near_skin(space.depth[part], carrier.rind)[:, None]
        base = near * _along(under, space.depth[part] * space.inradius / INSET_STEP)
        base += (1 - near) * _read(rings, share * RINGS - 0.5, axis.level[part] - 0.5, 1)
        seen = np.empty((len(looks), len(base), 3), np.float32)
        for n, (parts, side) in enumerate(looks):
            x, y = _radial_place(space, parts, part)
            x = parts.sheet.middle[0] + side * (x - parts.sheet.middle[0])
            bare = _read(parts.ground, x, y) + _read(parts.texture, x, y)
            opacity = _read(parts.structure[..., None], x, y)
            seen[n] = bare + opacity * (_read(parts.through, x, y) - bare)
        if carve is not None:
            met = carve.explains(space.radius[part] / space.widest, space.height[part])
            seen[:, met] = base[met]
        gap = seen - base
        other = _smooth_step(DIFFERENT, 1.6 * DIFFERENT, np.linalg.norm(gap, axis=-1))
        votes = other.mean(0)
        weight = _smooth_step(0.45, 0.75, votes)[:, None]
        theirs = (other[..., None] * seen).sum(0) / np.maximum(other.sum(0), 1e-6)[:, None]
        gentle = np.median(gap, axis=0)
        chance = gap.std(axis=0).mean(-1, keepdims=True)
        gentle *= np.clip(1 - chance / np.maximum(np.abs(gentle).mean(-1, keepdims=True), 1e-6), 0, 1)
        colours[part] += gentle * (1 - weight)
        colours[part] += weight * (theirs - colours[part])


def _rings(axis: Axis, colours: NDArray[np.float32]) -> NDArray[np.float32]:
    """(L, RINGS, 3). Median colour of carried voxels at each level and share of the rim."""
    # Not every other one: in a straight body whole levels would be passed over.
    few = np.random.default_rng(0).integers(len(colours), size=min(len(colours), RING_SAMPLES))
    level = axis.level[few].astype(np.int64)
    share = np.minimum(axis.radius[few] / axis.rim[few] * RINGS, RINGS - 1).astype(np.int64)
    shape = int(axis.level.max()) + 1, RINGS
    ring = level * RINGS + share
    count = np.bincount(ring, minlength=shape[0] * RINGS)
    middle = np.cumsum(count) - count + count // 2
    middle = np.minimum(middle, len(ring) - 1)
    found = np.stack([colours[few, c][np.lexsort((colours[few, c], ring))][middle] for c in range(3)], -1)
    nearest = ndimage.distance_transform_edt(count.reshape(shape) == 0, return_distances=False, return_indices=True)
    return found.reshape(*shape, 3)[nearest[0], nearest[1]]


def _under(parts: Layers, inradius: float) -> NDArray[np.float32]:
    """(L, 3). Median colour of a picture at each INSET_STEP of depth under its edge."""
    sheet = parts.sheet
    angles = (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi
    levels = np.arange(0, float(sheet.depth.max()) * inradius, INSET_STEP)[:, None]
    r = np.maximum(sheet.rim(angles) - sheet.inset(*np.broadcast_arrays(angles, levels)), 0)
    return np.median(sheet.read(sheet.middle[0] + r * np.cos(angles), sheet.middle[1] - r * np.sin(angles)), axis=1)


def _along(colours: NDArray[np.float32], at: NDArray[np.floating]) -> NDArray[np.float64]:
    """(M, 3). A row of colours (L, 3) read at places (M,) along it."""
    return np.stack([np.interp(at, np.arange(len(colours)), colours[:, c]) for c in range(3)], -1)


def _radial_place(space: Space, layers: Layers, part: slice) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(M,), (M,). Where voxels lie in the right half of a radial picture, cells."""
    sheet = layers.sheet
    across = space.radius[part] / space.widest * sheet.half[0]
    up = space.height[part] * sheet.half[1]
    angle = np.arctan2(up, across)
    share = np.minimum(np.hypot(across, up) / sheet.rim(angle), 1)
    return _place(space, layers, angle, share, space.depth[part])


def _smooth_step(low: float, high: float, value: NDArray[np.floating]) -> NDArray[np.floating]:
    """0 under `low`, 1 over `high`."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
