"""What a quilt's labels cost and show at the cells of a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.threads import side_by_side
from training.priors.exemplar.quilting.chunks import Ball, OwnHeight, smooth_noise
from training.priors.exemplar.quilting.disc import REACH, to_pixels
from training.priors.exemplar.quilting.labels import Label, Source, distance_across, read_discs, read_maps
from training.priors.exemplar.quilting.seams import labels_near, nearest_colour
from training.priors.exemplar.quilting.things.core import Core
from training.priors.exemplar.strata import Rows

__all__ = ["Cells", "Question", "weigh_labels"]

DISTANCE_COST = 5.0
"""Cost of a radius of distance from a picture's plane. All costs are weighed against seams between colours that differ
by one unit of RGB: a chunk that is a tenth of a radius nearer is worth a seam of difference 0.1."""

FAR = 0.15
"""Distance in radii beyond which that cost does not grow for pictures in their own plane and for sectors."""

GONE_COST = 4.0
"""Cost of a unit of colour that does not persist (`persistence`) and is shown all the same: dense things have nothing
to close over and must end at a seam."""

UNSEEN_COST, UNSEEN_MOST = 2.0, 0.1
"""Cost of colours that radial pictures do not show nearby, and squared distance to their nearest colour from which it
applies in full. Such colours are shown in their own plane alone: two pictures that contradict each other cannot both be
right beside it, and what is thick there is a bar in cuts across it. Walls between chambers of grains narrow towards
their ends there (`chambers.room_beside`), and are no bars."""

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
class Cells:
    """What K labels cost and show at M cells."""

    costs: NDArray[np.float32]
    """(M, K). Infinite where a label is out of the question."""
    colours: NDArray[np.float32]
    """(M, K, 3). Known where a label is in question and at the cells beside."""


@dataclass(frozen=True)
class Question:
    """Which of K labels are in question at M cells: seams of a coarser grid move within a band, as in banded graph cuts
    (Lombaert et al. 2005). With all ten labels at every cell, 2 to 4 cells in a thousand of the finest grid get one
    that is not near (five pairs), and thirteen drawn kinds come as near to true ones within 0.0002."""

    open: NDArray[np.bool_]
    """(M, K). Whether a label may be chosen."""
    beside: NDArray[np.bool_]
    """(M, K). Whether it may be chosen there or at a neighbour."""

    @classmethod
    def near(
        cls, labels: NDArray[np.int32], number: NDArray[np.int32], cells: NDArray[np.int32], count: int
    ) -> Question:
        """Those of `count` labels that cells of a grid or their neighbours have. `number` (X, Y, Z): row of each cell;
        `cells` (M, 3): the cells, which have these `labels` (M,)."""
        return cls(*(labels_near(labels, number, cells, count, reach) for reach in (1, 2)))


def weigh_labels(
    labels: list[Label], along: list[Source], ball: Ball, cell: float, seed: int, question: Question | None = None
) -> Cells:
    """What all labels cost and show at all points, or those in question; `cell` is the distance of points in radii."""
    shape = len(ball.points), len(labels)
    out = Cells(np.full(shape, np.inf, np.float32), np.empty((*shape, 3), np.float32))
    own = [label for label in labels if label.is_own and label.is_horizontal]
    membranes_here = [read_maps(label.chunks.places(ball), [s.membranes for s in label.sources]) for label in own]

    def weigh(n: int) -> None:
        rows: Rows = slice(None) if question is None else np.flatnonzero(question.beside[:, n])
        label, here = labels[n], ball.at(rows)
        places = label.chunks.places(here)
        even = label.read_even(places)
        out.colours[rows, n] = even + label.own_tones(places, distance_across(labels, label, here))
        left = label.left(places, even)
        capped = label.is_own or not label.is_horizontal
        cost = DISTANCE_COST * (np.minimum(places.distance, FAR) if capped else places.distance)
        surprise, membrane = np.zeros(len(cost), np.float32), np.zeros(len(cost), np.float32)
        if label.is_horizontal:
            membrane = read_maps(places, [s.membranes for s in label.sources])
            if along:  # a membrane may well lie beside a radial cut
                seen = read_discs(places, [s.blurred for s in label.sources])
                surprise = np.minimum(_unseen(seen, along, here) / UNSEEN_MOST, 1) * (1 - membrane)
        if label.is_own:
            surprise[-label.depth_in_chambers(places) > places.distance] = 0
            band = OWN_BAND * np.exp(0.4 * smooth_noise(here, 0.3, np.random.default_rng([seed, 2, n])))
            near = np.exp(-np.square(places.distance / band)) * (1 - surprise)
            own_plane = OWN_PLANE_GAIN if label.is_horizontal else OWN_PLANE_GAIN / 2  # on the line where they meet
            cost = cost - OWN_GAIN * near - own_plane * (places.distance < 0.75 * cell)
            surprise = surprise * (1 - near)
            if isinstance(label.chunks, OwnHeight):
                core, (x, y, z) = label.sources[0].core, here.points.T
                if isinstance(core, Core):  # a column is everywhere
                    cost = cost - CORE_GAIN * core.holds(x, y, z - label.chunks.height)
        else:
            cost = cost + RIND_COST * here.rind
        if label.is_horizontal:
            membrane_cost = -MEMBRANE_COST if label.is_own else MEMBRANE_COST
            cost = cost + GONE_COST * left * (1 - membrane) + membrane_cost * membrane
            cost = cost + UNSEEN_COST * surprise
        else:
            cost = cost + GONE_COST * left + SECTOR_COST
            for of_own in membranes_here:
                cost = cost + 0.5 * MEMBRANE_COST * of_own[rows]
        out.costs[rows, n] = cost if question is None else np.where(question.open[rows, n], cost, np.inf)

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
