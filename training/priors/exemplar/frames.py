"""Coordinates of voxels in the body and of pixels in their pictures, with their local frames.

Voxels and pixels share gate coordinates, in units of a gate cell: saturating depth under the skin, relative radius,
and height. A voxel may only take from pixels with similar gate coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.camera import equator
from engine.scene.grid import Body, Grid
from engine.solid.distance_transform import depth_in
from training.families import Kind
from training.priors.exemplar.outline import ANGLES, Outline, find_insets, find_rims
from training.priors.exemplar.patches import FIXED, OVER, POLAR, RADIAL
from training.priors.exemplar.pictures import Picture, fill_outside
from training.priors.exemplar.sampling import read_as_scipy, read_bilinear, smoothstep

__all__ = [
    "DIRECTIONS",
    "HEIGHT_CELLS",
    "MIN_SLICE_SHARE",
    "RADIUS_CELLS",
    "Frame",
    "ScaledPicture",
    "Space",
    "View",
    "depth_gate",
    "frame_of",
    "make_space",
    "read_reach",
    "read_rims",
    "rim_of",
    "rim_table",
    "scale_picture",
    "scale_to_voxels",
    "to_pixel",
    "turn_of",
    "upright_factor",
    "voxel_gate",
]

DEPTH_SCALE = 0.15
"""Depth in inradii over which the depth coordinate saturates."""

DEPTH_CELLS, RADIUS_CELLS, HEIGHT_CELLS = 7.0, 7.0, 4.0
"""Gate cells over the range of each coordinate: fine enough for rings, coarse enough for seeds at any height."""

MARGIN = 6
"""Cells of air around the body, so that patches at the skin stay on the grid."""

PAD = 3
"""Cells around a scaled picture."""

MIN_SLICE_SHARE = 0.02
"""Share of the largest slice's area; smaller slices at an end are a stalk or a crumb and do not count as height."""

DIRECTIONS = 32
"""Directions around the axis in which it is known how far the skin is at most: enough for the corners of a box, and
each with many voxels."""

ROUND = 0.09
"""Largest relative standard deviation of the rim of a round body: that of an ellipse of ratio 1.3."""

ALIKE, OTHER = 1.45, 2.0
"""Ratio up to which a radial picture and a body are taken to have the same proportions, and from which they have others
altogether. A picture shows another individual, or one cut aslant: of seven pictures of apples, oranges and melons on
scans of the kind the ratios are 0.70 to 1.23, and their directions from the middle agree better than their heights."""

Frame = int
"""POLAR, RADIAL or FIXED (see `patches`)."""


