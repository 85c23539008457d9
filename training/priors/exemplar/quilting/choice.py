"""What a quilt's labels cost and show at the cells of a grid, and how many grains there should be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.threads import side_by_side
from training.priors.exemplar.quilting.chunks import Ball, OwnHeight, Places, smooth_noise
from training.priors.exemplar.quilting.disc import REACH, read_map, to_pixels
from training.priors.exemplar.quilting.labels import Label, Source, distance_across, read_discs, read_maps
from training.priors.exemplar.quilting.seams import nearest_colour
from training.priors.exemplar.quilting.things.core import Core
from training.priors.exemplar.sampling import read_as_scipy

__all__ = ["REGIONS", "Cells", "Regions", "closed_of", "weigh_labels"]

DISTANCE_COST = 5.0
"""Cost of a radius of distance from a picture's plane. All costs are weighed against seams between colours that differ
by one unit of RGB: a chunk that is a tenth of a radius nearer is worth a seam of difference 0.1."""

FAR = 0.15
"""Distance in radii beyond which that cost does not grow for pictures in their own plane and for sectors."""

GONE_COST = 4.0
"""Cost of a unit of colour that does not persist (`persistence`) and is shown all the same: dense things have nothing
to close over and must end at a seam."""

REGIONS = (10, 20)
"""Bins of radius and height, blurred by their width, in which the pictures tell how much grains cover there. One gain
for all places heaps them where the pictures have most."""

UNSEEN_COST, UNSEEN_MOST = 2.0, 0.1
"""Cost of colours that radial pictures do not show nearby, and squared distance to their nearest colour from which it
applies in full. Such colours are shown in their own plane alone: two pictures that contradict each other cannot both be
right beside it, and what is thick there is a bar in cuts across it."""

NEARBY = 0.035
"""Step in radii of the 5x5 points that count as nearby: two fruits have their seeds a tenth of a radius apart."""

MEMBRANE_COST = 6.0
"""Cost of cutting off a membrane or of growing one where none starts: more than any seam."""

RIND_COST = 1.0
"""Cost of random chunks in the rind, where own pictures continue one another."""

SECTOR_COST = 0.3
"""Cost of radial pictures where horizontal ones are as good: repeated around the axis they show as rings."""

OWN_GAIN, OWN_BAND = 1.0, 0.03
"""Gain of a picture near its own plane, and how near in radii, up to a smooth random factor: no band has an edge. With
three times the gain the band is equally wide everywhere and shows as a bar in cuts across it."""

CORE_GAIN = 20.0
"""Gain of a horizontal picture around its core: more than any seam, less than that of a plane that is shown itself."""

OWN_PLANE_GAIN = 100.0
"""Gain in the cells at the plane itself, which shows the picture."""


@dataclass(frozen=True)
class Regions:
    """Rings of the ball: bins of the distance from the axis and of the height."""

    bins: NDArray[np.int64]
    """(M,). Number of each point's bin."""
    places: NDArray[np.float32]
    """(2, M). Position of each point, in bins."""
    counts: NDArray[np.float64]

    @classmethod
    def of(cls, ball: Ball) -> Regions:
        places = np.stack([ball.radius * REGIONS[0] - 0.5, (ball.points[:, 2] + 1) / 2 * REGIONS[1] - 0.5])
        at = [np.clip(np.round(p).astype(np.int64), 0, n - 1) for p, n in zip(places, REGIONS, strict=True)]
        bins = at[0] * REGIONS[1] + at[1]
        return cls(bins, places, _spread(np.bincount(bins, minlength=REGIONS[0] * REGIONS[1]).reshape(REGIONS)))

    def means(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """REGIONS. Means of values (M,) in and around the bins."""
        total = np.bincount(self.bins, weights=values, minlength=REGIONS[0] * REGIONS[1]).reshape(REGIONS)
        return _spread(total) / np.maximum(self.counts, 1e-6)

    def at(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M,). Values of the bins at the points."""
        return read_as_scipy(values[..., None], *self.places)[:, 0]


def _spread(values: NDArray[np.number]) -> NDArray[np.float64]:
    return np.asarray(ndimage.gaussian_filter(values.astype(np.float64), 1.0, mode="constant"))


def closed_of(sources: list[Source], ball: Ball, is_horizontal: bool) -> NDArray[np.float32]:
    """(M,). How far grains stand out in the pictures, as if the ball had them all around the axis, or at all
    heights."""
    places = [ball.level.T] if is_horizontal else [(side * ball.radius, ball.points[:, 2]) for side in (1, -1)]
    closed = [read_map(source.closed, x, y) for source in sources for x, y in places]
    return np.asarray(np.mean(closed, axis=0) * (1 - ball.rind), np.float32)


@dataclass(frozen=True)
class Cells:
    """What K labels cost and show at M cells."""

    costs: NDArray[np.float32]
    """(M, K)."""
    gains: NDArray[np.float32]
    """(M, K). Colour by which grains stand out, where they persist and other pictures show such colours."""
    closed: NDArray[np.float32]
    """(M, K). Colour by which grains stand out, under the rind."""
    colours: NDArray[np.float32]
    """(M, K, 3)."""
    places: list[Places]
    """What the labels read at the cells."""


def weigh_labels(labels: list[Label], along: list[Source], ball: Ball, cell: float, seed: int) -> Cells:
    """What all labels cost and show at all points; `cell` is the distance of points in radii."""
    shape = len(ball.points), len(labels)
    costs, gains, closed = (np.empty(shape, np.float32) for _ in range(3))
    read = side_by_side(lambda label: label.chunks.places(ball), labels)
    out = Cells(costs, gains, closed, np.empty((*shape, 3), np.float32), read)
    own = [(label, places) for label, places in zip(labels, read, strict=True) if label.is_own and label.is_horizontal]
    membranes_here = [read_maps(places, [s.membranes for s in label.sources]) for label, places in own]

    def weigh(n: int) -> None:
        label, places = labels[n], read[n]
        even = label.read_even(places)
        out.colours[:, n] = label.in_own_tones(even, places, distance_across(labels, label, ball))
        there = read_maps(places, [s.closed for s in label.sources]) * (1 - ball.rind)
        gone, left = label.gone(places, even)
        capped = label.is_own or not label.is_horizontal
        cost = DISTANCE_COST * (np.minimum(places.distance, FAR) if capped else places.distance)
        gain = np.maximum(there - gone, 0)
        closed[:, n] = gain
        surprise, membrane = np.zeros(len(cost), np.float32), np.zeros(len(cost), np.float32)
        if label.is_horizontal:
            membrane = read_maps(places, [s.membranes for s in label.sources])
            if along:  # a membrane may well lie beside a radial cut
                seen = read_discs(places, [s.blurred for s in label.sources])
                surprise = np.minimum(_unseen(seen, along, ball) / UNSEEN_MOST, 1) * (1 - membrane)
                gain = gain * (1 - surprise)
        if label.is_own:
            band = OWN_BAND * np.exp(0.4 * smooth_noise(ball, 0.3, np.random.default_rng([seed, 2, n])))
            near = np.exp(-np.square(places.distance / band)) * (1 - surprise)
            own_plane = OWN_PLANE_GAIN if label.is_horizontal else OWN_PLANE_GAIN / 2  # on the line where they meet
            cost = cost - OWN_GAIN * near - own_plane * (places.distance < 0.75 * cell)
            surprise = surprise * (1 - near)
            if isinstance(label.chunks, OwnHeight):
                core, (x, y, z) = label.sources[0].core, ball.points.T
                if isinstance(core, Core):  # a column is everywhere
                    cost = cost - CORE_GAIN * core.holds(x, y, z - label.chunks.height)
        else:
            cost = cost + RIND_COST * ball.rind
        if label.is_horizontal:
            membrane_cost = -MEMBRANE_COST if label.is_own else MEMBRANE_COST
            cost = cost + GONE_COST * left * (1 - membrane) + membrane_cost * membrane
            cost = cost + UNSEEN_COST * surprise
        else:
            cost = cost + GONE_COST * left + SECTOR_COST
            for membrane in membranes_here:
                cost = cost + 0.5 * MEMBRANE_COST * membrane
        costs[:, n], gains[:, n] = cost, gain

    side_by_side(weigh, range(len(labels)))
    return out


def _unseen(seen: NDArray[np.float32], along: list[Source], ball: Ball) -> NDArray[np.float32]:
    """(M,). Least squared distance of colours (M, 3) to those that any radial picture shows nearby."""
    least = np.full(len(seen), np.inf, np.float32)
    for source in along:
        size = len(source.blurred.rgb)
        x, y = (a.astype(np.float32) for a in to_pixels(ball.radius, ball.points[:, 2], size))
        mirrored = np.float32(size - 1) - x
        step = NEARBY * size / (2 * REACH)
        np.minimum(least, nearest_colour(seen, x, y, mirrored, source.blurred.rgb, step), out=least)
    return least
