"""Extrudes the layers of a picture along the axis that it does not show.

Structures run straight through; the texture drifts sideways, so that it is as fine along the axis as the pictures
show; details are left to `scatter`. Radial pictures then correct the result by height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.core_line import Core
from training.priors.exemplar.decompose import Layers
from training.priors.exemplar.frames import ANGLES, INSET_STEP, MIN_SLICE_SHARE, Space, rim_of
from training.priors.exemplar.height_mask import HeightMask
from training.priors.exemplar.morph import SliceStack
from training.priors.exemplar.patches import OVER
from training.priors.prior import Progress

__all__ = [
    "Axis",
    "Drift",
    "correct_by_height",
    "draw_core_line",
    "extrude",
    "interpolate_slices",
    "revolve",
    "view_along",
]

RINGS, RING_SAMPLES = 64, 1_500_000
"""Rings per slice, and voxels sampled for their median colours: some hundreds per ring."""

CHUNK = 400_000
"""Voxels processed at once: bounds the memory of the interpolation."""

MIN_DIFFERENCE = 0.10
"""RGB distance from which two pixels show different materials rather than different shades."""

WAVINESS = 0.035
"""Waviness of structures along the axis, radians: a cut along a straight membrane one voxel thick shows the grid."""

FLAT_END_SHARE = 0.4
"""Area of an end slice over the widest one from which the end counts as cut off flat."""

DEFAULT_RIND = 0.15
"""Thickness in inradii of the layer that follows the skin where no picture shows its thickness."""

RADIAL_DRIFT = 0.6
"""Texture drift along the radius over that around the axis. With either alone, cuts across it show stripes."""


@dataclass(frozen=True)
class Axis:
    """Voxels in slices across a direction, with their position in the slice."""

    place: NDArray[np.float32]
    """(N, 2). From the slices' common centre, cells."""
    level: NDArray[np.float32]
    """(N,). Position along the direction from the lowest voxel, cells."""
    radius: NDArray[np.float32]
    """(N,)."""
    rim: NDArray[np.float32]
    """(N,). Distance of the skin from the centre at the voxel's angle and level, cells."""
    round: bool
    """Whether slices may be rotated: a round outline does not fix the angle."""


@dataclass(frozen=True)
class Drift:
    """How the texture of slices moves along the axis, so that it ends along it as it does in the slices."""

    rate: float
    """Cells per cell."""
    share_a: float
    """Share of the full swing along the picture's direction a, and along b: rings and stripes are cut shells and
    sheets, which do not drift through themselves."""
    share_b: float

    @classmethod
    def of(cls, carrier: Sequence[Layers], radial: Sequence[Layers], is_round: bool) -> Drift:
        """The drift that gives the texture the slope along the axis which radial pictures show; without any, the
        carrier's own mean slope, but that of rings around them."""
        spread, a, b = np.mean([p.spread for p in carrier], axis=0)
        share_a = share_b = 1.0
        if radial:
            deviation, _, steep = np.mean([p.spread for p in radial], axis=0)
            wanted = steep / deviation
        else:
            share_a, share_b = min(b / a, 1.0), 1.0 if is_round else min(a / b, 1.0)
            wanted = np.hypot(share_a * a, b) / np.sqrt(2) / spread
        rate = wanted / (np.hypot(RADIAL_DRIFT * share_a * a, b) / spread)
        return cls(float(np.clip(rate, 0.1, 1.5)), float(share_a), float(share_b))


def view_along(space: Space, basis: NDArray[np.float64], is_round: bool) -> Axis:
    """The voxels in slices across the third row of `basis` (3, 3)."""
    planar = ((space.cells - space.centre) @ basis.T).astype(np.float32)
    radius = np.hypot(planar[:, 0], planar[:, 1])
    return Axis(planar[:, :2], planar[:, 2] - planar[:, 2].min(), radius, rim_of(planar, radius), is_round)