@dataclass(frozen=True)
class Space:
    """The voxels of the volume and their coordinates in the body."""

    body: Body
    up: NDArray[np.float64]
    basis: NDArray[np.float64]
    """(3, 3). Rows e1, e2, up."""
    centre: NDArray[np.float32]
    """(3,). Centre of the body, in cells (cell centres at whole numbers)."""
    cells: NDArray[np.int16]
    """(N, 3). Indices of voxels inside the body or crossed by its skin."""
    number: NDArray[np.int32]
    """(X, Y, Z). Row of each voxel in `cells`, -1 outside."""
    depth: NDArray[np.float32]
    """(N,). Depth under the skin over the inradius, at least 0."""
    planar: NDArray[np.float32]
    """(N, 3). Position along e1, e2, up from the centre, in cells."""
    radius: NDArray[np.float32]
    """(N,). Distance from the axis in cells."""
    rim: NDArray[np.float32]
    """(N,). Distance of the skin from the axis at the voxel's angle and height, in cells."""
    height: NDArray[np.float32]
    """(N,). Height along the up axis, range [-1, 1] over the body."""
    half_height: float
    """Half the height of the body along the up axis, in cells."""
    outside: tuple[NDArray[np.int32], NDArray[np.int32]]
    """Flat indices of the other voxels of the grid, and for each, of the nearest one in `cells`."""

    @property
    def inradius(self) -> float:
        """Inradius of the body in cells."""
        return self.body.inradius / self.body.grid.cell

    @cached_property
    def reach(self) -> NDArray[np.float32]:
        """(DIRECTIONS,). How far from the axis the skin lies in each direction, in cells: at the height where that is
        farthest, as a 95th percentile so that crumbs do not count. In an oblong body, radial pictures are as wide."""
        skin = self.depth < 0.1
        if not skin.any():
            return np.ones(DIRECTIONS, np.float32)
        rim = self.rim[skin]
        direction = (self.turn[skin] * DIRECTIONS).astype(int) % DIRECTIONS
        each = [rim[direction == n] for n in range(DIRECTIONS)]
        farthest = [np.percentile(some if len(some) else rim, 95) for some in each]
        return ndimage.gaussian_filter1d(farthest, 1.0, mode="wrap").astype(np.float32)

    @property
    def turn(self) -> NDArray[np.float32]:
        """(N,). Angle of the voxels around the axis in turns. Range [0, 1]."""
        return turn_of(self.planar)

    @cached_property
    def across(self) -> NDArray[np.float32]:
        """(N,). Distance of the voxels from the axis over the `reach` in their direction."""
        return self.radius / read_reach(self.reach, self.turn)

    @property
    def points(self) -> NDArray[np.float64]:
        """(N, 3). World points of the voxels."""
        grid = self.body.grid
        return np.asarray(grid.origin) + (self.cells + 0.5) * grid.cell

    def fill(self, rgb: NDArray[np.float32]) -> None:
        """Gives the other voxels of the grid (X, Y, Z, 3) the colour of the nearest one in `cells`, in place."""
        flat = rgb.reshape(-1, 3)
        flat[self.outside[0]] = flat[self.outside[1]]

    def scatter(self, colours: NDArray[np.float32]) -> NDArray[np.float32]:
        """(X, Y, Z, 3). A grid from one colour per voxel (N, 3)."""
        rgb = np.zeros((*self.number.shape, 3), np.float32)
        rgb[self.cells[:, 0], self.cells[:, 1], self.cells[:, 2]] = colours
        self.fill(rgb)
        return rgb

    @property
    def is_round(self) -> bool:
        """Whether slices across the axis are round enough for a picture to be rotated in them.

        The rim of a round body varies by a few per cent around the axis, that of a loaf or a thigh by a quarter.
        """
        middle = np.abs(self.height) < 0.3
        edge = middle & (self.radius > self.rim - 1.5)
        return float(self.rim[edge].std() / self.rim[edge].mean()) < ROUND

    def proportions(self, basis: NDArray[np.float64]) -> float:
        """Width over height of the widest slice across the third row of `basis` (3, 3), along the first two; by
        standard deviations, as of a picture."""
        planar = (self.cells - self.centre) @ basis.T
        level = np.round(planar[:, 2] - planar[:, 2].min()).astype(int)
        width, height = np.sqrt(planar[level == np.bincount(level).argmax(), :2].var(0) + 1 / 12)  # of whole cells
        return float(width / height)

    @property
    def axial_area(self) -> int:
        """Area in square cells of the cut through the axis along e1."""
        return int(((self.planar[:, 1] >= -0.5) & (self.planar[:, 1] < 0.5)).sum())

    @property
    def axial_proportions(self) -> float:
        """Width over height of the cuts through the axis, by standard deviations; the mean of all directions."""
        share = 1 / np.maximum(self.radius, 0.5)  # of a voxel in a cut, as cuts crowd at the axis
        width = np.average(np.square(self.radius), weights=share)
        height = np.average(np.square(self.planar[:, 2] - np.average(self.planar[:, 2], weights=share)), weights=share)
        return float(np.sqrt(width / height))

    def widest_slice(self, along: NDArray[np.floating]) -> float:
        """Area in square cells of the largest slice across a direction; `along` (N,) are positions along it."""
        return float(np.bincount(np.round(along - along.min()).astype(int)).max())


def frame_of(kind: Kind, space: Space) -> Frame:
    """How pictures of a family of this kind, but no custom one, are laid in a body: horizontal ones may be turned if it
    is round."""
    if kind == "radial":
        return RADIAL
    return POLAR if kind == "horizontal" and space.is_round else FIXED


