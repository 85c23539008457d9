"""Quilts an inside of chunks of photographs of different individuals (graph-cut textures, Kwatra et al. 2003, in 3D).

Every cell of a grid in the unit ball has a label: a set of chunks whose picture it shows. The labels minimise the sum
of what a label costs at a cell (its distance from the plane that the picture shows, what does not persist so far from
it, colours that the radial pictures do not show there) and of seams, which are free where both sides agree. Colours
are read, never averaged, so an inside is as sharp as its pictures. Chunks hold the things of pictures; their texture
is that of thin layers (`texture`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.priors.exemplar.quilting.chunks import (
    SECTOR_SETS,
    SLABS,
    Ball,
    Chunks,
    OwnAzimuths,
    OwnHeight,
    Places,
    Sectors,
    Slabs,
    smooth_noise,
)
from training.priors.exemplar.quilting.disc import (
    REACH,
    Disc,
    disc_grid,
    even_around,
    even_sides,
    match_light,
    ring_medians,
    smooth_disc,
    to_pixels,
)
from training.priors.exemplar.quilting.persistence import Persistence, find_sheets
from training.priors.exemplar.quilting.seams import improve_labels, majority, nearest_colour
from training.priors.exemplar.quilting.texture import Parts, TextureField, take_apart
from training.priors.prior import Progress

__all__ = ["Quilt", "make_quilt"]

log = logging.getLogger(__name__)

LEVELS = (32, 64, 96)
"""Cells across the ball, coarse to fine: seams find their way around things at the first and along their edges at the
last. Colours do not depend on it, they are read at every point."""

STEPS = 5
"""Sweeps at each level; later ones change less than a cell in a thousand."""

MARGIN = 3
"""Cells around the ball."""

DISTANCE_COST = 5.0
"""Cost of a radius of distance from a picture's plane. All costs are weighed against seams between colours that differ
by one unit of RGB: a chunk that is a tenth of a radius nearer is worth a seam of difference 0.1."""

FAR = 0.15
"""Distance in radii from which that cost does not grow for pictures in their own plane and for sectors."""

GONE_COST = 4.0
"""Cost of a unit of colour that does not persist (law 3)."""

FIRST_GAIN, GAIN_STEP, MOST_GAIN = 2.0, 1.5, 12.0
"""Gain of a unit of colour by which a closed thing stands out: at first, by what factor a sweep changes it at most so
that there is as much as the pictures show, and at most. Without it there is too little: a closed thing costs the seams
of its ends, and flesh none."""

FINE_RINGS, LARGEST = 64, 0.16
"""Rings from whose median colours things stand out, and their largest half width in radii."""

UNSEEN_COST = 20.0
"""Cost of the squared distance, to at most UNSEEN_MOST, to the nearest colour that radial pictures show nearby."""

UNSEEN_MOST = 0.1

NEARBY = 0.035
"""Step in radii of the 5x5 points that count as nearby: two fruits have their seeds a tenth of a radius apart."""

BLUR = 0.02
"""Standard deviation in radii of the blur under which colours are looked for nearby: texture is none of them."""

SHEET_COST = 6.0
"""Cost of cutting off a sheet or of growing one where none starts: more than any seam."""

RIND_COST = 1.0
"""Cost of random chunks in the rind, where own pictures continue one another."""

SECTOR_COST = 0.3
"""Cost of radial pictures where horizontal ones are as good: repeated around the axis they show as rings."""

OWN_COST, OWN_BAND = 3.0, 0.03
"""Gain of a picture near its own plane, and how near in radii, up to a smooth random factor: no band has an edge."""

OWN_PLANE = 100.0
"""Gain in the cells at the plane itself: it shows the picture (law 1)."""

OWN_TONES = 0.1
"""Distance in radii over which a picture's own tones pass into even ones: away from its plane, and in it where another
picture's plane crosses, as there both are to be seen."""

SEAM_COST = 0.0075
"""Weight of a seam over the width of a cell in radii."""

BLOCK = 400_000
"""Points that are read at once."""


@dataclass(frozen=True)
class _Source:
    """A picture and what the law of shape says of it."""

    disc: Disc
    even: Disc
    """With even tones, for chunks away from the picture's own plane."""
    parts: Parts
    """Of the even one."""
    closed: Disc
    """How far closed things stand out, the same in all three channels."""
    blurred: Disc
    persistence: Persistence
    sheets: Disc
    """The same surety in all three channels; 0 for radial pictures."""