def extrude(
    space: Space,
    axis: Axis,
    layers: Sequence[Layers],
    drift: Drift,
    height_mask: HeightMask | None,
    core: Core | None,
    rng: np.random.Generator,
    progress: Progress,
) -> NDArray[np.float32]:
    """(N, 3). A picture extruded along an axis: ground and structures straight, texture drifting sideways.

    A voxel near the skin samples the picture at equal depth, a deeper one at the equal share of the slice's radius.
    """
    main = layers[0]
    phases = rng.uniform(0, 2 * np.pi, 8)
    out = np.empty((len(axis.place), 3), np.float32)
    inradius = float(main.source.depth.max()) * space.inradius
    # Half a wavelength of the grain, and whether grains are elongated along the radius, like juice sacs.
    of, slope_a, slope_b = main.spread
    grain = float(np.clip(np.pi * of / slope_b, 2, 0.3 * inradius))
    is_stranded = slope_b > 1.8 * slope_a
    swing = 0.12 * inradius
    swing_a, swing_b = swing * drift.share_a, swing * drift.share_b
    widest = space.widest
    for start in range(0, len(out), CHUNK):
        progress(start / len(out))
        part = slice(start, start + CHUNK)
        angle = np.arctan2(axis.place[part, 1], axis.place[part, 0])
        share = np.minimum(axis.radius[part] / axis.rim[part], 1)
        depth, level = space.depth[part], axis.level[part]
        if axis.round:
            wave = level / (0.55 * inradius)
            angle = angle + WAVINESS * (np.sin(wave + phases[4]) + np.sin(1.7 * wave + 5 * share + phases[5]))
        x, y = _picture_position(space, main, angle, share, depth)
        ground_position = (
            (x, y)
            if core is None
            else _picture_position(space, main, angle, _bend_around_core(space, main, core, part, angle), depth)
        )
        colour = _bilinear(main.ground, *ground_position)
        # The texture drifts.
        phase = 0.3 * inradius * np.sin(angle + phases[0])
        aside = swing_a * _triangle((level + phase) * RADIAL_DRIFT * drift.rate / (4 * swing))
        if axis.round:
            # One rotation for a whole slice, so that nothing is sheared; the rate is exact at half the radius.
            other = angle + drift.rate * level / (0.5 * inradius) + phases[3]
            if is_stranded:
                other = angle + _strand_angles(angle, level, grain, round(np.pi * inradius / (2 * grain)), phases)
            u, v = _picture_position(space, main, other, share, np.maximum(depth, main.rind))
            u, v = u + aside * np.cos(other), v - aside * np.sin(other)
        else:
            u, v = x + aside, y + swing_b * _triangle((level - phase) * drift.rate / (4 * swing))
        colour += _bilinear(main.texture, u, v)
        opacity, structure_rgb = _structure(main, x, y)
        # On a small slice the picture shrinks, but a membrane keeps its thickness.
        small = np.flatnonzero(main.source.rim(angle) > 1.15 * axis.rim[part])
        offset = np.minimum(main.source.rim(angle[small]) / axis.rim[part][small] - 1, 2) * main.thickness
        for side in (-1.0, -0.5, 0.5, 1.0):
            dx, dy = -np.sin(angle[small]) * offset * side, -np.cos(angle[small]) * offset * side
            more, colours = _structure(main, x[small] + dx, y[small] + dy)
            thicker = (more > opacity[small])[:, 0]
            opacity[small[thicker]], structure_rgb[small[thicker]] = more[thicker], colours[thicker]
        if height_mask is not None:
            # The rind follows the skin, not the axis.
            inner = np.flatnonzero((opacity[:, 0] > 0) & (depth > 1.2 * main.rind))
            centrality = _bilinear(height_mask.centrality, x[inner], y[inner])
            opacity_left, colours = height_mask.at(
                structure_rgb[inner], centrality, space.radius[part][inner] / widest, space.height[part][inner]
            )
            opacity[inner, 0] *= opacity_left
            structure_rgb[inner] = colours
        out[part] = colour + opacity * (structure_rgb - colour)
    return np.clip(out, 0, 1)


