"""What a chunk of a quilt shows: a photograph with what is known of it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.threads import side_by_side
from training.priors.exemplar.quilting.chunks import Ball, Chunks, Depths, Places
from training.priors.exemplar.quilting.disc import (
    RIND_RADIUS,
    Disc,
    disc_grid,
    disc_radius,
    evened,
    filled_in,
    read_map,
    ring_medians,
    smooth_disc,
)
from training.priors.exemplar.quilting.persistence import Persistence, even_along, find_membranes
from training.priors.exemplar.quilting.relief import BLEND, Relief
from training.priors.exemplar.quilting.rinds import Rinds, goes_inwards, rind_of
from training.priors.exemplar.quilting.texture import FINE, WIDTH, Parts, take_apart
from training.priors.exemplar.quilting.things.column import Column
from training.priors.exemplar.quilting.things.core import Core
from training.priors.exemplar.quilting.things.grains import Grains
from training.priors.exemplar.quilting.things.seeds import Seeds
from training.priors.exemplar.sampling import lengths
from training.priors.exemplar.strata import beside_own

__all__ = [
    "Label",
    "Source",
    "blended_tones",
    "depths_of",
    "distance_across",
    "grains_of",
    "made_of_grains",
    "read_discs",
    "read_maps",
]

FAINT_MEMBRANE = 0.05
"""Least surety of a membrane at which a place is not taken for texture: faint membranes would be scattered."""

EVEN = np.float32(0.04)
"""Distance in radii from their picture's plane at which membranes are even along themselves. A cut along one shows it
all over, and what its picture shows of it at one radius would be a ring there."""

BLUR = 0.02
"""Standard deviation in radii of the blur under which colours are looked for nearby: texture does not count."""

TONE = 0.05
"""Standard deviation in radii of the blur that leaves only tones: wider than seeds and texture."""

TONE_BLEND = 0.04
"""Standard deviation in radii over which the tones of two chunks blend at their seam."""

SLIGHT = 1 / 255
"""Share of a label at a cell up to which its tones do not count there: a step of 8 bits between black and white."""

OWN_WEIGHT = 4.0
"""Further weight of a picture's tones in its own plane."""

OWN_TONES = 0.1
"""Distance in radii over which a picture's own tones blend into even ones: away from its plane, and within it where
another picture's plane crosses, as both are seen there."""

RINGS, SPARSE, MIDDLE = 60, 6, 0.15
"""Rings of a horizontal picture whose tones are compared with a radial one, at every so many pixels of that, outside of
this radius."""

CLEARLY = 0.7
"""Largest distance of colours that a horizontal picture has at equal depths from what a radial one shows, over that of
those it has at equal shares of the radius, to go by depth. Thirteen of fourteen pairs of photographs have 0.77 to 1.10,
one of pomegranates 0.63; drawn melons, papayas, figs and geodes 0.20 to 0.43, a kiwi 1.29."""


