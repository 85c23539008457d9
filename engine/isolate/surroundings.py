"""Finds what surrounds the object of a capture: a room, a garden, a sky. The cameras were between the two."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.isolate.floor import BAND, best_plane, sample_skin
from engine.scene.camera import spread_directions
from engine.scene.gaussians import Gaussians
from engine.scene.rotations import normalised_quats, rotation_matrices
from engine.solid.denoise_capture import HAZE_OPACITY
from engine.threads import for_spans

__all__ = ["object_ball"]

Double = NDArray[np.float64]

DIRECTIONS = 512
"""Directions of view that are told apart, nine degrees each: were they much finer, walls of Gaussians would have
gaps."""

STEPS = 8
"""Steps of distance per octave."""

HIDDEN = 0.5
"""Opacity in a direction from which the view ends there."""

MOST_FLOOR = 1 / 3
"""Largest share of directions in which the view may end between distances r and 2r. A floor, however wide, ends it in a
quarter at most: from h <= r below, in (h / r - h / 2r) / 2."""

LEAST_BEYOND = 0.5
"""Least share of directions in which the view ends farther out. A floor ends it in less than half of them, however far
it reaches."""

LEAST = 0.05
"""Least share of the Gaussians in the ball: captures are fine where the cameras looked."""

MOST_AROUND = 0.05
"""Most Gaussians around the ball, floor aside, relative to those in it: floaters, not a neck or a branch."""

SAME = 0.002
"""Difference in that share that means nothing: the smaller ball is taken."""

MARGIN = 1.6
"""The ball's radius over the one found. Parts of the object close to its floor were not told from it, and a floor is
recognised by what of it is around the object: of five objects in four scenes, with 1.25 in 16, with 1.6 in all."""

LEVELS = 6
"""Centres that are tried: the middle of all, of the half nearest to it, and so on."""

REACH = 1.5
"""Radius, in standard deviations, of the disc that a Gaussian counts as: it makes opacity times area right."""

SAMPLES = 50_000
"""Most Gaussians that are looked at."""


def object_ball(gaussians: Gaussians) -> tuple[tuple[float, float, float], float] | None:
    """Centre and radius, in world units, of a ball that holds the object of a capture with surroundings.

    None if there are no surroundings. Cameras see all of an object from twice its reach or more, and there is nothing
    but its floor where they were. So the ball is the smallest, around the middle of most of the capture, that has
    hardly anything around it up to twice its radius, and something beyond in most directions; enlarged by a margin. A
    wide floor alone does not surround an object, nor does a wall behind it. The same capture gives the same ball,
    whatever its units.
    """
    finite = np.isfinite(gaussians.means).all(1) & np.isfinite(gaussians.scales).all(1)
    rows = np.flatnonzero(finite & (gaussians.opacities >= HAZE_OPACITY))
    if len(rows) < 100:
        return None
    plain = replace(gaussians, sh=gaussians.sh[:, :1])[rows[:: -(-len(rows) // SAMPLES)]]
    left = plain.means.astype(np.float64)
    for _ in range(LEVELS):
        centre = np.median(left, 0)
        found = _Around(plain, centre).free_ball()
        if found is not None:
            break
        far = np.linalg.norm(left - centre, axis=1)
        left = left[far <= np.median(far)]
    else:
        return None
    again = _Around(plain, found.middle)  # half of a guitar's Gaussians are on its body
    better = again.free_ball()
    if better is not None and better.rest <= found.rest + SAME:
        centre, found = found.middle, better
    x, y, z = centre.tolist()
    return (x, y, z), MARGIN * found.radius


@dataclass(frozen=True)
class Ball:
    """A ball around which there is room for cameras."""

    radius: float
    rest: float
    """Gaussians around it, floor aside, relative to those in it."""
    middle: Double
    """(3,). The middle of what it holds, floor aside."""


class _Around:
    """The view from a centre."""

    def __init__(self, gaussians: Gaussians, centre: Double) -> None:
        self.gaussians = gaussians
        self.far = np.linalg.norm(gaussians.means - centre, axis=1)
        points, areas = _discs(gaussians)
        away = points - centre
        far = np.linalg.norm(away, axis=2)
        far = np.maximum(far, 1e-9 * float(far.max()) + 1e-30)
        cells = np.empty(far.size, np.int64)
        for_spans(_nearest_directions, far.size, (away / far[..., None]).reshape(-1, 3), directions_of_view(), cells)
        octaves = np.log2(far)
        self.first = float(np.percentile(octaves[0], 100 * LEAST))
        step = np.maximum(np.floor((octaves - self.first) * STEPS) + 1, 0).astype(np.int64)
        opacity = areas / (len(points) * far**2) * DIRECTIONS / (4 * math.pi)
        hidden = np.zeros((int(step.max()) + 1, DIRECTIONS))
        np.add.at(hidden, (step.ravel(), cells), opacity.ravel())
        self.hidden = np.cumsum(hidden, 0)
        """(S, DIRECTIONS). Opacities added up to the end of each step; the first ends where a ball holds LEAST."""

    def free_ball(self) -> Ball | None:
        """The ball with the least around it, at most an octave larger than the smallest that will do; None if none."""
        best, rng = None, np.random.default_rng(0)
        last = len(self.hidden) - STEPS
        for step in range(last):
            inside, around = self.hidden[step], self.hidden[step + STEPS]
            if (self.hidden[-1] - around > HIDDEN).mean() < LEAST_BEYOND or step > last:
                break
            if (around - inside > HIDDEN).mean() > MOST_FLOOR:
                continue
            ball = self._ball(2.0 ** (self.first + step / STEPS), rng)
            if ball.rest <= MOST_AROUND:
                last = min(last, step + STEPS)
                if best is None or ball.rest < best.rest - SAME:
                    best = ball
        return best

    def _ball(self, radius: float, rng: np.random.Generator) -> Ball:
        """What a ball holds and has around it."""
        near = self.far < 2 * radius
        some = self.gaussians[near]
        points, flats = sample_skin(some, rng)
        low, high = np.percentile(points, [5, 95], axis=0)
        band = BAND * float((high - low).max())
        floor = best_plane(points, flats, band, rng)
        inside = self.far[near] < radius
        if floor is not None:
            above = floor.distance(some.means) > 2 * band
            some, inside = some[above], inside[above]
        held = some.means[inside]
        if len(held) < 2:
            return Ball(radius, math.inf, np.zeros(3))
        low, high = np.percentile(held.astype(np.float64), [1, 99], axis=0)
        return Ball(radius, (~inside).sum() / inside.sum(), (low + high) / 2)


def _discs(gaussians: Gaussians) -> tuple[Double, Double]:
    """Five points (5, N, 3) on the disc of each Gaussian, and its opacity times its area (N,)."""
    scales = gaussians.scales.astype(np.float64)
    order = np.argsort(scales, axis=1)[:, 1:]
    axes = rotation_matrices(normalised_quats(gaussians.quats))
    wide = np.take_along_axis(scales, order, 1)
    sides = 0.6 * REACH * np.take_along_axis(axes, order[:, None], 2) * wide[:, None]
    means = gaussians.means.astype(np.float64)
    points = np.stack([means, *(means + sign * sides[..., k] for k in (0, 1) for sign in (-1, 1))])
    return points, math.pi * REACH**2 * wide[:, 0] * wide[:, 1] * gaussians.opacities


def directions_of_view() -> Double:
    """(DIRECTIONS, 3). Unit vectors spread evenly over the sphere, by falling z. Mirrored: the spiral turns the way for
    which the constants above were found."""
    return spread_directions(DIRECTIONS, 0.5) * (1, -1, 1)


@njit(cache=True, nogil=True)
def _nearest_directions(
    start: int,
    stop: int,
    points: Double,  # [P, 3] unit vectors
    directions: Double,  # [D, 3], by falling z in even steps
    nearest: NDArray[np.int64],  # [P], filled
) -> None:
    """Fills in the number of the direction next to each point. The search goes up and down from the one at the point's
    own height until the difference in height alone is too large: a fifth of the time that a k-d tree takes."""
    count = len(directions)
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        level = min(max(int((1 - z) / 2 * count), 0), count - 1)
        least = np.inf
        for step, begin in ((-1, level), (1, level + 1)):
            k = begin
            while 0 <= k < count:
                dx, dy, dz = x - directions[k, 0], y - directions[k, 1], z - directions[k, 2]
                if dz * dz > least:
                    break
                distance = dx * dx + dy * dy + dz * dz
                if distance < least:
                    least, nearest[i] = distance, k
                k += step