def draw_core_line(space: Space, axis: Axis, colours: NDArray[np.float32], carrier: Layers, core: Core) -> None:
    """Draws the line around a core into an extruded picture (N, 3), in place."""
    for start in range(0, len(colours), CHUNK):
        part = slice(start, start + CHUNK)
        angle = np.arctan2(axis.place[part, 1], axis.place[part, 0])
        away, _, ring = core.shell(space, part, angle)
        r = ring + away
        x, y = carrier.source.middle[0] + r * np.cos(angle), carrier.source.middle[1] - r * np.sin(angle)
        colours[part] += _bilinear(core.line[..., None], x, y) * (carrier.source.read(x, y) - colours[part])


def _bend_around_core(
    space: Space, layers: Layers, core: Core, part: slice, angle: NDArray[np.floating]
) -> NDArray[np.floating]:
    """(M,). The share of the rim at which a horizontal picture shows the ground at equal distance from a core."""
    away, shell, ring = core.shell(space, part, angle)
    at = ring / layers.source.rim(angle)
    out = np.maximum(away, 0)
    outside = out / (out + space.depth[part] * space.inradius + 1e-6)
    return np.where(away < 0, at * (1 + away / shell), at + (1 - at) * outside)


def interpolate_slices(space: Space, axis: Axis, stack: SliceStack) -> NDArray[np.float32]:
    """(N, 3). Slices of one object interpolated along an axis, each voxel at its share of the rim.

    Where the body closes at its ends, a voxel near the skin samples the slice at equal depth; where it is cut off flat,
    as a limb is, the end shows the inside.
    """
    out = np.empty((len(space.cells), 3), np.float32)
    levels = np.round(axis.level).astype(int)
    areas = np.bincount(levels)
    ends = np.flatnonzero(areas > MIN_SLICE_SHARE * areas.max())
    inward = 1 + len(ends) // 50  # beyond an edge that the grid rounds off
    flat = min(areas[ends[inward]], areas[ends[-1 - inward]]) > FLAT_END_SHARE * areas.max() if len(ends) > 8 else False
    for start in range(0, len(out), CHUNK):
        part = slice(start, start + CHUNK)
        share = np.minimum(axis.radius[part] / axis.rim[part], 1)
        if not flat:
            by_depth = np.clip(1 - space.depth[part] * space.inradius / axis.rim.max(), 0, 1)
            near = _skin_weight(space.depth[part], DEFAULT_RIND)
            share = near * by_depth + (1 - near) * share
        angle = np.arctan2(axis.place[part, 1], axis.place[part, 0])
        out[part] = stack.read(share * np.cos(angle), share * np.sin(angle), axis.level[part] / len(areas))
    return out


def _structure(
    layers: Layers, x: NDArray[np.floating], y: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(M, 1), (M, 3). Opacity and colour of the structures at positions in cells."""
    return _bilinear(layers.structure[..., None], x, y), _bilinear(layers.through, x, y)


def _strand_angles(
    angle: NDArray[np.floating], level: NDArray[np.floating], grain: float, count: int, phases: NDArray[np.float64]
) -> NDArray[np.floating]:
    """(M,). For a texture of long grains: the angle by which each strand's texture is rotated.

    Strands run outwards from the axis, `count` around it and two grains high, with slightly wavy walls; each shows
    another part of the picture. A cut across them shows the ends of grains, where a drift would produce stripes.
    """
    row = level / (2 * grain) + 0.4 * np.sin((count // 2) * angle + phases[4]) + 0.25 * np.sin(5 * angle + phases[5])
    j = np.floor(row).astype(np.int64)
    i = (
        np.floor(angle / (2 * np.pi) * count + 0.5 * (j % 2) + 0.35 * np.sin(level / grain + phases[6])).astype(
            np.int64
        )
        % count
    )
    mixed = (i * 73856093 ^ j * 19349663) & 0xFFFFFF
    return (mixed * 2654435761 % 65521) / 65521 * 2 * np.pi


def _picture_position(
    space: Space, layers: Layers, angle: NDArray[np.floating], share: NDArray[np.floating], depth: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(M,), (M,). Picture position, in cells, of voxels at an angle, share of the rim and depth in inradii."""
    rim = layers.source.rim(angle)
    by_depth = np.maximum(rim - layers.source.inset(angle, depth * space.inradius), 0)
    near = _skin_weight(depth, layers.rind)
    r = near * by_depth + (1 - near) * share * rim
    return layers.source.middle[0] + r * np.cos(angle), layers.source.middle[1] - r * np.sin(angle)


def _bilinear(
    picture: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating], over: int = OVER
) -> NDArray[np.float32]:
    """(M, C). Bilinear values of a picture (H, W, C) at positions in cells, with `over` pixels per cell."""
    at = np.stack([y, x]) * over
    return np.stack(
        [
            ndimage.map_coordinates(picture[..., c], at, order=1, mode="nearest", output=np.float32)
            for c in range(picture.shape[-1])
        ],
        axis=-1,
    )


