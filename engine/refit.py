"""Colours for the atoms of a skin, so that the opaque object looks as the capture did (DESIGN, section 4, item 2).

Making Gaussians opaque changes which of them a pixel shows. Geometry stays; a view is then a matrix (engine.
view_weights), and the colours that show the capture best from all around are a linear least-squares problem.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine import classic, opaque
from engine.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.camera import Camera, around
from engine.gaussians import Gaussians
from engine.sh import C0, basis
from engine.view_weights import ViewWeights

__all__ = ["Refitted", "fit_colours", "refit"]

Float = NDArray[np.float32]

VIEWS = 60
HELD_OUT = 8
"""Views of the capture that colours are fitted to, and others that only judge."""

ENTRIES = 16
"""Entries of a pixel that are kept while fitting; what is reported comes from the full renderer."""

ITERATIONS = 30
"""Steps of the solver. The error falls by less than 0.05 dB in the next ten."""

PULL = 0.02
"""Pixels. Weight of an atom's first colour against all that views see of it: it decides where they see next to nothing,
and keeps neighbours that only their sum is seen of from drifting apart."""

GAIN = 0.1
"""dB of the held-out views that a higher degree of the harmonics must bring: less is not seen and not worth its size."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Refitted:
    """Atoms with fitted colours, and how well they show views that were not fitted."""

    atoms: Atoms
    before: float
    """PSNR of the held-out views against the capture before the fit, dB, over white."""
    after: float
    """The same after it."""

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics that the fit needs."""
        return self.atoms.surface.sh_degree


def refit(
    atoms: Atoms,
    gaussians: Gaussians,
    up: NDArray[np.floating],  # [3]
    size: int = 256,
    views: int = VIEWS,
    progress: Progress | None = None,
) -> Refitted:
    """Fits the surface's colours to `views` pictures of the capture, size x size pixels each, over white.

    The harmonics get the least degree, up to the capture's own, that the held-out views gain from. Bit-equal for the
    same input on one machine.
    """
    told = progress or (lambda part: None)
    low, high = atoms.bounds.astype(np.float64)
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    interior = atoms.interior
    hidden = slice(interior.exposed, len(interior))
    seen = replace(atoms, interior=_rows(interior, slice(0, interior.exposed)))
    fitted: list[tuple[ViewWeights, Float]] = []
    for camera in around(centre, radius, up, views, size):
        fitted.append((ViewWeights.surface(seen, camera).truncated(ENTRIES), _target(gaussians, camera)))
        told(0.7 * len(fitted) / views)
    judges = [(camera, _target(gaussians, camera)) for camera in around(centre, radius, up, HELD_OUT, size, turn=71.0)]
    before = best = _judged(seen, judges)
    surface = seen.surface
    for degree in range(gaussians.sh_degree + 1):
        tried = fit_colours(_of_degree(atoms.surface, degree), seen.interior, fitted)
        score = _judged(replace(seen, surface=tried), judges)
        told(0.7 + 0.3 * (degree + 1) / (gaussians.sh_degree + 1))
        if degree > 0 and score < best + GAIN:
            break
        surface, best = tried, score
    inside = InteriorAtoms(
        *(
            np.concatenate([getattr(seen.interior, name), getattr(interior, name)[hidden]])
            for name in ("means", "sigmas", "rgb")
        ),
        exposed=interior.exposed,
    )
    return Refitted(Atoms(surface, inside, atoms.pitch), before, best)


def fit_colours(
    surface: SurfaceAtoms,
    interior: InteriorAtoms,
    views: Sequence[tuple[ViewWeights, NDArray[np.floating]]],
    background: Sequence[float] = (1.0, 1.0, 1.0),
    iterations: int = ITERATIONS,
) -> SurfaceAtoms:
    """The surface with the harmonics, of the degree it has, that show the views' pictures (H, W, 3) best.

    Least squares by accelerated projected gradients (Beck and Teboulle 2009), with a step of its own for each atom:
    one over the sum of its weights, which bounds the curvature because the rows of a view sum to 1 at most. The
    degree-0 colours stay in [0, 1], so that a cut through the skin shows them. What no view sees keeps its colour.
    """
    count, bands = surface.sh.shape[:2]
    first = surface.sh.copy()
    first[:, 0] = np.clip(first[:, 0], -0.5 / C0, 0.5 / C0)
    skins = [view.used[view.used < view.skin] for view, _ in views]
    bases = [basis(view.directions, surface.sh_degree).astype(np.float32) for view, _ in views]
    weight = np.full(count, PULL, np.float32)
    for (view, _), skin in zip(views, skins, strict=True):
        weight[skin] += view.apply_transposed(np.ones((view.height, view.width, 3), np.float32))[skin, 0]
    step = (4 * np.pi / bands / weight)[:, None, None]  # the squares of the basis functions sum to bands / 4 pi
    fitted, ahead, momentum = first, first, 1.0
    for _ in range(iterations):
        slope = PULL * (first - ahead) * np.float32(bands / (4 * np.pi))
        for (view, target), skin, way in zip(views, skins, bases, strict=True):
            colours = np.zeros((view.columns, 3), np.float32)
            colours[skin] = np.maximum(0.5 + np.einsum("nk,nkc->nc", way, ahead[skin]), 0)
            colours[count : count + len(interior)] = interior.rgb
            missing = (1 - view.alpha).reshape(view.height, view.width, 1) * np.asarray(background, np.float32)
            wrong = np.asarray(target, np.float32) - missing - view.apply(colours)
            slope[skin] += way[:, :, None] * view.apply_transposed(wrong)[skin, None]
        moved = ahead + step * slope
        moved[:, 0] = np.clip(moved[:, 0], -0.5 / C0, 0.5 / C0)
        following = (1 + (1 + 4 * momentum**2) ** 0.5) / 2
        ahead = moved + np.float32((momentum - 1) / following) * (moved - fitted)
        fitted, momentum = moved, following
    return replace(surface, sh=fitted.astype(np.float32))


def _target(gaussians: Gaussians, camera: Camera) -> Float:
    return classic.render(gaussians, camera, background=(1.0, 1.0, 1.0)).rgb


def _judged(atoms: Atoms, judges: Sequence[tuple[Camera, Float]]) -> float:
    """PSNR over all pixels of the held-out views, dB."""
    errors = [float(((opaque.render(atoms, camera).rgb - target) ** 2).mean()) for camera, target in judges]
    return float(-10 * np.log10(max(np.mean(errors), 1e-12)))


def _of_degree(surface: SurfaceAtoms, degree: int) -> SurfaceAtoms:
    """The same atoms with harmonics cut off, or filled up with zeros, to this degree."""
    bands = (degree + 1) ** 2
    sh = np.zeros((len(surface), bands, 3), np.float32)
    common = min(bands, surface.sh.shape[1])
    sh[:, :common] = surface.sh[:, :common]
    return replace(surface, sh=sh)


def _rows(interior: InteriorAtoms, rows: slice) -> InteriorAtoms:
    means = interior.means[rows]
    return InteriorAtoms(means, interior.sigmas[rows], interior.rgb[rows], exposed=min(interior.exposed, len(means)))