@dataclass(frozen=True)
class Source:
    """A picture and what the law of shape (`persistence`) says about it."""

    disc: Disc
    even: Disc
    """The picture with even tones, for chunks away from its own plane."""
    parts: Parts
    """Parts of `even`."""
    relief: Relief
    """Relief of the things in `parts`."""
    blurred: Disc
    tones: Disc
    """Tones of `even` without closed things: those of what is left where they end."""
    persistence: Persistence
    membranes: NDArray[np.float32]
    """(P, P). How surely each place shows a membrane; 0 for radial pictures."""
    walls: Disc | None
    """The things with their usual colours along membranes (`even_along`), if there are any."""
    rind: float
    """Depth in radii of the layers along the rim."""
    grains: Grains
    seeds: Seeds
    core: Core | Column
    is_layered: bool
    """Whether layers along the skin go all the way in."""
    is_horizontal: bool

    @property
    def has_grains(self) -> bool:
        """Whether it is made of grains."""
        return len(self.grains.radii) > 0

    @cached_property
    def uneven(self) -> Disc:
        """What even tones lack of the picture's own."""
        return Disc(self.disc.rgb - self.even.rgb)

    @cached_property
    def bare(self) -> Source:
        """The same picture without its seeds or grains and its core, which are laid whole; for chunks away from its own
        plane."""
        laid = self.seeds.regions | self.grains.regions | self.core.region
        if not laid.any():
            return self

        def without(values: NDArray[np.float32]) -> NDArray[np.float32]:
            return filled_in(values, laid)

        even, things = Disc(without(self.even.rgb)), Disc(without(self.parts.things.rgb))
        relief = replace(self.relief, levels=np.stack([without(level) for level in self.relief.levels]))
        return replace(
            self,
            even=even,
            parts=replace(self.parts, things=things),
            relief=relief,
            blurred=smooth_disc(Disc(without(self.disc.rgb)), BLUR),
            grains=Grains.none(),
        )

    def around(self, places: NDArray[np.float32]) -> NDArray[np.float32]:
        """(B, 3). Colours of what seeds at places (B, 2) lie in."""
        around = self.bare.tones.read(*places.T)
        if isinstance(self.core, Core) and self.core.ground:
            within = self.seeds.within(self.core.shape)
            around[within] = self.core.ground.read(*places[within].T)
        return around

    def reduced(self, n: int) -> Source:
        """The same picture with pixels n times as large, in all that is shown of it."""
        parts = Parts(*(getattr(self.parts, part.name).reduced(n) for part in fields(Parts)))
        shown = {name: getattr(self, name).reduced(n) for name in ("disc", "even", "tones")}
        core = self.core.reduced(n) if isinstance(self.core, Core) else self.core  # a column's colours are smooth
        return replace(self, parts=parts, relief=self.relief.reduced(n), core=core, **shown)

    @classmethod
    def of(cls, disc: Disc, is_horizontal: bool, grains: Grains | None = None) -> Source:
        """What is known of a picture before its core is found; `with_core` takes it apart once all things are known,
        and finds its tones and walls unless it has grains.
        `grains`: those of the picture, if they were found already."""
        persistence = Persistence(disc)
        rind = rind_of(disc, is_horizontal)[0]
        even = evened(disc, is_horizontal)
        parts, relief = _apart(even, rind, FINE, None if grains is None else grains.regions)
        if grains is None:
            grains = Grains.of(parts.things, relief.heights)
            if len(grains.radii):
                parts, relief = _apart(even, rind, FINE, grains.regions)
        has_grains = len(grains.radii) > 0
        membranes = np.zeros(disc.rgb.shape[:2], np.float32)
        if is_horizontal:
            membranes = find_membranes(disc, walls=not has_grains)
        tones, walls = even, None
        if has_grains:
            tones = _tones_of(even, grains.regions | (relief.closed_until(rind) >= 0))
            walls = even_along(parts.things, membranes)
            relief = relief.closing(parts.things, parts.strength, grains.regions, grains.regions, BLEND / 2)
        return cls(
            disc,
            even,
            parts,
            relief,
            smooth_disc(disc, BLUR),
            tones,
            persistence,
            membranes,
            walls,
            rind,
            grains,
            Seeds.none() if has_grains else Seeds.of(relief, is_horizontal, rind),
            Core.none(),
            False,
            is_horizontal,
        )

    def with_core(self, core: Core | Column) -> Source:
        """The picture taken apart anew, with all of its things known: seeds, membranes and this core, if there is one.
        A core does not affect the tones. A picture of grains has no core, and stays as it is."""
        if len(self.grains.radii):
            return self
        has_core = bool(core.region.any())
        membranes, seeds, even = self.membranes, self.seeds, self.even
        if has_core:
            even = evened(self.disc, self.is_horizontal, core.region)
        if has_core and isinstance(core, Core):
            if self.is_horizontal:
                # Flesh around a core is stained. It shows in its plane as tones do, not in a thin layer.
                stain = filled_in(even.rgb - filled_in(even.rgb, core.region), core.shape)
                even = Disc(even.rgb - smooth_disc(Disc(stain), BLUR).rgb)
                membranes = _without_tips(membranes, core.shape)
            seeds = seeds.chosen(~seeds.within(core.region))  # those of a column are laid along it
            if core.profile:
                core, inner = self._taken_out(core)
                seeds = seeds.and_also(inner)
        things = seeds.regions | (membranes > FAINT_MEMBRANE) | core.shape
        parts, relief = _apart(even, self.rind, WIDTH, things)
        hidden = core.region | (relief.closed_until(self.rind) >= 0)
        if has_core and not (self.is_horizontal and isinstance(core, Column)):  # which goes on beside its picture
            relief = relief.closing(parts.things, parts.strength, core.region, hidden)
        tones = _tones_of(even, hidden)
        is_layered = goes_inwards(even, core.reach, self.rind)
        return replace(
            self,
            core=core,
            even=even,
            parts=parts,
            relief=relief,
            tones=tones,
            membranes=membranes,
            walls=even_along(parts.things, membranes),
            seeds=seeds,
            is_layered=is_layered,
        )

    def _taken_out(self, core: Core) -> tuple[Core, Seeds]:
        """A core in one piece without what lies in it, such as the hollow of a melon, and the seeds that do."""
        if core.has_layers(self.disc):
            return core, Seeds.none()
        relief = _apart(core.inner(self.disc), 0.0, FINE)[1]
        things = (relief.contrast() >= 1) & core.shape
        if not things.any():
            return core, Seeds.none()
        found = Seeds.of(relief, self.is_horizontal, 0.0, core=0.0)
        ground = Disc(filled_in(self.disc.rgb, things | ~core.shape))
        return replace(core, ground=ground), replace(found.chosen(found.within(core.shape)), regions=things)


