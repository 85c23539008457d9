"""From Gaussians to opaque surface atoms (paper, section 3.4): small, and every one of them solid."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.kernel_field import axes_of
from engine.scene.atoms import SurfaceAtoms
from engine.scene.camera import around
from engine.scene.gaussians import Gaussians
from engine.scene.morton import morton_order
from engine.solid.contribution import shown
from engine.solid.denoise_capture import WALL_OPACITY
from engine.solid.find_body import Enclosure
from engine.solid.skin_holes import patches

__all__ = ["Atomised", "atomise"]

FAINT = 0.04
"""Opacity under which a Gaussian is haze whatever its size: sixty of them in a row let half of the light through."""

HIDDEN = 0.02
"""Opacity that the rest of the capture leaves a Gaussian in its best view, under which it is not part of the picture.
On a capture of a donut a third of the Gaussians are: drawn opaque, they would only mix their colours into the skin."""

HAZE_OPACITY = 0.15
"""Opacity under which a Gaussian larger than the pitch is haze: compositing never lets it hide what is behind it."""

UP = np.array([0.0, 0.0, 1.0])
"""Views from all around need an axis, no matter which."""

VIEWS, VIEW_SIZE = 24, 192
"""Views of the capture, and their pixels along an edge, in which it shows what it is made of."""

DEEPEST = 1.0
"""Pitches under the skin from which an atom can no longer be seen: debris, or the buried part of a fat Gaussian."""

HIGHEST = 0.75
"""Pitches above the skin from which an atom is off it: a stem, a leaf, a mat, or a floater."""

SHEET_OPACITY = 0.5
"""Opacity field from which an atom off the skin stays: a ray loses 2/5 there, so the capture shows something."""

COVERAGE = 2.0
"""Sum of unit kernels on the skin that is aimed at: where it is less, chance leaves holes between the atoms."""

SPACING = 1.6
"""Between the parts of a split Gaussian, in their standard deviations: the sum of unit kernels then ripples by 8 %."""

MOST_PARTS = 12
"""Along one axis. A Gaussian that would need more is a background's; it ends where its parts end."""


@dataclass(frozen=True)
class Atomised:
    """Surface atoms, and what became of the Gaussians."""

    atoms: SurfaceAtoms
    dropped: int
    """Gaussians that were haze, floaters or debris inside."""
    split: int
    """Gaussians that were larger than the pitch and became several atoms."""
    patched: int = 0
    """Atoms that were added where the others leave a hole in the skin."""


def atomise(gaussians: Gaussians, pitch: float, enclosure: Enclosure | None = None) -> Atomised:
    """Atoms no larger than the pitch (the paper's atomic clipping) and opaque (its uniform opacification).

    A Gaussian of opacity a becomes an atom of at least a times its area across its thin axis, and of more where the
    skin is thin (COVERAGE): what it hides stays about the same. Larger ones are split along their principal axes into
    parts with the same mean and variance. With an enclosure, what lies under its skin is dropped, and so is what floats
    off it without hiding anything, and what has no weight in any view of the capture; holes that this or the capture
    leaves in the skin are patched. The atoms stand in Morton order. Bit-equal for the same input.
    """
    assert pitch > 0, pitch
    body = None if enclosure is None else enclosure.body
    haze = (gaussians.opacities < HAZE_OPACITY) & (gaussians.scales.max(axis=1, initial=0) > pitch)
    keep = (gaussians.opacities >= FAINT) & ~haze
    if body is not None:  # the end of a fat Gaussian that reaches the skin from within is no part of the skin
        keep &= body.at(gaussians.means) < DEEPEST * pitch
        cameras = around(body.bounds().mean(0), body.radius, UP, VIEWS, VIEW_SIZE)
        keep &= shown(gaussians, cameras) >= HIDDEN
    keep = np.flatnonzero(keep)
    kept = gaussians[keep]
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
    whole, parts = kept[~large], kept[large]
    source, means, part_scales = split(parts, scales[large], pitch)
    means = np.concatenate([whole.means, means])
    origin = np.concatenate([keep[~large], keep[large][source]])
    on_skin = np.ones(len(means), bool)
    if enclosure is not None and body is not None:
        depth, opacity = body.at(means), body.grid.sample(enclosure.opacity, means)
        on_skin = (depth < DEEPEST * pitch) & ((depth > -HIGHEST * pitch) | (opacity >= SHEET_OPACITY))
    origin = origin[on_skin]
    atoms = SurfaceAtoms(
        means[on_skin],
        np.concatenate([scales[~large], part_scales])[on_skin],
        gaussians.quats[origin],
        gaussians.sh[origin],
    )
    dropped, patched = len(gaussians) - len(np.unique(origin)), 0
    if enclosure is not None:
        more = patches(atoms, enclosure.shell, enclosure.body, pitch, enclosure.opacity, WALL_OPACITY)
        patched = len(more)
        atoms = SurfaceAtoms(*(np.concatenate([getattr(a, f.name) for a in (atoms, more)]) for f in fields(atoms)))
    order = morton_order(atoms.means)
    atoms = SurfaceAtoms(*(getattr(atoms, f.name)[order] for f in fields(atoms)))
    return Atomised(atoms, dropped, int(large.sum()), patched)


def split(
    gaussians: Gaussians,
    scales: NDArray[np.float32],  # [N, 3] to use in place of the Gaussians' own
    pitch: float,
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Rows (P,), means (P, 3) and scales (P, 3) of the parts, no larger than pitch.

    Along an axis of variance s^2 the parts have sigma = pitch and stand evenly on [-L, L]. The variance of k such
    places, L^2 (k + 1) / (3 (k - 1)), is what remains of the whole's: s^2 - pitch^2.
    """
    cap = np.float32(pitch)
    reach = np.sqrt(3 * np.maximum(scales.astype(np.float64) ** 2 - pitch**2, 0))
    counts = np.minimum(1 + np.ceil(2 * reach / (SPACING * pitch)), MOST_PARTS).astype(np.intp)
    counts[scales <= cap] = 1
    reach = np.minimum(reach * np.sqrt((counts - 1) / (counts + 1)), (counts - 1) * SPACING * pitch / 2)
    total = counts.prod(axis=1)
    source = np.repeat(np.arange(len(scales)), total)
    number = np.arange(len(source)) - np.repeat(np.cumsum(total) - total, total)
    local = np.empty((len(source), 3))
    for axis in range(3):
        count = counts[source, axis]
        place = number % count
        number = number // count
        local[:, axis] = np.where(count > 1, (2 * place / np.maximum(count - 1, 1) - 1) * reach[source, axis], 0)
    axes = axes_of(gaussians.quats)[source].astype(np.float64)  # rows are principal axes
    means = gaussians.means[source] + np.einsum("pa,pax->px", local, axes)
    return source, means.astype(np.float32), np.minimum(scales, cap)[source]