@dataclass(frozen=True)
class _Label:
    chunks: Chunks
    sources: list[_Source]
    is_horizontal: bool
    is_own: bool

    def read_things(self, places: Places, crossing: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, 3). The things that the places show, in the pictures' own tones near their own planes.

        `crossing` (M,): distances in radii from the other family's own planes.
        """
        things = _read(places, [s.parts.things for s in self.sources])
        if not self.is_own:
            return things
        share = np.exp(-np.square(places.distance / OWN_TONES)) - np.exp(-np.square(crossing / OWN_TONES))
        tones = _read(places, [s.disc for s in self.sources]) - _read(places, [s.even for s in self.sources])
        return things + np.maximum(share, 0)[:, None] * tones

    def read(
        self, places: Places, crossing: NDArray[np.float32], texture: NDArray[np.float32], layer: float
    ) -> NDArray[np.float32]:
        """(M, 3). What the places show, with texture (M, 3): within a `layer` of own planes that of the picture."""
        rgb = self.read_things(places, crossing)
        strength = _read(places, [s.parts.strength for s in self.sources])
        if not self.is_own:
            return rgb + strength * texture
        own = np.exp(-np.square(places.distance / layer))[:, None]
        here = _read(places, [s.parts.texture for s in self.sources])
        return rgb + strength * (own * here + np.sqrt(1 - own * own) * texture)


@dataclass(frozen=True)
class Quilt:
    """The inside as a function on the unit ball."""

    labels: list[_Label]
    number: NDArray[np.int32]
    """(X, Y, Z). Row of each cell of the finest grid, -1 outside."""
    chosen: NDArray[np.int32]
    """(M,). Label of each cell."""
    texture: TextureField

    def read(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, 3). Colours at points (M, 3) of the unit ball along e1, e2, up. Range [0, 1]."""
        out = np.empty((len(points), 3), np.float32)
        for start in range(0, len(points), BLOCK):
            block = points[start : start + BLOCK]
            nearest = np.empty(len(block), np.int32)
            at = ((block + 1) * np.float32(LEVELS[-1] / 2) + np.float32(MARGIN - 0.5)).astype(np.float32)
            majority(self.chosen, self.number, at, len(self.labels), nearest)
            for n, label in enumerate(self.labels):
                rows = np.flatnonzero(nearest == n)
                ball = Ball.of(block[rows])
                places, crossing = label.chunks.places(ball), _crossing(self.labels, label, ball)
                out[start + rows] = label.read(places, crossing, self.texture.at(ball), self.texture.thickness)
        return np.clip(out, 0, 1)


def make_quilt(
    horizontal: Sequence[Disc], radial: Sequence[Disc], seed: int, progress: Progress, height: float = 0.0
) -> Quilt:
    """The quilt of horizontal and radial pictures, each 0 or more and one at least together; the first horizontal one
    at a height in the unit ball. Bit-equal for a seed."""
    first = [*horizontal, *radial][0]
    across, along = (
        [_source(disc if disc is first else match_light(disc, first), family is horizontal) for disc in family]
        for family in (horizontal, radial)
    )
    labels = _make_labels(across, along, height, seed)
    wanted = _closed_share(along or across, not along)
    gain = FIRST_GAIN
    chosen = number = None
    for step, size in enumerate(LEVELS):
        progress(step / len(LEVELS))
        coarse, before = number, chosen
        number, cells, points = _grid(size)
        ball = Ball.of(points)
        at_cells = _costs(labels, along, ball, 2 / size, seed)
        if coarse is None or before is None:
            chosen = at_cells.costs.argmin(1).astype(np.int32)
        else:
            chosen = np.empty(len(points), np.int32)
            at = ((points + 1) * np.float32(LEVELS[step - 1] / 2) + np.float32(MARGIN - 0.5)).astype(np.float32)
            majority(before, coarse, at, len(labels), chosen)
        for _ in range(STEPS):
            shown = float(np.take_along_axis(at_cells.closed, chosen[:, None], 1).mean())
            gain = min(gain * float(np.clip(wanted / max(shown, 1e-6), 1 / GAIN_STEP, GAIN_STEP)), MOST_GAIN)
            costs = at_cells.costs - gain * at_cells.gains
            for parity in range(8):
                improve_labels(chosen, number, cells, at_cells.colours, costs, SEAM_COST * size, parity)
    assert number is not None and chosen is not None
    shares = np.bincount(chosen, minlength=len(labels)) / len(chosen)
    log.info("quilted of %d sets of chunks, shares %s", len(labels), np.round(shares, 2).tolist())
    log.info("closed things %.4f of %.4f, gain %.2f", shown, wanted, gain)
    texture = TextureField([s.parts.texture for s in across or along], np.random.default_rng([seed, 5]))
    return Quilt(labels, number, chosen, texture)


