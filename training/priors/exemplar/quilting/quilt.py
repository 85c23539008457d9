"""Quilts an inside of chunks of photographs of different individuals (graph-cut textures, Kwatra et al. 2003, in 3D).

Every cell of a grid in the unit ball has a label: a set of chunks whose picture it shows. The labels minimise the sum
of what a label costs at a cell (its distance from the plane that the picture shows, what does not persist so far from
it, colours that the radial pictures do not show there) and of seams, which are free where both sides agree. Colours
are read, never averaged, so an inside is as sharp as its pictures; only tones pass into one another at seams. Chunks
hold the things of pictures; their texture is that of thin layers (`texture`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.chunks import (
    SECTOR_SETS,
    SLABS,
    Ball,
    OwnAzimuths,
    OwnHeight,
    Sectors,
    Slabs,
    smooth_noise,
    smoothstep,
)
from training.priors.exemplar.quilting.disc import (
    ALIKE,
    REACH,
    Disc,
    match_light,
    to_pixels,
)
from training.priors.exemplar.quilting.labels import Label, Source, closed_share, read_discs
from training.priors.exemplar.quilting.seams import improve_labels, nearest_colour, two_nearest
from training.priors.exemplar.quilting.texture import TextureField
from training.priors.exemplar.sampling import read_trilinear
from training.priors.prior import Progress

__all__ = ["Quilt", "make_quilt", "restore_quilt"]

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

UNSEEN_COST = 20.0
"""Cost of the squared distance, to at most UNSEEN_MOST, to the nearest colour that radial pictures show nearby."""

UNSEEN_MOST = 0.1

NEARBY = 0.035
"""Step in radii of the 5x5 points that count as nearby: two fruits have their seeds a tenth of a radius apart."""

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

TONE_BLEND = 0.04
"""Standard deviation in radii over which the tones of two chunks pass into one another at their seam."""

OWN_WEIGHT, OWN_ALONE = 4.0, 0.015
"""Further weight of a picture's tones in its own plane, and distance in radii from it within which they are alone: less
than to the nearest seam, so that it is none."""

CROSSING = 2
"""Cells from own planes of both families within which the nearer one is shown."""

SEAM_COST = 0.0075
"""Weight of a seam over the width of a cell in radii."""

SEAM_WIDTH = 0.6
"""Difference of two labels' trilinear weights within which they pass into one another: two thirds of a cell, under a
hundredth of a radius. Without it a seam shows as a crack as soon as a cell is many pixels wide."""

BLOCK = 50_000
"""Points that are read at once: their arrays stay in the cache, which takes a third off the time of 400,000."""


@dataclass(frozen=True)
class Quilt:
    """The inside as a function on the unit ball."""

    labels: list[Label]
    number: NDArray[np.int32]
    """(X, Y, Z). Row of each cell of the finest grid, -1 outside."""
    chosen: NDArray[np.int32]
    """(M,). Label of each cell."""
    texture: TextureField
    tones: NDArray[np.float32]
    """(X, Y, Z, 3). Tones at the cells without steps at seams."""

    def read(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, 3). Colours at points (M, 3) of the unit ball along e1, e2, up. Range [0, 1]."""
        out = np.empty((len(points), 3), np.float32)
        for start in range(0, len(points), BLOCK):
            block = points[start : start + BLOCK]
            at = _in_cells(block, LEVELS[-1])
            best, shares = np.empty((len(block), 2), np.int32), np.empty((len(block), 2), np.float32)
            two_nearest(self.chosen, self.number, at, len(self.labels), best, shares)
            apart = shares[:, 0] - shares[:, 1]
            self._share_crossing(best, apart, block)
            weight = 0.5 + 0.5 * smoothstep(apart / SEAM_WIDTH)
            tones = np.empty((len(block), 3), np.float32)
            read_trilinear(self.tones, at, tones)
            rgb = np.zeros((len(block), 3), np.float32)
            for labels, share in ((best[:, 0], weight), (best[:, 1], 1 - weight)):
                for n, label in enumerate(self.labels):
                    rows = np.flatnonzero((labels == n) & (share > 0))
                    rgb[rows] += share[rows, None] * self._shown(label, block[rows], tones[rows])
            out[start : start + len(block)] = rgb
        return np.clip(out, 0, 1)

    def _shown(self, label: Label, points: NDArray[np.float32], tones: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, 3). What a label shows at points (M, 3), in the tones (M, 3) of its neighbourhood."""
        ball = Ball.of(points)
        places, crossing = label.chunks.places(ball), _crossing(self.labels, label, ball)
        rgb = label.read(places, crossing, self.texture.at(ball), self.texture.thickness)
        moved = tones - label.read_tones(places, crossing)
        moved *= np.exp(-np.square(moved).sum(-1, keepdims=True) / (2 * ALIKE**2))
        if label.is_own:
            moved *= 1 - np.exp(-np.square(places.distance / OWN_ALONE))[:, None]
        return rgb + moved

    def reduced(self, n: int) -> Quilt:
        """The same inside of pictures with pixels n times as large."""
        sources = {id(source): source.reduced(n) for label in self.labels for source in label.sources}
        labels = [replace(label, sources=[sources[id(source)] for source in label.sources]) for label in self.labels]
        return replace(self, labels=labels, texture=self.texture.reduced(n))

    def _share_crossing(self, best: NDArray[np.int32], apart: NDArray[np.float32], points: NDArray[np.float32]) -> None:
        """Gives points (M, 3) close to own planes of both families to the nearer one: as cells, one plane would cut a
        bar out of the other. Changes the nearest two labels (M, 2) and how far they are apart (M,)."""
        own = np.array([n for n, label in enumerate(self.labels) if label.is_own], np.int32)
        if len(own) < 2:
            return
        rows = np.flatnonzero(np.isin(best[:, 0], own))
        ball = Ball.of(points[rows])
        distances = np.stack([self.labels[n].chunks.places(ball).distance for n in own])
        both = distances.max(0) < CROSSING * 2 / LEVELS[-1]
        order = distances[:, both].argsort(0)
        nearer, farther = np.take_along_axis(distances[:, both], order, 0)
        best[rows[both]], apart[rows[both]] = own[order].T, (farther - nearer) / (farther + nearer + 1e-9)


def make_quilt(
    horizontal: Sequence[Disc], radial: Sequence[Disc], seed: int, progress: Progress, height: float = 0.0
) -> Quilt:
    """The quilt of horizontal and radial pictures, each 0 or more and one at least together; the first horizontal one
    at a height in the unit ball. Bit-equal for a seed."""
    across, along = _make_sources(horizontal, radial)
    labels = _make_labels(across, along, height, seed)
    wanted = closed_share(along or across, not along)
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
            best, shares = np.empty((len(points), 2), np.int32), np.empty((len(points), 2), np.float32)
            two_nearest(before, coarse, _in_cells(points, LEVELS[step - 1]), len(labels), best, shares)
            chosen = best[:, 0].copy()
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
    return _assembled(labels, across or along, seed, number, chosen, ball)


def restore_quilt(
    horizontal: Sequence[Disc], radial: Sequence[Disc], seed: int, height: float, chosen: NDArray[np.int32]
) -> Quilt:
    """The quilt that `make_quilt` found: `chosen` (M,) as it has it, the rest as it was given. Raises
    ValueError if `chosen` is not the labels of its cells."""
    across, along = _make_sources(horizontal, radial)
    number, _, points = _grid(LEVELS[-1])
    labels = _make_labels(across, along, height, seed)
    if chosen.shape != (len(points),) or not 0 <= chosen.min() <= chosen.max() < len(labels):
        raise ValueError("no label for each cell")
    return _assembled(labels, across or along, seed, number, chosen, Ball.of(points))


def _make_sources(horizontal: Sequence[Disc], radial: Sequence[Disc]) -> tuple[list[Source], list[Source]]:
    """What is known of the pictures, all in the light of the first."""
    first = [*horizontal, *radial][0]
    across, along = (
        [Source.of(disc if disc is first else match_light(disc, first), family is horizontal) for disc in family]
        for family in (horizontal, radial)
    )
    return across, along


def _assembled(
    labels: list[Label],
    textured: list[Source],
    seed: int,
    number: NDArray[np.int32],
    chosen: NDArray[np.int32],
    ball: Ball,
) -> Quilt:
    texture = TextureField([source.parts.texture for source in textured], np.random.default_rng([seed, 5]))
    return Quilt(labels, number, chosen, texture, _blended_tones(labels, ball, number, chosen))


def _in_cells(points: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """(M, 3). Points (M, 3) of the ball on a grid of `size` cells across it, cell centres at whole numbers."""
    return ((points + 1) * np.float32(size / 2) + np.float32(MARGIN - 0.5)).astype(np.float32)


def _blended_tones(
    labels: list[Label], ball: Ball, number: NDArray[np.int32], chosen: NDArray[np.int32]
) -> NDArray[np.float32]:
    """(X, Y, Z, 3). The labels' tones, which pass into one another at seams: the lower of two bands of a
    multiresolution spline (Burt and Adelson 1983)."""
    inside = number >= 0
    blended = np.zeros((len(ball.points), 3), np.float32)
    weights = np.zeros((len(ball.points), 1), np.float32)
    for n, label in enumerate(labels):
        here = np.zeros(number.shape, np.float32)
        here[inside] = chosen == n
        weight = ndimage.gaussian_filter(here, TONE_BLEND * LEVELS[-1] / 2)[inside]
        places = label.chunks.places(ball)
        if label.is_own:
            weight *= 1 + OWN_WEIGHT * np.exp(-np.square(places.distance / TONE_BLEND))
        blended += weight[:, None] * label.read_tones(places, _crossing(labels, label, ball))
        weights += weight[:, None]
    total = np.zeros((*number.shape, 3), np.float32)
    total[inside] = blended / np.maximum(weights, 1e-6)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return total[tuple(nearest)]


def _make_labels(across: list[Source], along: list[Source], height: float, seed: int) -> list[Label]:
    """Own planes first, then random chunks."""
    labels = []
    if across:
        own = OwnHeight(height, across[0].sheets, np.random.default_rng([seed, 3]))
        labels.append(Label(own, across, True, True))
    if along:
        labels.append(Label(OwnAzimuths(len(along), np.random.default_rng([seed, 4])), along, False, True))
    if across:
        slabs = [Slabs(k, len(across), np.random.default_rng([seed, 0, k])) for k in range(SLABS)]
        labels += [Label(s, across, True, False) for s in slabs]
    if along:
        sectors = [Sectors(k, len(along), np.random.default_rng([seed, 1, k])) for k in range(SECTOR_SETS)]
        labels += [Label(s, along, False, False) for s in sectors]
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


def _costs(labels: list[Label], along: list[Source], ball: Ball, cell: float, seed: int) -> _Cells:
    """What all labels cost and show at all points; `cell` is the distance of points in radii."""
    shape = len(ball.points), len(labels)
    costs, gains, closed = (np.empty(shape, np.float32) for _ in range(3))
    out = _Cells(costs, gains, closed, np.empty((*shape, 3), np.float32))
    sheets_here = np.zeros(len(ball.points), np.float32)
    for n, label in enumerate(labels):
        places = label.chunks.places(ball)
        out.colours[:, n] = label.read_things(places, _crossing(labels, label, ball))
        closed[:, n] = read_discs(places, [s.closed for s in label.sources])[:, 0] * (1 - ball.rind)
        gone = label.gone(places)
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
            sheet = read_discs(places, [s.sheets for s in label.sources])[:, 0]
            cost = cost + GONE_COST * gone * (1 - sheet) + (-SHEET_COST if label.is_own else SHEET_COST) * sheet
            if label.is_own:
                sheets_here = sheet
            if along:
                seen = read_discs(places, [s.blurred for s in label.sources])
                # A sheet may well lie beside a radial cut.
                surprise = np.minimum(_unseen(seen, along, ball), UNSEEN_MOST)
                cost = cost + UNSEEN_COST * surprise * (1 - near) * (1 - sheet)
                gain = gain * (1 - surprise / UNSEEN_MOST)
        else:
            cost = cost + GONE_COST * gone + SECTOR_COST + 0.5 * SHEET_COST * sheets_here
        costs[:, n], gains[:, n] = cost, gain
    return out


def _crossing(labels: list[Label], label: Label, ball: Ball) -> NDArray[np.float32]:
    """(M,). Distance in radii from the own planes of the family that is not the label's; infinite without one."""
    for other in labels:
        if label.is_own and other.is_own and other.is_horizontal != label.is_horizontal:
            return other.chunks.places(ball).distance
    return np.full(len(ball.points), np.inf, np.float32)


def _unseen(seen: NDArray[np.float32], along: list[Source], ball: Ball) -> NDArray[np.float32]:
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