def upright_factor(body: float, picture: float) -> float:
    """The factor along the axis that brings a body of this width over height to a radial picture's, unless they are
    nearly the same."""
    ratio = body / picture
    return float(ratio ** smoothstep((abs(np.log(ratio)) - np.log(ALIKE)) / np.log(OTHER / ALIKE)))


def make_space(body: Body, up: NDArray[np.float64], voxels: int) -> Space:
    """The body on a grid of `voxels` cells along its longest side, with coordinates for every voxel."""
    up = np.asarray(up, np.float64) / np.linalg.norm(up)
    low, high = body.bounds()
    cell = float((high - low).max()) / voxels
    grid = Grid.around(body.bounds(), cell, MARGIN)
    # Smoothed, or a grid finer than the body's own would show its steps.
    depth = body.on(grid)
    if cell < body.grid.cell:
        depth = ndimage.gaussian_filter(depth, 0.5 * body.grid.cell / cell)
    body = Body(grid, depth)
    wanted = depth > -0.9 * cell
    cells = np.argwhere(wanted).astype(np.int16)
    number = np.full(grid.shape, -1, np.int32)
    number[wanted] = np.arange(len(cells), dtype=np.int32)
    basis = np.stack([*equator(up), up])
    inside = cells.T[:, depth[wanted] > 0].T  # in the memory order of `cells`, as of any product of matrices
    centre = inside.mean(0)
    along = (inside - centre) @ up
    areas = np.bincount(np.round(along - along.min()).astype(int))
    levels = np.flatnonzero(areas > MIN_SLICE_SHARE * areas.max())
    half = max((levels[-1] - levels[0] + 1) / 2, 1.0)
    centre = centre + up * (along.min() + (levels[0] + levels[-1]) / 2)
    planar = ((cells - centre) @ basis.T).astype(np.float32)
    radius = np.hypot(planar[:, 0], planar[:, 1])
    outside = np.flatnonzero(~wanted)
    nearest = ndimage.distance_transform_edt(~wanted, return_distances=False, return_indices=True)
    source = np.ravel_multi_index(tuple(n.ravel()[outside] for n in nearest), grid.shape)
    return Space(
        body,
        up,
        basis,
        centre.astype(np.float32),
        cells,
        number,
        np.maximum(depth[wanted] / body.inradius, 0).astype(np.float32),
        planar,
        radius,
        rim_of(planar, radius),
        np.clip(planar[:, 2] / half, -1, 1),
        float(half),
        (outside.astype(np.int32), source.astype(np.int32)),
    )


def rim_of(planar: NDArray[np.float32], radius: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N,). The largest radius among the voxels (N, 3) of the same height and angle, in cells."""
    level = np.round(planar[:, 2] - planar[:, 2].min()).astype(int)
    return read_rims(rim_table(planar, radius), level, turn_of(planar), radius)


def rim_table(planar: NDArray[np.float32], radius: NDArray[np.float32]) -> NDArray[np.float32]:
    """(L, ANGLES + 2). The largest radius among voxels (N, 3) by height in cells above the lowest, and by angle, with
    the angles wrapped on both sides."""
    level = np.round(planar[:, 2] - planar[:, 2].min()).astype(int)
    turn = (turn_of(planar) * ANGLES).astype(int) % ANGLES
    rims = np.zeros((level.max() + 1, ANGLES), np.float32)
    np.maximum.at(rims, (level, turn), radius)
    # Narrow slices have fewer voxels than angles: dilate over the angles, then smooth away the steps of the grid.
    wide = ndimage.grey_dilation(rims, size=(1, 9), mode="wrap")
    rims = np.where(rims > 0.8 * wide, rims, wide)
    rims = ndimage.gaussian_filter(rims, (0.7, 2.0), mode=("nearest", "wrap"))
    # For interpolation between angles: without it, an oblique outline would show teeth under the skin.
    return np.pad(rims, ((0, 0), (1, 1)), mode="wrap")


def read_rims(
    rims: NDArray[np.float32], level: NDArray[np.floating], turn: NDArray[np.floating], radius: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(M,). Distance of the skin from the axis by a `rim_table`, at levels in cells and angles in turns; at least the
    `radius` (M,) of the points themselves."""
    rim = read_bilinear(rims[..., None], level, turn * ANGLES + 0.5)[:, 0]
    return np.maximum(rim, np.maximum(radius, 0.5))