def _source(disc: Disc, is_horizontal: bool) -> _Source:
    persistence = Persistence(disc)
    sheets = find_sheets(disc, persistence) if is_horizontal else np.zeros(disc.rgb.shape[:2], np.float32)
    even = even_around(disc) if is_horizontal else even_sides(disc)
    held = Disc(np.repeat(sheets[..., None], 3, -1))
    closed = _closed_things(even, persistence)
    return _Source(disc, even, take_apart(even), closed, smooth_disc(disc, BLUR), persistence, held)


def _closed_things(disc: Disc, persistence: Persistence) -> Disc:
    """How far the colours of closed things are from those of their ring and of what is around them."""
    x, y = disc_grid()
    medians = ring_medians(disc, FINE_RINGS)
    at = np.hypot(x, y) * FINE_RINGS - 0.5
    ring = np.stack([np.interp(at, np.arange(FINE_RINGS), medians[:, c]) for c in range(3)], -1)
    around = persistence.gone(x.ravel(), y.ravel(), np.full(x.size, LARGEST)).reshape(x.shape)
    stands_out = np.minimum(np.linalg.norm(disc.rgb - ring, axis=-1), around)
    return Disc(np.repeat(stands_out[..., None], 3, -1).astype(np.float32))


def _closed_share(sources: list[_Source], is_horizontal: bool) -> float:
    """Mean of how far closed things stand out, under the rind, over the ball as radial pictures show it or over a
    horizontal cut."""
    x, y = disc_grid()
    radius = np.hypot(x, y)
    level = np.stack([x, np.zeros_like(x), y], -1).reshape(-1, 3)
    rind = Ball.of(level.astype(np.float32)).rind.reshape(x.shape)
    weight = np.where(radius < 1, 1.0 if is_horizontal else np.abs(x), 0)
    return float(np.mean([((1 - rind) * s.closed.rgb[..., 0] * weight).sum() / weight.sum() for s in sources]))


def _make_labels(across: list[_Source], along: list[_Source], height: float, seed: int) -> list[_Label]:
    """Own planes first, then random chunks."""
    labels = []
    if across:
        own = OwnHeight(height, across[0].sheets, np.random.default_rng([seed, 3]))
        labels.append(_Label(own, across, True, True))
    if along:
        labels.append(_Label(OwnAzimuths(len(along), np.random.default_rng([seed, 4])), along, False, True))
    if across:
        slabs = [Slabs(k, len(across), np.random.default_rng([seed, 0, k])) for k in range(SLABS)]
        labels += [_Label(s, across, True, False) for s in slabs]
    if along:
        sectors = [Sectors(k, len(along), np.random.default_rng([seed, 1, k])) for k in range(SECTOR_SETS)]
        labels += [_Label(s, along, False, False) for s in sectors]
    return labels


