"""Fits the surface colours after atomising, so that the opaque object looks like the capture.

Geometry is frozen, so a view is linear in the spherical harmonics and the fit is linear least squares: conjugate
gradients on the normal equations, two sparse products per view and step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.fit.view_kernels import ATOMS, blend_bands, spread_bands
from engine.fit.view_weights import ViewWeights
from engine.render.classic import rasterizer as classic
from engine.scene import sh
from engine.scene.atoms import Atoms, SurfaceAtoms
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians
from engine.scene.image import decibels
from engine.threads import for_each

__all__ = ["ShFit", "SurfaceView", "fit_sh", "surface_views", "views_after"]

Float = NDArray[np.float32]

OPAQUE_FROM = 0.95
"""Alpha of the capture from which a pixel shows the object alone. Below it the background shines through, and opaque
atoms must not learn that."""

STEPS = 8
"""Steps of conjugate gradients. On the sample watermelon held-out views reach 28.2, 31.8 and 32.3 dB after 1, 3 and 8;
more steps only overfit the training views."""

TRIAL_STEPS = 3
"""Steps that show how much a degree of spherical harmonics can gain."""

HELD_OUT = 6
"""One view in this many is held out to compare the degrees."""

DEGREE = 1
"""Degree that is tried even if the capture's own is lower: translucent Gaussians shift against each other as the view
changes, and one opaque atom stands for several. Unseen views of captures of degree 0 gain 0.8 dB (donut), 1.2 (guitar)
and 1.8 (tarot box); degree 2 gives 0.1 and 0.4 dB more on the last two and loses 0.9 on the donut."""

WORTH_DB = 0.1
"""dB. The lowest degree at most this much worse than the best is taken."""

PRIOR_WEIGHT = 1e-2
"""Weight, in pixels, of keeping an atom's captured colour, so that atoms in no view keep theirs. Ten times more or less
changes held-out views by 0.2 dB."""


@dataclass(frozen=True)
class SurfaceView:
    """The capture from one camera, and the weights with which the atoms form that picture."""

    camera: Camera
    weights: ViewWeights
    target: Float
    """(H, W, 3). The capture over white. Range [0, 1]."""
    opaque: NDArray[np.bool_]
    """(H, W). Pixels where the capture hides its background; the others are no evidence of the surface."""


@dataclass(frozen=True)
class ShFit:
    """Atoms with fitted colours."""

    atoms: Atoms
    degree: int
    """Degree of the fitted spherical harmonics: the lowest within WORTH_DB of the best."""
    held_out: tuple[float, float]
    """PSNR in dB over the opaque pixels of held-out views, before and after."""


def surface_views(
    atoms: Atoms,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    keep: int,
    progress: Callable[[float], None] = lambda part: None,
) -> list[SurfaceView]:
    """The capture from each camera, with the atoms' weights truncated to `keep` entries per pixel."""
    result = []
    for index, camera in enumerate(cameras):
        image = classic.render(gaussians, camera, (1.0, 1.0, 1.0))
        weights = ViewWeights.surface(atoms, camera).truncated(keep)
        result.append(SurfaceView(camera, weights, np.clip(image.rgb, 0, 1), image.alpha > OPAQUE_FROM))
        progress((index + 1) / len(cameras))
    return result


def views_after(
    before: Atoms,
    after: Atoms,
    views: Sequence[SurfaceView],
    keep: int,
    progress: Callable[[float], None] = lambda part: None,
) -> list[SurfaceView]:
    """The views of `before` as views of `after`, which has another skin on the same inside: the same pictures of the
    capture, with other weights only if an atom has another shape or place."""
    one, other = before.surface, after.surface
    if all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("means", "scales", "quats")):
        progress(1.0)
        return list(views)
    result = []
    for index, view in enumerate(views):
        result.append(replace(view, weights=ViewWeights.surface(after, view.camera).truncated(keep)))
        progress((index + 1) / len(views))
    return result


def fit_sh(atoms: Atoms, views: Sequence[SurfaceView], progress: Callable[[float], None] = lambda part: None) -> ShFit:
    """Fits the spherical harmonics of the surface atoms to at least two views, at the lowest degree that suffices.

    Interior atoms and all geometry stay. Atoms in no view keep their colours. Bit-equal for the same input.
    """
    assert len(views) > 1, len(views)
    # Below black the clamp hides every change, so the fit begins at black.
    start = atoms.surface.sh.copy()
    start[:, 0] = np.maximum(start[:, 0], sh.rgb_to_sh(np.zeros(3, np.float32)))
    held_out = views[::HELD_OUT]
    training = [view for index, view in enumerate(views) if index % HELD_OUT]
    given = start.shape[1]
    highest = max(atoms.surface.sh_degree, DEGREE)
    start = np.pad(start, ((0, 0), (0, max((highest + 1) ** 2 - given, 0)), (0, 0)))
    trials, figures = [], []
    for degree in range(highest + 1):
        trials.append(conjugate_gradients(training, atoms, start[:, : (degree + 1) ** 2], TRIAL_STEPS))
        figures.append(decibels(mean_squared_error(held_out, atoms, trials[-1])))
        progress(0.7 * (degree + 1) / (highest + 1))
    degree = next(d for d, figure in enumerate(figures) if figure >= max(figures) - WORTH_DB)
    before = decibels(mean_squared_error(held_out, atoms, atoms.surface.sh))
    if before >= figures[degree]:  # an opaque scan already has its best colours
        progress(1.0)
        return ShFit(atoms, atoms.surface.sh_degree, (before, before))
    s = atoms.surface
    surface = SurfaceAtoms(s.means, s.scales, s.quats, conjugate_gradients(views, atoms, trials[degree], STEPS))
    progress(1.0)
    return ShFit(Atoms(surface, atoms.interior, atoms.pitch), degree, (before, figures[degree]))