def turn_of(planar: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M,). Angle in turns of positions (M, 2 or 3) around the axis across their first two. Range [0, 1]."""
    return (np.arctan2(planar[:, 1], planar[:, 0]) / np.float32(2 * np.pi) % 1).astype(np.float32)


def read_reach(reach: NDArray[np.float32], turn: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M,). A `Space.reach` at angles (M,) in turns."""
    return np.interp(turn * DIRECTIONS - 0.5, np.arange(DIRECTIONS), reach, period=DIRECTIONS).astype(np.float32)


def depth_gate(depth: NDArray[np.floating]) -> NDArray[np.float32]:
    """Gate coordinate of a depth in inradii: fine in the rind, saturated in the middle."""
    return ((1 - np.exp(-np.asarray(depth, np.float32) / DEPTH_SCALE)) * DEPTH_CELLS).astype(np.float32)


@dataclass(frozen=True)
class ScaledPicture(Outline):
    """A picture resampled to the scale of the voxels: `OVER` pixels per cell."""

    rgb: NDArray[np.float32]
    """(H, W, 3)."""
    xy: NDArray[np.float32]
    """(P, 2). Positions of the candidate pixels in cells."""
    ab: NDArray[np.float32]
    """(P, 4). Their frame directions a and b in the picture, x to the right and y down."""
    gate: NDArray[np.float32]
    """(P, 3). Their gate coordinates."""
    depth: NDArray[np.float32]
    """(H, W). Depth under the edge, over the body's inradius; 0 outside."""

    def read(self, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        """(..., 3). Bilinear colours at (x, y) in cells."""
        return read_as_scipy(self.rgb, *(np.asarray(at) * OVER for at in (y, x)))


@dataclass(frozen=True)
class View:
    """The viewing frame of a family, and its pictures."""

    kind: Frame
    basis: NDArray[np.float64]
    """(3, 3). World rows: e1, e2, up for round frames; a, b, normal for a fixed one."""
    pictures: list[ScaledPicture]
    stretch: float = 1.0
    """Factor along the first row, and divisor along the second, with which the body is as wide for its height as the
    first picture's face. Without it, directions in a slim body would show other parts of a square picture than its
    sides do: level layers would bend to an hourglass."""


def scale_to_voxels(picture: Picture, space: Space, kind: Frame, area: float) -> ScaledPicture:
    """The picture scaled so that its cut face covers `area` square cells, with gate coordinates for a frame."""
    return scale_picture(picture, space.inradius, kind, float(np.sqrt(area / max(picture.mask.sum(), 1))))


def to_pixel(place: NDArray[np.floating], cells: float) -> NDArray[np.floating]:
    """Places in a scaled picture, in cells, as indices of the picture's own pixels, of `cells` cells each."""
    return ((place - PAD) * OVER + 0.5) / (cells * OVER) - 0.5


def scale_picture(picture: Picture, inradius: float, kind: Frame, cells: float) -> ScaledPicture:
    """The picture with `cells` cells per pixel, for a body of this inradius in cells."""
    scale = cells * OVER
    rgb, mask = _resize(picture.rgb, scale), _resize(picture.mask.astype(np.float32), scale) > 0.5
    pad = PAD * OVER
    mask = np.pad(mask, pad)
    rgb = np.pad(rgb, ((pad, pad), (pad, pad), (0, 0)), mode="edge")
    rgb = np.clip(np.where(mask[..., None], rgb, fill_outside(rgb, mask)), 0, 1)
    # The edge lies half a pixel outside the centre of the outermost pixel.
    depth = np.maximum(depth_in(mask) - 0.5, 0).astype(np.float32) / np.float32(OVER * inradius)
    rows, columns = np.nonzero(mask)
    if kind == POLAR:
        middle = (float(columns.mean()) / OVER, float(rows.mean()) / OVER)
    else:
        middle = (float(columns.min() + columns.max()) / 2 / OVER, float(rows.min() + rows.max()) / 2 / OVER)
    if picture.core is not None and kind != FIXED:
        x, y = ((place * scale - 0.5 + pad) / OVER for place in picture.core)
        middle = (x, y if kind == POLAR else middle[1])
    half = (float(np.ptp(columns)) / 2 / OVER, float(np.ptp(rows)) / 2 / OVER)
    rims = find_rims(mask, middle)
    insets = find_insets(depth * np.float32(inradius), middle, rims)
    grid = np.zeros_like(mask)
    grid[::OVER, ::OVER] = True
    rows, columns = np.nonzero(mask & grid)
    xy = (np.stack([columns, rows], -1) / OVER).astype(np.float32)
    right, high = xy[:, 0] - middle[0], middle[1] - xy[:, 1]
    r = np.hypot(right, high)
    d = depth_gate(depth[rows, columns])
    zero, one = np.zeros_like(r), np.ones_like(r)
    if kind == POLAR:
        c, s = right / np.maximum(r, 1e-3), high / np.maximum(r, 1e-3)
        ab = np.stack([c, -s, -s, -c], -1)
        turn = np.arctan2(high, right)
        rim = ndimage.map_coordinates(rims, (turn / (2 * np.pi) * ANGLES - 0.5)[None], order=1, mode="grid-wrap")
        gate = np.stack([d, np.minimum(r / rim, 1) * RADIUS_CELLS, zero], -1)
    elif kind == RADIAL:
        ab = np.stack([np.where(right < 0, -one, one), zero, zero, -one], -1)
        gate = np.stack([d, np.abs(right) / half[0] * RADIUS_CELLS, (high / half[1] + 1) / 2 * HEIGHT_CELLS], -1)
    else:
        ab = np.stack([one, zero, zero, -one], -1)
        gate = np.stack([d, zero, zero], -1)
    return ScaledPicture(middle, half, rims, insets, rgb, xy, ab.astype(np.float32), gate.astype(np.float32), depth)


def voxel_gate(space: Space, kind: Frame) -> NDArray[np.float32]:
    """(N, 3). Gate coordinates of the voxels for a frame, in the units of `ScaledPicture.gate`."""
    d = depth_gate(space.depth)
    zero = np.zeros_like(d)
    if kind == POLAR:
        return np.stack([d, np.minimum(space.radius / space.rim, 1) * np.float32(RADIUS_CELLS), zero], -1)
    if kind == RADIAL:
        across = np.minimum(space.across, 1) * np.float32(RADIUS_CELLS)
        return np.stack([d, across, (space.height + 1) / 2 * np.float32(HEIGHT_CELLS)], -1)
    return np.stack([d, zero, zero], -1)


def _resize(a: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    """A picture (H, W) or (H, W, C) at another scale; smoothed before shrinking, against aliasing."""
    if scale < 1:
        sigma = 0.4 * (1 / scale - 1) ** 0.5 if scale > 0.5 else 0.4 / scale
        a = ndimage.gaussian_filter(a, (sigma, sigma, *[0] * (a.ndim - 2)))
    shape = [max(2, round(n * scale)) for n in a.shape[:2]]
    y = (np.arange(shape[0]) + 0.5) / shape[0] * a.shape[0] - 0.5
    x = (np.arange(shape[1]) + 0.5) / shape[1] * a.shape[1] - 0.5
    at = np.stack(np.meshgrid(y, x, indexing="ij"))
    if a.ndim == 2:
        return ndimage.map_coordinates(a, at, order=1, mode="nearest", output=np.float32)
    # Cubic for enlargements: linear interpolation would show the pixels of a small photograph.
    order = 3 if scale > 1.5 else 1
    channels = [
        ndimage.map_coordinates(a[..., c], at, order=order, mode="nearest", output=np.float32) for c in range(3)
    ]
    return np.clip(np.stack(channels, -1), 0, 1)
