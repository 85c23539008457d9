"""Surface colours fitted anew after atomising, so that the opaque object looks like the capture (DESIGN, section 4.2).

Geometry is frozen, so a view is linear in the spherical harmonics and the fit is linear least squares: conjugate
gradients on the normal equations, each step two sparse products a view.
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

__all__ = ["Refit", "SurfaceView", "refit", "surface_views"]

Float = NDArray[np.float32]

OPAQUE = 0.95
"""Alpha of the input from which a pixel shows the object alone. Below it the background shines through, which opaque
atoms must not learn."""

STEPS = 8
"""Of conjugate gradients. On the sample watermelon held-out views reach 28.2, 31.8 and 32.3 dB after 1, 3 and 8; more
steps only fit the fitted views."""

TRIAL_STEPS = 3
"""Enough to see how much a degree of spherical harmonics can win."""

HELD_OUT = 6
"""One view in this many judges the degrees and is not fitted for that."""

WORTH_DB = 0.1
"""A degree is kept where the next lower one is worse by more than this."""

FAITH = 1e-2
"""Weight of an atom's own colour, in pixels: what no view shows stays as it was captured. Ten times more or less moves
held-out views by 0.2 dB."""


@dataclass(frozen=True)
class SurfaceView:
    """The input from one side, and how the atoms make that picture."""

    camera: Camera
    weights: ViewWeights
    target: Float
    """(H, W, 3). The input 3DGS as it was captured, over white. Range [0, 1]."""
    opaque: NDArray[np.bool_]
    """(H, W). Pixels where the input hides its background; the others are no evidence of the surface."""


@dataclass(frozen=True)
class Refit:
    """Atoms with fitted colours."""

    atoms: Atoms
    degree: int
    """Of the spherical harmonics that were kept: the least that keeps the loss."""
    held_out: tuple[float, float]
    """PSNR in dB over the opaque pixels of views that were not fitted, before and after."""


def surface_views(
    atoms: Atoms,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    keep: int,
    progress: Callable[[float], None] = lambda part: None,
) -> list[SurfaceView]:
    """The input seen by each camera; the atoms' weights truncated to `keep` entries a pixel."""
    result = []
    for index, camera in enumerate(cameras):
        seen = classic.render(gaussians, camera, (1.0, 1.0, 1.0))
        weights = ViewWeights.surface(atoms, camera).truncated(keep)
        result.append(SurfaceView(camera, weights, np.clip(seen.rgb, 0, 1), seen.alpha > OPAQUE))
        progress((index + 1) / len(cameras))
    return result


def refit(atoms: Atoms, views: Sequence[SurfaceView], progress: Callable[[float], None] = lambda part: None) -> Refit:
    """Spherical harmonics of the surface atoms fitted to the views, of the least degree that keeps the loss.

    Interior atoms and all geometry stay. Atoms that no view shows keep their colours. Bit-equal for the same input.
    """
    assert len(views) > 1, len(views)
    # Where the colour is under black the clamp hides every change, so the fit begins at black.
    start = atoms.surface.sh.copy()
    start[:, 0] = np.maximum(start[:, 0], sh.rgb_to_sh(np.zeros(3, np.float32)))
    judges = views[::HELD_OUT]
    fitted = [view for index, view in enumerate(views) if index % HELD_OUT]
    highest = atoms.surface.sh_degree
    trials, figures = [], []
    for degree in range(highest + 1):
        trials.append(fit(fitted, atoms, start[:, : (degree + 1) ** 2], TRIAL_STEPS))
        figures.append(db(error(judges, atoms, trials[-1])))
        progress(0.7 * (degree + 1) / (highest + 1))
    degree = next(d for d, figure in enumerate(figures) if figure >= max(figures) - WORTH_DB)
    before = db(error(judges, atoms, atoms.surface.sh))
    if before >= figures[degree]:  # a scan that is opaque already shows itself best
        progress(1.0)
        return Refit(atoms, highest, (before, before))
    s = atoms.surface
    surface = SurfaceAtoms(s.means, s.scales, s.quats, fit(views, atoms, trials[degree], STEPS))
    progress(1.0)
    return Refit(Atoms(surface, atoms.interior, atoms.pitch), degree, (before, figures[degree]))