def _tones_of(even: Disc, hidden: NDArray[np.bool_]) -> Disc:
    """The tones of a picture with even ones, of what is left where all that is hidden (P, P) ends."""
    return smooth_disc(Disc(filled_in(even.rgb, hidden)), TONE)


def _apart(even: Disc, rind: float, width: float, things: NDArray[np.bool_] | None = None) -> tuple[Parts, Relief]:
    """The parts of a picture with even tones and the relief of its things, as `take_apart` has these."""
    parts = take_apart(even, width, things)
    return parts, Relief.of(parts.things, parts.strength, rind)


def _without_tips(membranes: NDArray[np.float32], core: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(P, P). Membranes (P, P) of a face without what begins at the shape (P, P) of a core that ends, and does not
    reach the rind: the tip of a star's arm."""
    parts, _ = ndimage.label(membranes > FAINT_MEMBRANE)
    tips = np.setdiff1d(parts[core], np.append(parts[disc_radius() > RIND_RADIUS], 0))
    return np.where(np.isin(parts, tips), np.float32(0), membranes)


def grains_of(disc: Disc, is_horizontal: bool) -> Grains:
    """The grains of a picture, if it shows things that lie close together all over."""
    parts, relief = _apart(evened(disc, is_horizontal), rind_of(disc, is_horizontal)[0], FINE)
    return Grains.of(parts.things, relief.heights)


def made_of_grains(disc: Disc, is_horizontal: bool) -> bool:
    """Whether a picture shows things that lie close together all over."""
    return len(grains_of(disc, is_horizontal).radii) > 0


def depths_of(across: list[Source], along: list[Source], rinds: Rinds) -> Depths:
    """Where horizontal pictures show what lies at other heights than theirs: what radial ones show there tells."""
    if all(source.is_layered for source in [*across, *along]):
        return Depths.LAYERED
    if not across or not along:
        return Depths.SHARED
    x, y = (places[::SPARSE, ::SPARSE].ravel() for places in disc_grid())
    there = (np.hypot(x, y) < 1 - BLUR) & (np.hypot(x, y) > max(across[0].core.reach, MIDDLE) + BLUR)
    x, y = x[there], y[there]
    points = np.stack([np.abs(x), np.zeros_like(x), y], -1).astype(np.float32)
    shared, kept = (np.hypot(*Ball.of(points, rinds, depths).level.T) for depths in (Depths.SHARED, Depths.KEPT))
    differ = np.abs(kept - shared) > TONE
    if not differ.any():
        return Depths.SHARED
    rings = ring_medians(across[0].tones, RINGS)
    shown = np.mean([source.tones.read(x, y) for source in along], axis=0)

    def unlike(level: NDArray[np.floating]) -> float:
        at = [np.interp(level, (np.arange(RINGS) + 0.5) / RINGS, channel) for channel in rings.T]
        return float(np.square(np.stack(at, -1) - shown)[differ].sum())

    return Depths.KEPT if unlike(kept) < CLEARLY**2 * unlike(shared) else Depths.SHARED


@dataclass(frozen=True)
class Label:
    """A set of chunks and the pictures that it shows."""

    chunks: Chunks
    sources: list[Source]
    is_horizontal: bool
    is_own: bool

    def _read_relief(self, places: Places, film: float = 0.0) -> NDArray[np.float32]:
        """(M, 4). Colours and strength of texture that the places show. No distance counts in the rind and in
        membranes, which run through. Grains are shown as they are in their picture up to a distance `film` in radii
        from its own plane."""
        out = np.empty((len(places.x), 4), np.float32)
        for n, source in enumerate(self.sources):
            rows = places.of(n, self.sources)
            x, y, away, free = places.x[rows], places.y[rows], places.distance[rows], 1 - places.rind[rows]
            runs = read_map(source.membranes, x, y) if source.walls else np.zeros_like(x)
            distance = away * (free * (1 - runs))
            if source.has_grains:
                distance = np.where(distance < film, np.float32(0), distance)
            shown = source.relief.read(x, y, distance)
            if source.walls:
                even = free * runs * np.minimum(away / EVEN, 1)
                shown[:, :3] += even[:, None] * (source.walls.read(x, y) - shown[:, :3])
            out[rows] = shown
        return out

    def read_tones(self, places: Places, crossing: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, 3). The tones of what the places show."""
        return self.read_even_tones(places) + self.own_tones(places, crossing)

    def read_even_tones(self, places: Places) -> NDArray[np.float32]:
        """(M, 3). The same away from own planes, where tones are even."""
        return read_discs(places, [s.tones for s in self.sources])

    def read(self, places: Places, texture: NDArray[np.float32], layer: float, film: float) -> NDArray[np.float32]:
        """(M, 3). What the places show, in even tones, with texture (M, 3), or the picture's own within a `layer` of
        own planes, and with the picture's own grains within a `film`."""
        shown = self._read_relief(places, film)
        rgb, strength = shown[:, :3], shown[:, 3:4]
        if not self.is_own:
            return rgb + strength * texture
        own = read_discs(places, [s.parts.texture for s in self.sources])
        return rgb + strength * beside_own(texture, own, places.distance / layer)

    def read_even(self, places: Places) -> NDArray[np.float32]:
        """(M, 3). The things that the places show, in even tones."""
        return self._read_relief(places)[:, :3]

    def left(self, places: Places, shown: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M,). How much colour that does not persist from the pictures' planes to the places is still in what they
        show (M, 3) in even tones."""
        gone = np.empty(len(places.x), np.float32)
        for n, source in enumerate(self.sources):
            rows = places.of(n, self.sources)
            gone[rows] = source.persistence.gone(places.x[rows], places.y[rows], places.distance[rows])
        closed = shown - read_discs(places, [s.parts.things for s in self.sources])
        return np.maximum(gone - lengths(closed), 0)

    def depth_in_chambers(self, places: Places) -> NDArray[np.float32]:
        """(M,). How deep in chambers of grains the pictures show the places, in radii, below 0 outside of them;
        infinite in pictures that are not made of grains."""
        depth = np.full(len(places.x), np.inf, np.float32)
        for n, source in enumerate(self.sources):
            if source.has_grains:
                rows = places.of(n, self.sources)
                depth[rows] = read_map(source.grains.depth, places.x[rows], places.y[rows])
        return depth

    def own_tones(self, places: Places, crossing: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, 3), or (1, 3) where it is 0. What brings colours in even tones to the pictures' own tones near their own
        planes.

        `crossing` (M,): distances in radii from the other family's own planes.
        """
        if not self.is_own:
            return np.zeros((1, 3), np.float32)
        share = np.exp(-np.square(places.distance / OWN_TONES)) - np.exp(-np.square(crossing / OWN_TONES))
        return np.maximum(share, 0)[:, None] * read_discs(places, [s.uneven for s in self.sources])


def distance_across(labels: list[Label], label: Label, ball: Ball) -> NDArray[np.float32]:
    """(M,). Distance in radii from the own planes of the family that is not the label's; infinite without one."""
    for other in labels:
        if label.is_own and other.is_own and other.is_horizontal != label.is_horizontal:
            return other.chunks.distance(ball)
    return np.full(len(ball.points), np.inf, np.float32)


def blended_tones(
    labels: list[Label],
    ball: Ball,
    number: NDArray[np.int32],
    size: int,
    chosen: NDArray[np.int32],
) -> NDArray[np.float32]:
    """(X, Y, Z, 3). The tones of the labels (M,) that are chosen at cells of a grid, `size` of them across the ball,
    blended at seams: the lower of two bands of a multiresolution spline (Burt and Adelson 1983)."""
    inside = number >= 0
    blended = np.zeros((len(ball.points), 3), np.float32)
    weights = np.zeros((len(ball.points), 1), np.float32)

    def weigh(n: int) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
        label, here = labels[n], np.zeros(number.shape, np.float32)
        here[inside] = chosen == n
        weight = ndimage.gaussian_filter(here, TONE_BLEND * size / 2)[inside]
        rows = np.flatnonzero(weight > SLIGHT)
        near, weight = ball.at(rows), weight[rows, None]
        places = label.chunks.places(near)
        if label.is_own:
            weight *= 1 + OWN_WEIGHT * np.exp(-np.square(places.distance[:, None] / TONE_BLEND))
        return rows, weight, weight * label.read_tones(places, distance_across(labels, label, near))

    for rows, weight, toned in side_by_side(weigh, range(len(labels))):
        blended[rows] += toned
        weights[rows] += weight
    total = np.zeros((*number.shape, 3), np.float32)
    total[inside] = blended / np.maximum(weights, 1e-6)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return total[tuple(nearest)]


def read_discs(places: Places, discs: list[Disc]) -> NDArray[np.float32]:
    """(M, 3). What the places show of these discs, one for each source."""
    out = np.empty((len(places.x), 3), np.float32)
    for n, disc in enumerate(discs):
        rows = places.of(n, discs)
        out[rows] = disc.read(places.x[rows], places.y[rows])
    return out


def read_maps(places: Places, maps: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """(M,). What the places show of these maps (P, P), one for each source."""
    out = np.empty(len(places.x), np.float32)
    for n, values in enumerate(maps):
        rows = places.of(n, maps)
        out[rows] = read_map(values, places.x[rows], places.y[rows])
    return out
