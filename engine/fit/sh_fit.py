"""Fits the surface colours after atomising, so that the opaque object looks like the capture.

Geometry is frozen, so a view is linear in the spherical harmonics and the fit is linear least squares: conjugate
gradients on the normal equations, two sparse products per view and step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.fit.view_weights import ViewWeights
from engine.render.classic import rasterizer as classic
from engine.scene import sh
from engine.scene.atoms import Atoms, SurfaceAtoms
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians

__all__ = ["ShFit", "SurfaceView", "fit_sh", "surface_views"]

Float = NDArray[np.float32]

OPAQUE = 0.95
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
"""Tried even if the capture's own degree is lower: translucent Gaussians shift against each other as the view changes,
and one opaque atom stands for several. Unseen views of captures of degree 0 gain 0.8 dB (donut), 1.2 (guitar) and 1.8
(tarot box); degree 2 gives 0.1 and 0.4 dB more on the last two and loses 0.9 on the donut."""

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
        result.append(SurfaceView(camera, weights, np.clip(image.rgb, 0, 1), image.alpha > OPAQUE))
        progress((index + 1) / len(cameras))
    return result


def fit_sh(atoms: Atoms, views: Sequence[SurfaceView], progress: Callable[[float], None] = lambda part: None) -> ShFit:
    """Fits the spherical harmonics of the surface atoms to at least two views, at the lowest degree that does as well.

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
        figures.append(psnr(mean_squared_error(held_out, atoms, trials[-1])))
        progress(0.7 * (degree + 1) / (highest + 1))
    degree = next(d for d, figure in enumerate(figures) if figure >= max(figures) - WORTH_DB)
    before = psnr(mean_squared_error(held_out, atoms, atoms.surface.sh))
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
    for view in views:
        image = predict(view, atoms, start)
        difference = np.where(view.opaque[..., None], view.target - image, 0).astype(np.float32)
        residual += apply_transposed(view, difference, bands)
        rows, basis = visible_basis(view, bands)
        total = view.weights.apply_transposed(np.repeat(view.opaque[..., None], 3, axis=2).astype(np.float32))
        weight[rows, :, 0] += total[rows, :1] * basis**2
    change = np.zeros_like(start)
    scaled = residual / weight
    direction = scaled.copy()
    power = float(np.vdot(residual, scaled))
    for _ in range(steps):
        if power <= 0:
            break
        product = PRIOR_WEIGHT * direction
        for view in views:
            image = apply(view, direction)
            product += apply_transposed(view, np.where(view.opaque[..., None], image, 0), bands)
        step = power / float(np.vdot(direction, product))
        change += np.float32(step) * direction
        residual -= np.float32(step) * product
        scaled = residual / weight
        next_power = float(np.vdot(residual, scaled))
        direction = scaled + np.float32(next_power / power) * direction
        power = next_power
    return start + change


def visible_basis(view: SurfaceView, bands: int) -> tuple[NDArray[np.int32], Float]:
    """Rows (n,) of the surface atoms in a view, and the basis (n, K) in their viewing directions."""
    used = view.weights.used
    rows = used[used < view.weights.surface_count]
    return rows, sh.basis(view.weights.directions, round(bands**0.5) - 1).astype(np.float32)


def apply(view: SurfaceView, coefficients: Float) -> Float:
    """(H, W, 3) = W B x."""
    rows, basis = visible_basis(view, coefficients.shape[1])
    colours = np.zeros((view.weights.columns, 3), np.float32)
    colours[rows] = np.einsum("nk,nkc->nc", basis, coefficients[rows])
    return view.weights.apply(colours)


def apply_transposed(view: SurfaceView, image: Float, bands: int) -> Float:
    """(S, K, 3) = B^T W^T of a picture (H, W, 3)."""
    rows, basis = visible_basis(view, bands)
    colours = view.weights.apply_transposed(image)[rows]
    coefficients = np.zeros((view.weights.surface_count, bands, 3), np.float32)
    coefficients[rows] = basis[:, :, None] * colours[:, None, :]
    return coefficients


def predict(view: SurfaceView, atoms: Atoms, coefficients: Float) -> Float:
    """(H, W, 3). The view with these coefficients (S, K, 3), over white."""
    rows, basis = visible_basis(view, coefficients.shape[1])
    colours = np.zeros((view.weights.columns, 3), np.float32)
    first = view.weights.surface_count
    colours[first : first + len(atoms.interior)] = atoms.interior.rgb
    colours[rows] = np.maximum(0.5 + np.einsum("nk,nkc->nc", basis, coefficients[rows]), 0)
    uncovered = 1 - view.weights.alpha.reshape(*view.opaque.shape, 1)
    return view.weights.apply(colours) + uncovered


def mean_squared_error(views: Sequence[SurfaceView], atoms: Atoms, coefficients: Float) -> float:
    """Mean squared error over the opaque pixels of all views."""
    total, count = 0.0, 0
    for view in views:
        difference = (predict(view, atoms, coefficients) - view.target)[view.opaque]
        total += float(np.sum(difference.astype(np.float64) ** 2))
        count += difference.size
    return total / max(count, 1)


def psnr(mse: float) -> float:
    """PSNR in dB of a mean squared error, for a range of 1."""
    return float("inf") if mse <= 0 else -10 * float(np.log10(mse))
