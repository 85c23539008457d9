"""The cores of pictures: found, and laid as solids in their own planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from skimage.measure import regionprops

from engine.solid.distance_transform import depth_in
from training.priors.exemplar.quilting.chunks import OWN_AZIMUTHS, Ball, OwnHeight
from training.priors.exemplar.quilting.disc import PIXEL, Disc, disc_grid, disc_radius, evened
from training.priors.exemplar.quilting.labels import Label, Source, made_of_grains
from training.priors.exemplar.quilting.relief import BLEND
from training.priors.exemplar.quilting.rinds import rind_of
from training.priors.exemplar.quilting.things.column import Column
from training.priors.exemplar.quilting.things.core import COMPACT, MARGIN, NEAR, Core, Profile, find_shape, seen_along
from training.priors.exemplar.quilting.things.widths import MOST, widths_along

__all__ = ["Cores", "find_core", "find_cores", "in_one_tone", "show_chambers", "show_core_that_ends"]

ALONE = 0.015
"""Distance in radii from a picture's own plane within which other pictures' cores fade: the plane shows its picture."""

THIN_ALONE = 0.006
"""The same where a thick line would show: from a horizontal picture's plane, which crosses the pips of radial ones, and
for a core in one piece, which passes through all planes and is back where a radial picture closes beside its own."""

EDGES = 0.02
"""Distance in radii from a radial picture's plane over which the edge of a core in one piece passes from where that
shows it to where the horizontal picture does: a tip, where it would be a bar that sticks out. With 0.05, oranges have
lumps for stars."""

CROSSING = 10.0
"""How many times nearer than the horizontal picture's plane a radial one's has to be for its picture to show in such
a core: as a line in cuts beside the other plane, it is as much thinner."""

ONE_BODY = 0.25
"""Least share of a core's area in its largest inscribed circle if it is one body on the axis. In photographs of five
apples it is 0.12 to 0.17, of three oranges 0.39 to 0.60."""


@dataclass(frozen=True)
class Cores:
    """The core of the horizontal picture, and what radial ones show of it."""

    height: float
    """Height of the horizontal picture in the ball."""
    across: Source
    along: Sequence[Source]
    """The radial pictures with own planes, evenly spread over half a turn. A column is shown by their planes alone."""

    @classmethod
    def of(cls, labels: Sequence[Label]) -> Cores | None:
        """The cores of a quilt with these labels; None if there are none."""
        own = {label.is_horizontal: label for label in labels if label.is_own}
        chunks = own[True].chunks if True in own else None
        if not isinstance(chunks, OwnHeight) or not own[True].sources[0].core.reach:
            return None
        along = own[False].sources[:OWN_AZIMUTHS] if False in own else []
        return cls(float(chunks.height), own[True].sources[0], along)

    def read(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, 3) and (M,). Colours of cores at points (M, 3) of the ball, multiplied by how much of the point they
        cover, and that cover. Range [0, 1]."""
        rgb, cover = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
        rise = points[:, 2] - np.float32(self.height)
        rows = np.flatnonzero(self.across.core.holds(points[:, 0], points[:, 1], rise))
        if not len(rows):
            return rgb, cover
        rise, (x, y, _) = rise[rows], points[rows].T
        turns = np.arange(len(self.along))[:, None] * np.pi / max(len(self.along), 1)
        c, s = np.cos(turns).astype(np.float32), np.sin(turns).astype(np.float32)
        right, off = c * x + s * y, c * y - s * x
        across = self.across.core
        if isinstance(across, Column) or across.profile:
            rgb[rows], cover[rows] = self._whole(across, points[rows], rise, right, off)
        else:
            rgb[rows], cover[rows] = self._closed(points[rows], rise, right, off)
        return rgb, cover

    def _closed(
        self,
        points: NDArray[np.float32],
        rise: NDArray[np.float32],
        right: NDArray[np.floating],
        off: NDArray[np.floating],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """What `read` gives for points (M, 3) at distances (M,) from the horizontal picture's plane, and at places
        (N, M) along and off the planes of N radial ones, of cores that end."""
        alone = np.stack([_seen(rise, THIN_ALONE), *_seen(off, ALONE)])
        u, v = Ball.of(points).level.T
        places = [(self.across, u, v, rise), *zip(self.along, right, [points[:, 2]] * len(right), off, strict=True)]
        colours, covered = np.zeros((len(rise), 3), np.float32), np.zeros(len(rise), np.float32)
        depth = np.full(len(rise), -np.inf, np.float32)
        for n, (source, x, y, away) in enumerate(places):
            shown, deep = source.core.read(source.disc, x, y, away)
            covers = _passed(deep) * np.delete(alone, n, 0).prod(0)
            deeper = _passed(deep - depth)  # where two meet, the one that a place is deeper in
            colours *= (1 - covers * deeper)[:, None]
            colours += (covers * (1 - covered * (1 - deeper)))[:, None] * shown
            covered += covers * (1 - covered)
            depth = np.maximum(depth, deep)
        return colours, covered

    def _whole(
        self,
        across: Core | Column,
        points: NDArray[np.float32],
        rise: NDArray[np.float32],
        right: NDArray[np.floating],
        off: NDArray[np.floating],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The same of a core in one piece: radial pictures show it in their own planes, the horizontal one between
        them."""
        x, y, z = points.T
        colours, covered = np.zeros((len(rise), 3), np.float32), np.zeros(len(rise), np.float32)
        left = np.ones(len(rise), np.float32)
        for source, at, away in zip(self.along, right, off, strict=True):
            crossing = np.square(rise) / (np.square(rise) + np.square(CROSSING * away) + 1e-12)
            own, covers = crossing * (1 - _seen(away, THIN_ALONE)), _passed(source.core.depth_at(at, z))
            shows = own * covers * (1 - covered)
            rows = np.flatnonzero(shows)
            colours[rows] += shows[rows, None] * source.disc.read(at[rows], z[rows])
            covered += shows
            left *= 1 - own * (1 - covers)
        stretch = np.float32(1 / np.sqrt(max(1 - self.height**2, 0.1)))  # as `Ball.level` at the picture's height
        shown, deep = across.read(self.across.disc, stretch * x, stretch * y, rise)
        for source, at, away in zip(self.along, right, off, strict=True):
            if source.core.shape.any():
                deep += (1 - _seen(away, EDGES)) * (source.core.depth_at(at, z) - deep)
        covers = _passed(deep) * left * (1 - covered)
        rows = np.flatnonzero(covers)
        for source, at, away in zip(self.along, right, off, strict=True):
            if isinstance(source.core, Column):
                shown[rows] += source.core.change(at[rows], away[rows], z[rows]) / len(self.along)
        return colours + covers[:, None] * shown, covered + covers


def find_cores(
    across: Sequence[Source], along: Sequence[Source], height: float
) -> tuple[list[Core | Column], list[Core | Column]]:
    """The cores of horizontal pictures, and of radial ones what they show of the first one's, which is at a height in
    the ball."""
    faces = [source.disc for source in along]
    rind = max((source.rind for source in along), default=0.0)
    cores = [find_core(source.disc, source.rind, faces, rind, height) for source in across]
    first = cores[0]
    if isinstance(first, Column):
        return cores, [first.along(source.bare.even, source.rind) for source in along]  # its seeds are laid apart
    return cores, [Core.along(face, first, height) for face in _evened_beside(faces, first.reach)]


def in_one_tone(source: Source, core: Core | Column, first: Source, its: Core | Column) -> Source:
    """A radial picture whose core, in one piece, has the usual colour of the first horizontal picture's: rings around
    the axis do not tell the light, and its plane was a dark line through a white hollow."""
    if not (isinstance(its, Column) or its.profile) or not core.shape.any():
        return source
    usual, own = (np.median(s.disc.rgb[c.shape], axis=0) for s, c in ((first, its), (source, core)))
    cover = _passed(core.depth_at(*(at.ravel() for at in disc_grid()))).reshape(core.shape.shape)[..., None]
    return replace(source, disc=Disc(np.clip(source.disc.rgb + cover * (usual - own), 0, 1).astype(np.float32)))


def find_core(disc: Disc, rind: float, along: Sequence[Disc], rind_along: float, height: float) -> Core | Column:
    """The core of a horizontal face with a rind of this depth in radii, at a height in the ball, as radial faces with
    rinds of another depth show it."""
    # Tones are made even as if there were no core, and a core that is not round is a part of them. So the picture is
    # looked at as it is, and only if light hides a core there, with even tones.
    shape = find_shape(disc, rind)
    if shape is None:
        shape = find_shape(evened(disc, True), rind)
    if shape is None:
        return Core.none()
    there = disc_radius() < disc_radius()[shape].max() + MARGIN
    again = find_shape(evened(disc, True, there), rind)
    shape = shape if again is None else again
    reach = float(disc_radius()[shape].max()) + MARGIN
    faces = _evened_beside(along, reach)
    seen = [shown for one in faces if (shown := seen_along(one, reach, height))]
    if sum(shown.is_column for shown in seen) > len(seen) / 2:
        return Column.across(disc, shape, faces, rind_along, height)
    profile = _profile(shape, faces if seen else [], reach, height)
    return Core.in_one_piece(shape, profile) if profile else Core.across(shape, seen)


def _evened_beside(along: Sequence[Disc], reach: float) -> list[Disc]:
    """Radial faces with even tones, which a core that reaches out to this radius does not affect."""
    there = np.abs(disc_grid()[0]) < reach
    return [evened(one, False, there) for one in along]


def _profile(shape: NDArray[np.bool_], along: Sequence[Disc], reach: float, height: float) -> Profile | None:
    """The profile of a core of this shape (P, P), which reaches out to this radius at this height: that of a ball
    without radial faces. None if its parts end each by themselves, or if no radial face shows it around the axis near
    that height."""
    (whole,) = regionprops(shape.astype(np.uint8))
    if whole.solidity < COMPACT:
        return None
    away = np.abs(disc_grid()[1][0] - height)
    ball = np.sqrt(np.maximum(shape.sum() * PIXEL**2 / np.pi - np.square(away), 0))
    wide = widths_along(along, reach, height) if along else ball
    if not wide[away < NEAR].any():
        return None
    return Profile.of(wide, height, MOST)


def show_core_that_ends(across: Sequence[Disc], along: Sequence[Disc], height: float) -> bool:
    """Whether the first horizontal face shows a core, at a height in the ball, that ends in radial ones: a quilt lays
    it as one solid."""
    disc = across[0]
    rind, rind_along = rind_of(disc, True)[0], max((rind_of(one, False)[0] for one in along), default=0.0)
    core = find_core(disc, rind, along, rind_along, height)
    if isinstance(core, Column) or not core.reach:
        return False
    return not any(made_of_grains(one, one is disc) for one in [disc, *along])


def show_chambers(across: Sequence[Disc]) -> bool:
    """Whether the first horizontal face shows parts around the axis, such as an apple's star. Each is closed: a quilt
    lays it as a solid, where layers would show a column of them."""
    disc = across[0]
    core = find_core(disc, rind_of(disc, True)[0], [], 0.0, 0.0)
    if isinstance(core, Column) or not core.shape.any():
        return False
    return bool(np.pi * depth_in(core.shape).max() ** 2 < ONE_BODY * core.shape.sum())


def _passed(depth: NDArray[np.floating]) -> NDArray[np.floating]:
    """Rises from 0 outside of a core's surface to 1 inside, by the depth in radii."""
    return np.clip(depth / BLEND + 0.5, 0, 1)


def _seen(away: NDArray[np.floating], alone: float) -> NDArray[np.floating]:
    """How much of a core is seen at these distances in radii from other pictures' planes."""
    return 1 - np.exp(-np.square(away / alone))