def _triangle(phase: NDArray[np.floating]) -> NDArray[np.floating]:
    """Triangle wave of period 1 and range [-1, 1], rounded at its extremes."""
    return np.arcsin(0.97 * np.sin(2 * np.pi * phase)) / np.arcsin(0.97)


def _skin_weight(depth: NDArray[np.floating], rind: float) -> NDArray[np.floating]:
    """1 within the rind, falling smoothly to 0 below it."""
    t = np.clip((depth - 1.1 * rind) / (0.7 * rind + 0.1), 0, 1)
    return 1 - t * t * (3 - 2 * t)


def revolve(space: Space, layers: Layers, rng: np.random.Generator) -> NDArray[np.float32]:
    """(N, 3). The right half of a radial picture revolved about the axis; its texture drifts, or it would show
    rings."""
    swing = 0.12 * float(layers.source.depth.max()) * space.inradius
    # A whole number of periods around the axis; the drift is as fast as the texture is fine at half the radius.
    times = max(3, round(np.pi * float(np.median(space.rim)) / (4 * swing)))
    phases = rng.uniform(0, 1, 4)
    out = np.empty((len(space.cells), 3), np.float32)
    for start in range(0, len(out), CHUNK):
        part = slice(start, start + CHUNK)
        x, y = _radial_position(space, layers, part)
        round_ = np.arctan2(space.planar[part, 1], space.planar[part, 0]) / (2 * np.pi)
        # Phases vary with height and radius, so that no face repeats itself.
        u = swing * _triangle(times * round_ + phases[0] + 0.3 * np.sin(space.height[part] * 4 + phases[1]))
        v = swing * _triangle((times + 1) * round_ + phases[2] + 0.3 * np.sin(space.radius[part] / swing + phases[3]))
        colour = _bilinear(layers.ground, x, y) + _bilinear(layers.texture, x + u, y + v)
        opacity, structure_rgb = _structure(layers, x, y)
        out[part] = colour + opacity * (structure_rgb - colour)
    return np.clip(out, 0, 1)


def correct_by_height(
    space: Space,
    axis: Axis,
    colours: NDArray[np.float32],
    carrier: Layers,
    radial: Sequence[Layers],
    height_mask: HeightMask | None,
) -> None:
    """Corrects an extruded picture (N, 3), in place, by what the radial pictures show at each height.

    Each half of each radial picture samples the same map of (direction, depth). Where most halves show a different
    material from the extruded picture's ring there (a layer, the end of a core, thick pith at a pole), their colour
    replaces it; where they agree on a smaller difference, it is added. Seeds and other chance features appear in one
    half at a time. Where all halves cross an apple's carpel, the extrusion has it already and it is left alone.
    """
    rings, by_depth_rgb = _median_rings(axis, colours), _median_by_depth(carrier, space.inradius)
    halves = [(p, side) for p in radial for side in (1, -1)]
    for start in range(0, len(colours), CHUNK):
        part = slice(start, start + CHUNK)
        share = np.minimum(axis.radius[part] / axis.rim[part], 1)
        # The extruded rings, by depth and share like the picture itself.
        near = _skin_weight(space.depth[part], carrier.rind)[:, None]
        base = near * _interpolate_rows(by_depth_rgb, space.depth[part] * space.inradius / INSET_STEP)
        base += (1 - near) * _bilinear(rings, share * RINGS - 0.5, axis.level[part] - 0.5, 1)
        seen = np.empty((len(halves), len(base), 3), np.float32)
        for n, (parts, side) in enumerate(halves):
            x, y = _radial_position(space, parts, part)
            x = parts.source.middle[0] + side * (x - parts.source.middle[0])
            bare = _bilinear(parts.ground, x, y) + _bilinear(parts.texture, x, y)
            opacity = _bilinear(parts.structure[..., None], x, y)
            seen[n] = bare + opacity * (_bilinear(parts.through, x, y) - bare)
        if height_mask is not None:
            explained = height_mask.explains(space.radius[part] / space.widest, space.height[part])
            seen[:, explained] = base[explained]
        gap = seen - base
        other = _smoothstep(MIN_DIFFERENCE, 1.6 * MIN_DIFFERENCE, np.linalg.norm(gap, axis=-1))
        votes = other.mean(0)
        weight = _smoothstep(0.45, 0.75, votes)[:, None]
        structure_rgb = (other[..., None] * seen).sum(0) / np.maximum(other.sum(0), 1e-6)[:, None]
        gentle = np.median(gap, axis=0)
        chance = gap.std(axis=0).mean(-1, keepdims=True)
        gentle *= np.clip(1 - chance / np.maximum(np.abs(gentle).mean(-1, keepdims=True), 1e-6), 0, 1)
        colours[part] += gentle * (1 - weight)
        colours[part] += weight * (structure_rgb - colours[part])


