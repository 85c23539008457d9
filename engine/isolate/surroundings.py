"""Finds what surrounds the object of a capture: a room, a garden, a sky. Between them is where the cameras were."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from engine.isolate.floor import BAND, best_plane, sample_skin
from engine.scene.gaussians import Gaussians
from engine.scene.rotations import normalised_quats, rotation_matrices
from engine.solid.denoise_capture import HAZE_OPACITY

__all__ = ["find_middle"]

Double = NDArray[np.float64]

DIRECTIONS = 512
"""Directions that are told apart in a view, nine degrees each: were they much finer, walls of Gaussians had gaps."""

STEPS = 8
"""Steps of distance to an octave."""

HIDDEN = 0.5
"""Opacity in a direction from which on the view ends there."""

MOST_FLOOR = 1 / 3
"""Share of directions. Between a distance r and twice it a floor, however wide, ends a quarter of them at most: of a
height h <= r below, (h / r - h / 2r) / 2."""

LEAST_BEYOND = 0.5
"""Share of directions. A floor ends the view in less than half of them, however far it reaches."""

LEAST = 0.05
"""Share of the Gaussians that the ball holds at least: captures are fine where the cameras looked."""

MOST_AROUND = 0.05
"""Gaussians around the ball, but for a floor, relative to those in it: floaters, not a neck or a branch."""

SAME = 0.002
"""Difference in that which says nothing: the smaller ball is taken."""

MARGIN = 1.6
"""The ball's radius over that which was found. What of the object lies close to its floor was not told from it, and a
floor is known by what of it is around the object: of five objects in four scenes with 1.25 in 16, with 1.6 in all."""

LEVELS = 6
"""Centres that are tried: the middle of all, of the half that is nearest to it, and so on."""

REACH = 1.5
"""Standard deviations of the disc for which a Gaussian stands: as large as makes its opacity times its area right."""

SAMPLES = 50_000
"""Gaussians that are looked at, at most."""


def find_middle(gaussians: Gaussians) -> tuple[tuple[float, float, float], float] | None:
    """Centre and radius, in world units, of a ball that holds the object of a capture with surroundings.

    None if it has none. Cameras see all of an object from twice its reach or more, and there is nothing but its floor
    where they were. So the ball is the smallest, around the middle of most of the capture, that has hardly anything
    around it up to twice its radius, and something beyond in most directions; larger by a margin. A wide floor alone
    does not surround an object, nor does a wall behind it. The same ball for the same capture, whatever its units.
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
    """Gaussians around it, but for a floor, relative to those in it."""
    middle: Double
    """(3,). The middle of what it holds, but for a floor."""


class _Around:
    """What is seen from a centre."""

    def __init__(self, gaussians: Gaussians, centre: Double) -> None:
        self.gaussians = gaussians
        self.far = np.linalg.norm(gaussians.means - centre, axis=1)
        points, areas = _discs(gaussians)
        away = points - centre
        far = np.linalg.norm(away, axis=2)
        far = np.maximum(far, 1e-9 * float(far.max()) + 1e-30)
        cells = cKDTree(_directions()).query((away / far[..., None]).reshape(-1, 3))[1]
        octaves = np.log2(far)
        self.first = float(np.percentile(octaves[0], 100 * LEAST))
        step = np.maximum(np.floor((octaves - self.first) * STEPS) + 1, 0).astype(np.int64)
        opacity = areas / (len(points) * far**2) * DIRECTIONS / (4 * math.pi)
        hidden = np.zeros((int(step.max()) + 1, DIRECTIONS))
        np.add.at(hidden, (step.ravel(), cells), opacity.ravel())
        self.hidden = np.cumsum(hidden, 0)
        """(S, DIRECTIONS). Opacities added up to the end of each step; the first ends where a ball holds LEAST."""

    def free_ball(self) -> Ball | None:
        """The ball with the least around it, an octave at most larger than the smallest that will do."""
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


def _directions() -> Double:
    """(DIRECTIONS, 3). Unit vectors, even over the sphere: a Fibonacci lattice."""
    k = np.arange(DIRECTIONS) + 0.5
    z = 1 - 2 * k / DIRECTIONS
    angle = math.pi * (1 + math.sqrt(5)) * k
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], 1)