def _grid(size: int) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Rows of the cells (X, Y, Z), the cells (M, 3) in and just around the ball, and their points (M, 3)."""
    axis = ((np.arange(size + 2 * MARGIN) + 0.5 - MARGIN) * 2 / size - 1).astype(np.float32)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    inside = np.linalg.norm(grid, axis=-1) < 1 + 4.4 / size
    number = np.full(inside.shape, -1, np.int32)
    number[inside] = np.arange(inside.sum(), dtype=np.int32)
    return number, np.argwhere(inside).astype(np.int32), grid[inside]


@dataclass(frozen=True)
class _Cells:
    """What K labels cost and show at M cells."""

    costs: NDArray[np.float32]
    """(M, K)."""
    gains: NDArray[np.float32]
    """(M, K). Colour by which closed things stand out where they persist and other pictures show such colours."""
    closed: NDArray[np.float32]
    """(M, K). Colour by which closed things stand out, under the rind."""
    colours: NDArray[np.float32]
    """(M, K, 3)."""


def _costs(labels: list[_Label], along: list[_Source], ball: Ball, cell: float, seed: int) -> _Cells:
    """What all labels cost and show at all points; `cell` is the distance of points in radii."""
    shape = len(ball.points), len(labels)
    costs, gains, closed = (np.empty(shape, np.float32) for _ in range(3))
    out = _Cells(costs, gains, closed, np.empty((*shape, 3), np.float32))
    sheets_here = np.zeros(len(ball.points), np.float32)
    for n, label in enumerate(labels):
        places = label.chunks.places(ball)
        out.colours[:, n] = label.read_things(places, _crossing(labels, label, ball))
        closed[:, n] = _read(places, [s.closed for s in label.sources])[:, 0] * (1 - ball.rind)
        gone = _gone(places, label.sources)
        capped = label.is_own or not label.is_horizontal
        cost = DISTANCE_COST * (np.minimum(places.distance, FAR) if capped else places.distance)
        gain = np.maximum(closed[:, n] - gone, 0)
        near = np.zeros(len(cost))
        if label.is_own:
            band = OWN_BAND * np.exp(0.4 * smooth_noise(ball, 0.3, np.random.default_rng([seed, 2, n])))
            near = np.exp(-np.square(places.distance / band))
            own_plane = OWN_PLANE if label.is_horizontal else OWN_PLANE / 2  # on the line where they meet
            cost = cost - OWN_COST * near - own_plane * (places.distance < 0.75 * cell)
        else:
            cost = cost + RIND_COST * ball.rind
        if label.is_horizontal:
            sheet = _read(places, [s.sheets for s in label.sources])[:, 0]
            cost = cost + GONE_COST * gone * (1 - sheet) + (-SHEET_COST if label.is_own else SHEET_COST) * sheet
            if label.is_own:
                sheets_here = sheet
            if along:
                seen = _read(places, [s.blurred for s in label.sources])
                # A sheet may well lie beside a radial cut.
                surprise = np.minimum(_unseen(seen, along, ball), UNSEEN_MOST)
                cost = cost + UNSEEN_COST * surprise * (1 - near) * (1 - sheet)
                gain = gain * (1 - surprise / UNSEEN_MOST)
        else:
            cost = cost + GONE_COST * gone + SECTOR_COST + 0.5 * SHEET_COST * sheets_here
        costs[:, n], gains[:, n] = cost, gain
    return out


def _crossing(labels: list[_Label], label: _Label, ball: Ball) -> NDArray[np.float32]:
    """(M,). Distance in radii from the own planes of the family that is not the label's; infinite without one."""
    for other in labels:
        if label.is_own and other.is_own and other.is_horizontal != label.is_horizontal:
            return other.chunks.places(ball).distance
    return np.full(len(ball.points), np.inf, np.float32)


def _read(places: Places, discs: list[Disc]) -> NDArray[np.float32]:
    """(M, 3). What the places show of these discs, one for each source."""
    out = np.empty((len(places.x), 3), np.float32)
    for n, disc in enumerate(discs):
        rows = places.picture == n
        out[rows] = disc.read(places.x[rows], places.y[rows])
    return out


def _gone(places: Places, sources: list[_Source]) -> NDArray[np.float32]:
    """(M,). Colour that does not persist from the pictures' planes to the points."""
    out = np.empty(len(places.x), np.float32)
    for n, source in enumerate(sources):
        rows = places.picture == n
        out[rows] = source.persistence.gone(places.x[rows], places.y[rows], places.distance[rows])
    return out


def _unseen(seen: NDArray[np.float32], along: list[_Source], ball: Ball) -> NDArray[np.float32]:
    """(M,). Least squared distance of colours (M, 3) to those that any radial picture shows nearby."""
    least = np.full(len(seen), np.inf, np.float32)
    out = np.empty(len(seen), np.float32)
    for source in along:
        size = len(source.blurred.rgb)
        x, y = (a.astype(np.float32) for a in to_pixels(ball.radius, ball.points[:, 2], size))
        mirrored = np.float32(size - 1) - x
        nearest_colour(seen, x, y, mirrored, source.blurred.rgb, NEARBY * size / (2 * REACH), out)
        np.minimum(least, out, out=least)
    return least