def _median_rings(axis: Axis, colours: NDArray[np.float32]) -> NDArray[np.float32]:
    """(L, RINGS, 3). Median colour of extruded voxels at each level and share of the rim."""
    # Random, not strided: in a straight body a stride would skip whole levels.
    sample = np.random.default_rng(0).integers(len(colours), size=min(len(colours), RING_SAMPLES))
    level = axis.level[sample].astype(np.int64)
    share = np.minimum(axis.radius[sample] / axis.rim[sample] * RINGS, RINGS - 1).astype(np.int64)
    shape = int(axis.level.max()) + 1, RINGS
    ring = level * RINGS + share
    count = np.bincount(ring, minlength=shape[0] * RINGS)
    middle = np.cumsum(count) - count + count // 2
    middle = np.minimum(middle, len(ring) - 1)
    found = np.stack([colours[sample, c][np.lexsort((colours[sample, c], ring))][middle] for c in range(3)], -1)
    nearest = ndimage.distance_transform_edt(count.reshape(shape) == 0, return_distances=False, return_indices=True)
    return found.reshape(*shape, 3)[nearest[0], nearest[1]]


def _median_by_depth(parts: Layers, inradius: float) -> NDArray[np.float32]:
    """(L, 3). Median colour of a picture at each INSET_STEP of depth under its edge."""
    scaled = parts.source
    angles = (np.arange(ANGLES) + 0.5) / ANGLES * 2 * np.pi
    levels = np.arange(0, float(scaled.depth.max()) * inradius, INSET_STEP)[:, None]
    r = np.maximum(scaled.rim(angles) - scaled.inset(*np.broadcast_arrays(angles, levels)), 0)
    return np.median(scaled.read(scaled.middle[0] + r * np.cos(angles), scaled.middle[1] - r * np.sin(angles)), axis=1)


def _interpolate_rows(colours: NDArray[np.float32], at: NDArray[np.floating]) -> NDArray[np.float64]:
    """(M, 3). A row of colours (L, 3) interpolated linearly at positions (M,)."""
    return np.stack([np.interp(at, np.arange(len(colours)), colours[:, c]) for c in range(3)], -1)


def _radial_position(space: Space, layers: Layers, part: slice) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(M,), (M,). Positions of voxels in the right half of a radial picture, cells."""
    scaled = layers.source
    across = space.radius[part] / space.widest * scaled.half[0]
    up = space.height[part] * scaled.half[1]
    angle = np.arctan2(up, across)
    share = np.minimum(np.hypot(across, up) / scaled.rim(angle), 1)
    return _picture_position(space, layers, angle, share, space.depth[part])


def _smoothstep(low: float, high: float, value: NDArray[np.floating]) -> NDArray[np.floating]:
    """Hermite interpolation from 0 at `low` to 1 at `high`."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