def fit(views: Sequence[SurfaceView], atoms: Atoms, start: Float, steps: int) -> Float:
    """(S, K, 3). Preconditioned conjugate gradients on sum over views |W B x - r|^2 + FAITH |x - start|^2.

    r is the residual of the start, x the change; B the basis in each atom's viewing direction. The clamp at 0 is left
    out of the fit, as it binds for near-black atoms alone.
    """
    bands = start.shape[1]
    residual = np.zeros_like(start)
    weight = np.full((len(start), bands, 1), FAITH, np.float32)
    for view in views:
        shown = picture(view, atoms, start)
        wrong = np.where(view.opaque[..., None], view.target - shown, 0).astype(np.float32)
        residual += backward(view, wrong, bands)
        rows, basis = lit(view, bands)
        seen = view.weights.apply_transposed(np.repeat(view.opaque[..., None], 3, axis=2).astype(np.float32))
        weight[rows, :, 0] += seen[rows, :1] * basis**2
    change = np.zeros_like(start)
    scaled = residual / weight
    direction = scaled.copy()
    power = float(np.vdot(residual, scaled))
    for _ in range(steps):
        if power <= 0:
            break
        image = FAITH * direction
        for view in views:
            shown = forward(view, direction)
            image += backward(view, np.where(view.opaque[..., None], shown, 0), bands)
        step = power / float(np.vdot(direction, image))
        change += np.float32(step) * direction
        residual -= np.float32(step) * image
        scaled = residual / weight
        next_power = float(np.vdot(residual, scaled))
        direction = scaled + np.float32(next_power / power) * direction
        power = next_power
    return start + change


def lit(view: SurfaceView, bands: int) -> tuple[NDArray[np.int32], Float]:
    """Rows (n,) of the surface atoms that a view shows, and the basis (n, K) in their directions."""
    used = view.weights.used
    rows = used[used < view.weights.skin]
    return rows, sh.basis(view.weights.directions, round(bands**0.5) - 1).astype(np.float32)


def forward(view: SurfaceView, coefficients: Float) -> Float:
    """(H, W, 3) = W B x."""
    rows, basis = lit(view, coefficients.shape[1])
    colours = np.zeros((view.weights.columns, 3), np.float32)
    colours[rows] = np.einsum("nk,nkc->nc", basis, coefficients[rows])
    return view.weights.apply(colours)


def backward(view: SurfaceView, wrong: Float, bands: int) -> Float:
    """(S, K, 3) = B^T W^T of a picture (H, W, 3)."""
    rows, basis = lit(view, bands)
    colours = view.weights.apply_transposed(wrong)[rows]
    gradient = np.zeros((view.weights.skin, bands, 3), np.float32)
    gradient[rows] = basis[:, :, None] * colours[:, None, :]
    return gradient


def picture(view: SurfaceView, atoms: Atoms, coefficients: Float) -> Float:
    """(H, W, 3). What the view shows with these coefficients (S, K, 3), over white."""
    rows, basis = lit(view, coefficients.shape[1])
    colours = np.zeros((view.weights.columns, 3), np.float32)
    skin = view.weights.skin
    colours[skin : skin + len(atoms.interior)] = atoms.interior.rgb
    colours[rows] = np.maximum(0.5 + np.einsum("nk,nkc->nc", basis, coefficients[rows]), 0)
    uncovered = 1 - view.weights.alpha.reshape(*view.opaque.shape, 1)
    return view.weights.apply(colours) + uncovered


def error(views: Sequence[SurfaceView], atoms: Atoms, coefficients: Float) -> float:
    """Mean squared error over the opaque pixels of all views."""
    total, count = 0.0, 0
    for view in views:
        wrong = (picture(view, atoms, coefficients) - view.target)[view.opaque]
        total += float(np.sum(wrong.astype(np.float64) ** 2))
        count += wrong.size
    return total / max(count, 1)


def db(mse: float) -> float:
    """PSNR for a range of one."""
    return float("inf") if mse <= 0 else -10 * float(np.log10(mse))
