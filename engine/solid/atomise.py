"""Turns Gaussians into small opaque surface atoms (paper, section 3.4)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.kernel_field import axes_of
from engine.scene.atoms import SurfaceAtoms
from engine.scene.camera import cameras_around
from engine.scene.gaussians import Gaussians
from engine.scene.morton import morton_order
from engine.solid.contribution import contributions
from engine.solid.denoise_capture import WALL_OPACITY
from engine.solid.find_body import Enclosure
from engine.solid.skin_holes import patch_holes

__all__ = ["Atomised", "atomise"]

MIN_OPACITY = 0.04
"""Opacity under which a Gaussian is haze whatever its size: seventeen in a row still let half of the light through."""

MIN_CONTRIBUTION = 0.02
"""Opacity that compositing leaves a Gaussian in its best view, under which it is not part of the picture. On a capture
of a donut this holds for a third of the Gaussians: drawn opaque, they would only mix their colours into the skin."""

HAZE_OPACITY = 0.15
"""Opacity under which a Gaussian larger than the pitch is haze: in compositing it never hides what is behind it."""

UP = np.array([0.0, 0.0, 1.0])
"""Axis of the views from all around; any would do."""

VIEWS, VIEW_SIZE = 24, 192
"""Views of the capture for the contributions, and their pixels along an edge."""

MAX_DEPTH = 1.0
"""Pitches under the skin from which an atom is invisible: debris, or the buried part of a thick Gaussian."""

MAX_HEIGHT = 0.75
"""Pitches above the skin from which an atom is off it: a stem, a leaf, a mat, or a floater."""

SHEET_OPACITY = 0.5
"""Opacity field from which an atom off the skin stays: a ray loses 2/5 there, so the capture does show it."""

COVERAGE = 2.0
"""Target for the sum of unit kernels on the skin: with less, random gaps open between the atoms."""

SPACING = 1.6
"""Distance between the parts of a split Gaussian, in their standard deviations: their summed kernels ripple by 8 %."""

MAX_PARTS = 12
"""Most parts along one axis. A Gaussian that would need more belongs to the background and is cut short."""


@dataclass(frozen=True)
class Atomised:
    """Surface atoms, and counts of how the Gaussians became atoms."""

    atoms: SurfaceAtoms
    dropped: int
    """Gaussians left out as haze, floaters or debris inside."""
    split: int
    """Gaussians larger than the pitch, which became several atoms."""


def atomise(gaussians: Gaussians, pitch: float, enclosure: Enclosure | None = None) -> Atomised:
    """Atoms no larger than the pitch (the paper's atomic clipping) and opaque (its uniform opacification).

    A Gaussian of opacity a becomes an atom of at least a times its area across its thin axis, and of more where the
    skin is thin (COVERAGE), so that it hides about as much as before. Gaussians larger than the pitch are split along
    their principal axes into parts with the same mean and variance. With an enclosure, Gaussians are dropped that lie
    under its skin, float off it without hiding anything, or contribute to no view of the capture; holes in the skin are
    patched. The atoms are in Morton order. Bit-equal for the same input.
    """
    assert pitch > 0, pitch
    body = None if enclosure is None else enclosure.body
    haze = (gaussians.opacities < HAZE_OPACITY) & (gaussians.scales.max(axis=1, initial=0) > pitch)
    keep = (gaussians.opacities >= MIN_OPACITY) & ~haze
    if body is not None:  # a thick Gaussian may reach the skin from within without being part of it
        keep &= body.at(gaussians.means) < MAX_DEPTH * pitch
        cameras = cameras_around(body.bounds().mean(0), body.radius, UP, VIEWS, VIEW_SIZE)
        keep &= contributions(gaussians, cameras) >= MIN_CONTRIBUTION
    rows = np.flatnonzero(keep)
    kept = gaussians[rows]
    area = kept.opacities.copy()
    if enclosure is not None and body is not None:
        opacity = body.grid.sample(enclosure.opacity, kept.means)
        area = np.clip(COVERAGE * area / np.maximum(opacity, 1e-6), area, 1)
    scales = kept.scales.copy()
    thin = scales.argmin(axis=1)
    shrink = np.repeat(np.sqrt(area)[:, None], 3, axis=1)
    shrink[np.arange(len(kept)), thin] = 1.0
    scales *= shrink
    large = scales.max(axis=1, initial=0) > pitch
    source, part_means, part_scales = split(kept[large], scales[large], pitch)
    means = np.concatenate([kept.means[~large], part_means])
    origin = np.concatenate([rows[~large], rows[large][source]])
    on_skin = np.ones(len(means), bool)
    if enclosure is not None and body is not None:
        depth, opacity = body.at(means), body.grid.sample(enclosure.opacity, means)
        on_skin = (depth < MAX_DEPTH * pitch) & ((depth > -MAX_HEIGHT * pitch) | (opacity >= SHEET_OPACITY))
    origin = origin[on_skin]
    atoms = SurfaceAtoms(
        means[on_skin],
        np.concatenate([scales[~large], part_scales])[on_skin],
        gaussians.quats[origin],
        gaussians.sh[origin],
    )
    if enclosure is not None:
        patches = patch_holes(atoms, enclosure.shell, enclosure.body, pitch, enclosure.opacity, WALL_OPACITY)
        atoms = SurfaceAtoms(*(np.concatenate([getattr(a, f.name) for a in (atoms, patches)]) for f in fields(atoms)))
    order = morton_order(atoms.means)
    atoms = SurfaceAtoms(*(getattr(atoms, f.name)[order] for f in fields(atoms)))
    return Atomised(atoms, len(gaussians) - len(np.unique(origin)), int(large.sum()))


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