def conjugate_gradients(views: Sequence[SurfaceView], atoms: Atoms, start: Float, steps: int) -> Float:
    """(S, K, 3). Preconditioned conjugate gradients on sum over views |W B x - r|^2 + PRIOR_WEIGHT |x|^2.

    r is the residual of the start, x the change, and B the basis in each atom's viewing direction. The fit ignores the
    clamp at 0, which affects near-black atoms only.
    """
    bands = start.shape[1]
    residual = np.zeros_like(start)
    weight = np.full((len(start), bands, 1), PRIOR_WEIGHT, np.float32)
    bases = [_basis(view, bands) for view in views]
    for view, basis in zip(views, bases, strict=True):
        add_transposed(view, basis, view.target - predict(view, atoms, start), residual)
        opaque = np.repeat(view.opaque.reshape(-1, 1), 3, axis=1).astype(np.float32)
        total = view.weights.apply_transposed_used(opaque)[: len(basis)]
        weight[view.weights.used[: len(basis)], :, 0] += total[:, :1] * basis**2
    change = np.zeros_like(start)
    scaled = residual / weight
    direction = scaled.copy()
    power = float(np.vdot(residual, scaled))
    for _ in range(steps):
        if power <= 0:
            break
        product = PRIOR_WEIGHT * direction
        for view, basis in zip(views, bases, strict=True):
            add_transposed(view, basis, apply(view, basis, direction), product)
        step = power / float(np.vdot(direction, product))
        change += np.float32(step) * direction
        residual -= np.float32(step) * product
        scaled = residual / weight
        next_power = float(np.vdot(residual, scaled))
        direction = scaled + np.float32(next_power / power) * direction
        power = next_power
    return start + change


def _basis(view: SurfaceView, bands: int) -> Float:
    """(U, K). The basis in the viewing directions of a view's surface atoms, which are its first used columns."""
    return sh.basis(view.weights.directions, round(bands**0.5) - 1).astype(np.float32)


def apply(view: SurfaceView, basis: Float, coefficients: Float) -> Float:
    """(H, W, 3) = W B x."""
    colours = np.zeros((len(view.weights.used), 3), np.float32)
    for_each(blend_bands, -(-len(basis) // ATOMS), view.weights.used, basis, coefficients, colours)
    return view.weights.apply_used(colours).reshape(*view.opaque.shape, 3)


def add_transposed(view: SurfaceView, basis: Float, image: Float, total: Float) -> None:
    """Adds B^T W^T of the opaque pixels of a picture (H, W, 3) to total (S, K, 3)."""
    opaque = np.where(view.opaque[..., None], image, 0).astype(np.float32, copy=False)
    colours = view.weights.apply_transposed_used(opaque.reshape(-1, 3))
    for_each(spread_bands, -(-len(basis) // ATOMS), view.weights.used, basis, colours, total)


def predict(view: SurfaceView, atoms: Atoms, coefficients: Float) -> Float:
    """(H, W, 3). The view with these coefficients (S, K, 3), over white."""
    used, basis = view.weights.used, _basis(view, coefficients.shape[1])
    colours = np.empty((len(used), 3), np.float32)
    for_each(blend_bands, -(-len(basis) // ATOMS), used, basis, coefficients, colours)
    colours[: len(basis)] = np.maximum(0.5 + colours[: len(basis)], 0)
    colours[len(basis) :] = atoms.interior.rgb[used[len(basis) :] - view.weights.surface_count]
    uncovered = 1 - view.weights.alpha.reshape(*view.opaque.shape, 1)
    return view.weights.apply_used(colours).reshape(*view.opaque.shape, 3) + uncovered


def mean_squared_error(views: Sequence[SurfaceView], atoms: Atoms, coefficients: Float) -> float:
    """Mean squared error over the opaque pixels of all views."""
    total, count = 0.0, 0
    for view in views:
        difference = (predict(view, atoms, coefficients) - view.target)[view.opaque]
        total += float(np.sum(difference.astype(np.float64) ** 2))
        count += difference.size
    return total / max(count, 1)
