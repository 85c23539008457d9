"""Turns Gaussians into small opaque surface atoms (paper, section 3.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.kernel_field import axes_of
from engine.scene.atoms import SurfaceAtoms
from engine.scene.camera import cameras_around
from engine.scene.gaussians import Gaussians
from engine.scene.morton import morton_order
from engine.solid.carving import share_in_front
from engine.solid.contribution import contributions
from engine.solid.find_body import Enclosure
from engine.solid.skin_cover import close_holes

__all__ = ["Atomised", "atomise"]

UP = np.array([0.0, 0.0, 1.0])
"""Axis of the views from all around; any would do."""

VIEWS = 24
"""Views of the capture."""

PITCH_PIXELS, MOST_PIXELS = 2.5, 384
"""Pixels of these views per pitch, and most along an edge: a strut of a pitch or less must be seen to contribute."""

MAX_DEPTH = 1.0
"""Depth below the skin, pitches, from which an atom is invisible: debris, or the buried part of a thick Gaussian."""

MAX_IN_FRONT = 0.5
"""Share of an atom's weight in front of what the capture shows above which it would hide more than it shows."""

COVERAGE = 4.0
"""Area of an atom over that of its Gaussian, per opacity that compositing leaves it; at most 1 in all. The
contributions in a pixel add up to its alpha, and unit kernels must add up to more to leave no gaps at random places:
with half as much, captures lose 0.3 to 0.5 dB after the fit."""

SPACING = 1.6
"""Distance between the parts of a split Gaussian, in their standard deviations: their summed kernels ripple by 8 %."""

MAX_PARTS = 12
"""Most parts along one axis. A Gaussian that would need more belongs to the background and is cut short."""


@dataclass(frozen=True)
class Atomised:
    """Surface atoms, and counts of how the Gaussians became atoms."""

    atoms: SurfaceAtoms
    dropped: int
    """Gaussians left out because nothing shows them, or as debris inside or veils in front."""
    split: int
    """Gaussians larger than the pitch, which became several atoms."""


def atomise(enclosure: Enclosure, pitch: float, tolerance: float) -> Atomised:
    """Atoms of the enclosure's shell, opaque (the paper's uniform opacification) and no larger than the pitch (its
    atomic clipping).

    Everything that a picture of the shell shows stays, even sheets without an inside. Left out is what lies below the
    skin, what compositing leaves less opacity than `tolerance`, range (0, 1), in every view, and what would hide the
    rest: an opaque veil hides what a translucent one let through. A Gaussian's area across its thin axis shrinks with
    its contribution, so that one made faint by compositing does not tint its neighbours. Gaussians larger than the
    pitch are split along their principal axes into parts with the same mean and variance. Holes in the skin of the body
    are closed. The atoms are in Morton order. Bit-equal for the same input.
    """
    assert pitch > 0 and 0 < tolerance < 1, (pitch, tolerance)
    gaussians, body = enclosure.shell, enclosure.body
    low, high = gaussians.visible_bounds()
    radius = float(np.linalg.norm(high - low)) / 2
    size = min(math.ceil(PITCH_PIXELS * 2 * radius / pitch), MOST_PIXELS)
    cameras = cameras_around((low + high) / 2, radius, UP, VIEWS, size)
    contribution, medians = contributions(gaussians, cameras)
    # A thick Gaussian may reach the skin from within without being part of it.
    rows = np.flatnonzero((contribution >= tolerance) & (body.at(gaussians.means) < MAX_DEPTH * pitch))
    kept = gaussians[rows]
    scales = kept.scales.copy()
    shrink = np.repeat(np.sqrt(np.minimum(COVERAGE * contribution[rows], 1))[:, None], 3, axis=1)
    shrink[np.arange(len(kept)), scales.argmin(axis=1)] = 1.0
    scales *= shrink
    large = scales.max(axis=1, initial=0) > pitch
    source, part_means, part_scales = split(kept[large], scales[large], pitch)
    means = np.concatenate([kept.means[~large], part_means])
    scales = np.concatenate([scales[~large], part_scales])
    origin = np.concatenate([rows[~large], rows[large][source]])

    def atoms_of(chosen: NDArray[np.bool_]) -> SurfaceAtoms:
        parents = origin[chosen]
        return SurfaceAtoms(means[chosen], scales[chosen], gaussians.quats[parents], gaussians.sh[parents])

    chosen = body.at(means) < MAX_DEPTH * pitch
    chosen[chosen] = share_in_front(atoms_of(chosen), pitch, cameras, medians) <= MAX_IN_FRONT
    atoms = atoms_of(chosen)
    patches = close_holes(atoms, body, pitch)
    atoms = SurfaceAtoms(*(np.concatenate([getattr(a, f.name) for a in (atoms, patches)]) for f in fields(atoms)))
    order = morton_order(atoms.means)
    atoms = SurfaceAtoms(*(getattr(atoms, f.name)[order] for f in fields(atoms)))
    return Atomised(atoms, len(gaussians) - len(np.unique(origin[chosen])), int(large.sum()))


def split(
    gaussians: Gaussians,
    scales: NDArray[np.float32],  # [N, 3] used in place of gaussians.scales
    pitch: float,
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Rows (P,), means (P, 3) and scales (P, 3) of the parts, no larger than pitch.

    Along an axis of variance s^2 the parts have sigma = pitch and are spaced evenly on [-L, L]. The variance of k such
    positions, L^2 (k + 1) / (3 (k - 1)), supplies the rest of the Gaussian's: s^2 - pitch^2.
    """
    cap = np.float32(pitch)
    reach = np.sqrt(3 * np.maximum(scales.astype(np.float64) ** 2 - pitch**2, 0))
    counts = np.minimum(1 + np.ceil(2 * reach / (SPACING * pitch)), MAX_PARTS).astype(np.intp)
    counts[scales <= cap] = 1
    reach = np.minimum(reach * np.sqrt((counts - 1) / (counts + 1)), (counts - 1) * SPACING * pitch / 2)
    total = counts.prod(axis=1)
    source = np.repeat(np.arange(len(scales)), total)
    number = np.arange(len(source)) - np.repeat(np.cumsum(total) - total, total)
    local = np.empty((len(source), 3))
    for axis in range(3):
        count = counts[source, axis]
        position = number % count
        number = number // count
        local[:, axis] = np.where(count > 1, (2 * position / np.maximum(count - 1, 1) - 1) * reach[source, axis], 0)
    axes = axes_of(gaussians.quats)[source].astype(np.float64)  # rows are principal axes
    means = gaussians.means[source] + np.einsum("pa,pax->px", local, axes)
    return source, means.astype(np.float32), np.minimum(scales, cap)[source]
