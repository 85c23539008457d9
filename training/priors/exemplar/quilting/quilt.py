"""Quilts an inside from chunks of photographs of different individuals (graph-cut textures, Kwatra et al. 2003, in 3D).

Every cell of a grid in the unit ball has a label: a set of chunks whose picture it shows. The labels minimise the sum
of what a label costs at a cell (its distance from the plane that the picture shows, what does not persist so far from
it, colours that the radial pictures do not show there) and of seams, which are free where both sides agree. Colours
are read, never averaged, so an inside is as sharp as its pictures; only tones blend at seams. Chunks hold the things of
pictures as solids (`relief`); their texture comes from thin layers (`texture`).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.threads import side_by_side
from training.priors.exemplar.quilting.choice import Question, weigh_labels
from training.priors.exemplar.quilting.chunks import (
    OWN_AZIMUTHS,
    SECTOR_SETS,
    SLABS,
    Ball,
    Depths,
    OwnAzimuths,
    OwnHeight,
    Sectors,
    Slabs,
)
from training.priors.exemplar.quilting.disc import ALIKE, PIXEL, Disc, match_light
from training.priors.exemplar.quilting.films import Beside, half_film
from training.priors.exemplar.quilting.labels import Label, Source, blended_tones, depths_of, distance_across, grains_of
from training.priors.exemplar.quilting.relief import BLEND
from training.priors.exemplar.quilting.rinds import Rinds
from training.priors.exemplar.quilting.seams import improve_labels, two_nearest
from training.priors.exemplar.quilting.texture import TextureField
from training.priors.exemplar.quilting.things.candidates import CANDIDATES, Candidates, Placed, in_own_planes, strewn
from training.priors.exemplar.quilting.things.chambers import Chambers, room_beside
from training.priors.exemplar.quilting.things.column import Column
from training.priors.exemplar.quilting.things.core import Core
from training.priors.exemplar.quilting.things.cores import Cores, find_cores, in_one_tone
from training.priors.exemplar.quilting.things.packing import CLEAR, Packing, pack
from training.priors.exemplar.quilting.things.tessellation import TIMES, Tessellation, off_plane
from training.priors.exemplar.sampling import lengths, read_trilinear, smoothstep
from training.priors.prior import Progress

__all__ = ["BLOCK", "Quilt", "make_quilt", "restore_quilt"]

log = logging.getLogger(__name__)

LEVELS = (32, 64, 96)
"""Cells across the ball, coarse to fine: seams find their way around things at the first and along their edges at the
last. Colours do not depend on them, as they are read at every point."""

STEPS = 5
"""Sweeps at each level; later ones change less than a cell in a thousand."""

MARGIN = 3
"""Cells around the ball."""

OWN_ALONE, OWN_REACH = 0.015, 0.04
"""Distance in radii from a picture's own plane over which its tones cease to be the only ones, so that no step of tones
shows there; and from where nothing of that is left."""

SEAM_COST = 0.0075
"""Weight of a seam over the width of a cell in radii."""

SEAM_WIDTH = 0.6
"""Difference of two labels' trilinear weights within which they blend: two thirds of a cell, under a hundredth of a
radius. Without it a seam shows as a crack as soon as a cell is many pixels wide."""

HEIGHTS, ANYWHERE = 0.1, 0.05
"""Standard deviation in radii of the heights of a horizontal picture's seeds around those of radial ones, which lie
some 0.08 apart in a row; and how likely, relative to that, they are anywhere else."""

UNLIKE = 0.3
"""Largest RGB distance between a seed's new surroundings and those in its picture: texture is within it, a rind is
not."""

BLOCK = 50_000
"""Points that are read at once: their arrays stay in the cache, which takes a third off the time for 400,000."""


@dataclass(frozen=True)
class Quilt:
    """The inside as a function on the unit ball."""

    rinds: Rinds
    depths: Depths
    labels: list[Label]
    number: NDArray[np.int32]
    """(X, Y, Z). Row of each cell of the finest grid, -1 outside."""
    chosen: NDArray[np.int32]
    """(M,). Label of each cell."""
    textures: dict[bool, TextureField]
    """Texture of horizontal pictures (True) and of radial ones (False), as far as there are any."""
    tones: NDArray[np.float32]
    """(X, Y, Z, 3). Tones at the cells, without steps at seams."""
    seeds: Packing | None
    """The pictures' seeds as solids, if they have any."""
    grains: Tessellation | None
    """Their grains, if they have any."""

    def read(self, points: NDArray[np.float32], film: float = PIXEL) -> NDArray[np.float32]:
        """(M, 3). Colours at points (M, 3) of the unit ball along e1, e2, up. Range [0, 1].

        `film`: thickness in radii of own planes where they show what is not beside them.
        """
        blocks = [points[start : start + BLOCK] for start in range(0, len(points), BLOCK)]
        found = side_by_side(lambda block: self.read_evened(self.rinds.evened(block), film), blocks)
        return np.concatenate([np.empty((0, 3), np.float32), *found])

    def nearest(self, points: NDArray[np.float32], film: float) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """(M, 2) and (M,). The two labels nearest to points (M, 3), and how far the first one leads, 0 to 1."""
        return self._nearest(points, Beside.of(self.labels, points), film)

    def _nearest(
        self, points: NDArray[np.float32], beside: Beside, film: float
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """(M, 2) and (M,). As `nearest`, for points (M, 3) that lie so beside own planes."""
        cell = 2 / self.size
        at = _in_cells(beside.beyond_films(points, film, cell), self.size)
        best, shares = two_nearest(self.chosen, self.number, at, len(self.labels))
        apart = shares[:, 0] - shares[:, 1]
        beside.share_crossing(best, apart, cell)
        return best, apart

    def read_evened(self, points: NDArray[np.float32], film: float = PIXEL) -> NDArray[np.float32]:
        """(M, 3). Colours at points (M, 3) of the quilt, whose rind is as thick as in all pictures (`Rinds.evened`)."""
        beside = Beside.of(self.labels, points)
        best, apart = self._nearest(points, beside, film)
        weight = 0.5 + 0.5 * smoothstep(apart / SEAM_WIDTH)
        tones = self._tones(points, beside)
        second = np.flatnonzero(weight < 1)
        both = np.concatenate([best[:, 0], best[second, 1]])
        rows = np.concatenate([np.arange(len(points)), second])
        order = np.argsort(both.astype(np.uint8), kind="stable")
        shown = np.empty((len(rows), 3), np.float32)
        ends = np.cumsum(np.bincount(both, minlength=len(self.labels)))
        for label, of_it in zip(self.labels, np.split(order, ends[:-1]), strict=True):
            if len(of_it):
                shown[of_it] = self._shown(label, points[rows[of_it]], tones[rows[of_it]], film)
        rgb = weight[:, None] * shown[: len(points)]
        rgb[second] += (1 - weight[second, None]) * shown[len(points) :]
        for things, cover in self.solids(points, beside, film):
            rgb += things - cover[:, None] * rgb
        return np.clip(rgb, 0, 1)

    def solids(
        self, points: NDArray[np.float32], beside: Beside, film: float
    ) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """(M, 3) and (M,) for cores, seeds and grains, as far as there are any: their colours at points (M, 3) that lie
        so beside own planes, multiplied by how much they cover, and that cover. Range [0, 1]."""
        for solids in (self.cores, self.seeds):
            if solids is not None:
                yield solids.read(points)
        if self.grains is not None:  # where its picture is shown, so are its grains
            off = np.abs(beside.far).min(0) - self.ends(film)
            room = room_beside(self.labels, points, beside, self.ball)
            yield self.grains.read(points, np.clip(off / BLEND, 0, 1).astype(np.float32), room)

    def ends(self, film: float) -> float:
        """Radii. Distance from an own plane at which a `film` ends."""
        return half_film(film, 2 / self.size)

    def _shown(
        self, label: Label, points: NDArray[np.float32], tones: NDArray[np.float32], film: float
    ) -> NDArray[np.float32]:
        """(M, 3). What a label shows at points (M, 3), in the tones (M, 3) of its neighbourhood."""
        ball = self.ball(points)
        places, field = label.chunks.places(ball), self.textures[label.is_horizontal]
        own = label.own_tones(places, distance_across(self.labels, label, ball))
        rgb = own + label.read(places, field.at(ball), field.thickness, self.ends(film) + float(BLEND))
        moved = tones - own - label.read_even_tones(places)
        # Flatter than a Gaussian: of a small difference nothing may be left at the edge of a thin film.
        moved *= np.exp(-np.square(np.square(moved).sum(-1, keepdims=True) / (2 * ALIKE**2)))
        return rgb + moved

    def _tones(self, points: NDArray[np.float32], beside: Beside) -> NDArray[np.float32]:
        """(M, 3). The tones around points (M, 3) that lie so beside own planes."""
        tones = read_trilinear(self.tones, _in_cells(points, self.size))
        for number, far in zip(beside.numbers, beside.far, strict=True):
            label, rows = self.labels[number], np.flatnonzero(np.abs(far) < OWN_REACH)
            ball = self.ball(points[rows])
            there = label.read_tones(label.chunks.places(ball), distance_across(self.labels, label, ball))
            alone = np.exp(-np.square(far[rows] / OWN_ALONE))[:, None]
            tones[rows] += alone * (there - tones[rows])
        return tones

    @property
    def size(self) -> int:
        """Cells of the finest grid across the ball."""
        return len(self.number) - 2 * MARGIN

    def ball(self, points: NDArray[np.float32]) -> Ball:
        """Points (M, 3) of the quilt with what its chunks need of them."""
        return Ball.of(points, self.rinds, self.depths)

    @cached_property
    def cores(self) -> Cores | None:
        """The pictures' cores as solids, if they have any."""
        return Cores.of(self.labels)

    def reduced(self, n: int) -> Quilt:
        """The same inside from pictures with pixels n times as large."""
        coarse = {id(s): s.reduced(n) for label in self.labels for s in label.sources}
        labels = [replace(label, sources=[coarse[id(s)] for s in label.sources]) for label in self.labels]
        textures = {k: t.reduced(n) for k, t in self.textures.items()}
        seeds = self.seeds and self.seeds.reduced(n)
        grains = self.grains and self.grains.reduced(n)
        return replace(self, labels=labels, textures=textures, seeds=seeds, grains=grains)


def make_quilt(
    horizontal: Sequence[Disc], radial: Sequence[Disc], seed: int, progress: Progress, height: float = 0.0
) -> Quilt:
    """The quilt of horizontal and radial pictures, at least one in all; the first horizontal one at a height in the
    unit ball. Bit-equal for a seed."""
    rinds, across, along = _make_sources(horizontal, radial, height)
    labels = _make_labels(across, along, height, seed)
    depths = depths_of(across, along, rinds)
    chosen = number = None
    for step, size in enumerate(LEVELS):
        progress(step / len(LEVELS))
        coarse, before = number, chosen
        number, cells, points = _grid(size)
        ball = Ball.of(points, rinds, depths)
        if coarse is None or before is None:
            at_cells = weigh_labels(labels, along, ball, 2 / size, seed)
            chosen = at_cells.costs.argmin(1).astype(np.int32)
        else:
            nearest, _ = two_nearest(before, coarse, _in_cells(points, LEVELS[step - 1]), len(labels))
            chosen = nearest[:, 0].copy()
            question = Question.near(chosen, number, cells, len(labels))
            at_cells = weigh_labels(labels, along, ball, 2 / size, seed, question)
        improve_labels(chosen, number, cells, at_cells.colours, at_cells.costs, SEAM_COST * size, STEPS)
    assert number is not None and chosen is not None
    shares = np.bincount(chosen, minlength=len(labels)) / len(chosen)
    log.info("quilted of %d sets of chunks, shares %s", len(labels), np.round(shares, 2).tolist())
    return _assembled(rinds, depths, labels, across, along, seed, number, chosen, ball)


def restore_quilt(
    horizontal: Sequence[Disc], radial: Sequence[Disc], seed: int, height: float, chosen: NDArray[np.int32]
) -> Quilt:
    """The quilt that `make_quilt` found, from its `chosen` (M,) and what that was given. Raises ValueError if `chosen`
    is not a label for each cell."""
    number, _, points = _grid(LEVELS[-1])
    if chosen.shape != (len(points),):
        raise ValueError("no label for each cell")
    rinds, across, along = _make_sources(horizontal, radial, height)
    labels = _make_labels(across, along, height, seed)
    if not 0 <= chosen.min() <= chosen.max() < len(labels):
        raise ValueError("a label that no picture has")
    depths = depths_of(across, along, rinds)
    ball = Ball.of(points, rinds, depths)
    return _assembled(rinds, depths, labels, across, along, seed, number, chosen, ball)


def _make_sources(
    horizontal: Sequence[Disc], radial: Sequence[Disc], height: float
) -> tuple[Rinds, list[Source], list[Source]]:
    """The rinds, and what is known of the horizontal and radial pictures, in the light of the first and with a common
    rind."""
    first = [*horizontal, *radial][0]
    rinds = Rinds.of(horizontal, radial, height, OWN_AZIMUTHS)
    each = [(disc, depths, True) for disc, depths in zip(horizontal, rinds.across, strict=True)]
    each += [(disc, depths, False) for disc, depths in zip(radial, rinds.along, strict=True)]

    def known(one: tuple[Disc, NDArray[np.float64], bool]) -> Source:
        disc, depths, is_horizontal = one
        lit = disc if disc is first else match_light(disc, first)
        return Source.of(rinds.even(lit, depths, is_horizontal), is_horizontal)

    sources = side_by_side(known, each)
    if all(source.has_grains for source in sources):

        def relit(one: tuple[Source, tuple[Disc, NDArray[np.float64], bool]]) -> Source:
            """In the light of the first, grains like grains; what they are is seen in the picture's own light."""
            source, (disc, depths, is_horizontal) = one
            if disc is first:
                return source
            own = rinds.even(disc, depths, is_horizontal)
            grains = grains_of(own, is_horizontal)
            if not grains.regions.any():
                return source
            chambers = grains.regions, sources[0].grains.regions
            return Source.of(match_light(own, sources[0].disc, chambers), is_horizontal, grains)

        sources = side_by_side(relit, list(zip(sources, each, strict=True)))
    across, along = sources[: len(horizontal)], sources[len(horizontal) :]
    return rinds, *_with_cores(across, along, height)


def _with_cores(across: list[Source], along: list[Source], height: float) -> tuple[list[Source], list[Source]]:
    """Horizontal and radial pictures with their cores: the radial ones with what they show of the first horizontal
    one's."""
    cores: list[Core | Column] = [Core.none()] * (len(across) + len(along))
    if across and not any(len(source.grains.radii) for source in [*across, *along]):
        of_across, of_along = find_cores(across, along, height)
        cores = [*of_across, *of_along]
        along = [in_one_tone(s, core, across[0], of_across[0]) for s, core in zip(along, of_along, strict=True)]
    both = list(zip([*across, *along], cores, strict=True))
    known = side_by_side(lambda one: one[0].with_core(one[1]), both)
    return known[: len(across)], known[len(across) :]


def _assembled(
    rinds: Rinds,
    depths: Depths,
    labels: list[Label],
    across: list[Source],
    along: list[Source],
    seed: int,
    number: NDArray[np.int32],
    chosen: NDArray[np.int32],
    ball: Ball,
) -> Quilt:
    """The quilt of labels that are `chosen` (M,) at the cells, which have these places in the ball."""
    textures = {
        h: TextureField([source.parts.texture for source in sources], h, np.random.default_rng([seed, 5, int(h)]))
        for h, sources in ((True, across), (False, along))
        if sources
    }
    tones = blended_tones(labels, ball, number, LEVELS[-1], chosen)
    ground = Quilt(rinds, depths, labels, number, chosen, textures, tones, None, None)
    planes = [label for label in labels if label.is_own]
    seeds = _packed(ground, planes, across, along, seed)
    return replace(ground, seeds=seeds, grains=_tessellated(ground, planes, across, along, seed))


def _packed(ground: Quilt, planes: list[Label], across: list[Source], along: list[Source], seed: int) -> Packing | None:
    """The pictures' seeds as solids in the quilt. In own planes, these are the pictures' own seeds where they show
    them; elsewhere, they lie where their surroundings are like those in their picture, at the heights of the seeds of
    radial pictures."""
    things = [source.seeds.things(source.even) for source in [*across, *along]]
    own = [source.seeds.things(source.disc) for source in _own(across, along)]  # in their own light
    if not any(len(some.places) for some in things):
        return None
    rng = np.random.default_rng([seed, 6])
    both = zip([*across, *along], things, strict=True)
    around_them = np.concatenate([source.around(some.places) for source, some in both])
    in_core = np.concatenate([source.seeds.within(source.core.shape) for source in [*across, *along]])
    first_radial = sum(len(some.places) for some in things[: len(across)])

    def is_free(tried: Candidates) -> NDArray[np.bool_]:
        """A horizontal picture does not tell the heights of its seeds; the seeds of radial ones do."""
        free = _is_clear(tried, planes, CLEAR)
        likely = np.ones(len(tried.stamps))
        known = np.concatenate([np.empty(0), *(source.seeds.places[:, 1] for source in along)])
        if len(known):
            rows = tried.stamps < first_radial
            off = np.abs(tried.middles[rows, 2:] - known).min(1)
            likely[rows] = np.maximum(np.exp(-np.square(off / HEIGHTS) / 2), ANYWHERE)
        unlike = np.linalg.norm(ground.read_evened(tried.middles) - around_them[tried.stamps], axis=1)
        if ground.cores is not None and in_core.any():
            free &= (ground.cores.read(tried.middles)[1] > 0.5) == in_core[tried.stamps]
        return free & (rng.uniform(size=len(likely)) < likely) & (unlike < UNLIKE)

    placed = in_own_planes(own, _heights(planes), len(around_them))
    tried = strewn(things, len(across), CANDIDATES, rng, in_rows=True)
    return pack([*things, *own], _clear_of_others(placed, planes, CLEAR), tried, is_free, rng)


def _tessellated(
    ground: Quilt, planes: list[Label], across: list[Source], along: list[Source], seed: int
) -> Tessellation | None:
    """The pictures' grains as solids in the quilt: in own planes those that they show there, in their own light;
    elsewhere, as many as fit into the chambers."""
    if not any(source.has_grains for source in [*across, *along]):
        return None
    rng = np.random.default_rng([seed, 7])
    things = [source.grains.usual_things(source.even) for source in [*across, *along]]
    own = [source.grains.things(source.disc) for source in _own(across, along)]
    placed = in_own_planes(own, _heights(planes), sum(len(some.places) for some in things))
    placed = [some._replace(laid=off_plane(some, rng)) for some in placed]
    chambers = Chambers.of(across, along, (_heights(planes) or [0.0])[0], ground.ball, rng)
    tried = strewn(things, len(across), TIMES, rng, in_rows=False)
    tried = tried.chosen(_is_clear(tried, planes, 1.0))

    def beside(points: NDArray[np.float32]) -> NDArray[np.float32]:
        return room_beside(ground.labels, points, Beside.of(ground.labels, points), ground.ball)

    return Tessellation.of([*things, *own], [some.laid for some in placed], tried, chambers, beside, rng)


def _own(across: list[Source], along: list[Source]) -> list[Source]:
    """The pictures that have planes of their own."""
    return [*across[:1], *along[:OWN_AZIMUTHS]]


def _heights(planes: list[Label]) -> list[float]:
    """The height of the plane across the axis, if there is one."""
    return [float(label.chunks.height) for label in planes if isinstance(label.chunks, OwnHeight)]


def _clear_of_others(placed: list[Placed], planes: list[Label], reach: float) -> list[Candidates]:
    """The things in own planes that do not reach those of the other family, at `reach` half axes."""
    others = [[plane for plane in planes if plane.is_horizontal != some.is_horizontal] for some in placed]
    return [some.laid.chosen(_is_clear(some.laid, o, reach)) for some, o in zip(placed, others, strict=True)]


def _is_clear(laid: Candidates, planes: list[Label], reach: float) -> NDArray[np.bool_]:
    """(M,). Which things do not reach the planes, at `reach` half axes."""
    there, clear = Ball.of(laid.middles), np.ones(len(laid.stamps), bool)
    for plane in planes:
        clear &= plane.chunks.distance(there) > reach * laid.axes[:, 0]
    return clear


def _in_cells(points: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """(M, 3). Points (M, 3) of the ball on a grid of `size` cells across it, cell centres at whole numbers."""
    return ((points + 1) * np.float32(size / 2) + np.float32(MARGIN - 0.5)).astype(np.float32)


def _make_labels(across: list[Source], along: list[Source], height: float, seed: int) -> list[Label]:
    """The labels, own planes first, then random chunks."""
    labels = []
    if across:
        own = OwnHeight(height, across[0].membranes, np.random.default_rng([seed, 3]))
        labels.append(Label(own, across, True, True))
    if along:
        labels.append(Label(OwnAzimuths(len(along), np.random.default_rng([seed, 4])), along, False, True))
    if across:
        slabs = [Slabs(k, len(across), np.random.default_rng([seed, 0, k])) for k in range(SLABS)]
        labels += [Label(s, [source.bare for source in across], True, False) for s in slabs]
    if along:
        sectors = [Sectors(k, len(along), np.random.default_rng([seed, 1, k])) for k in range(SECTOR_SETS)]
        labels += [Label(s, [source.bare for source in along], False, False) for s in sectors]
    return labels


def _grid(size: int) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Rows of the cells (X, Y, Z), the cells (M, 3) in and just around the ball, and their points (M, 3)."""
    axis = ((np.arange(size + 2 * MARGIN) + 0.5 - MARGIN) * 2 / size - 1).astype(np.float32)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    inside = lengths(grid) < 1 + 4.4 / size
    number = np.full(inside.shape, -1, np.int32)
    number[inside] = np.arange(inside.sum(), dtype=np.int32)
    return number, np.argwhere(inside).astype(np.int32), grid[inside]
