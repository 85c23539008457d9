"""From a shell of Gaussians to a solid: where the body is, and atoms to fill it (paper, section 3.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.atoms import InteriorAtoms, SurfaceAtoms
from engine.body import Body
from engine.distance import nearest
from engine.enclosed import enclosed
from engine.errors import InputError
from engine.gaussians import Gaussians
from engine.octree import COARSEST, leaf_levels
from engine.opacity_field import Grid, opacity_field
from engine.patches import coverage_at, inwards
from engine.skin import signed_depth

Float = NDArray[np.float32]

__all__ = ["WALL_OPACITY", "Colours", "Found", "fill", "find_body", "without_haze"]

WALL_OPACITY = 0.2
"""The paper's sigma_th: d on a sheet is the sum of the alphas that a ray meets there, and here it loses a quarter
(1 - exp(-0.3)). Captures have skins as thin as that, seen against what lies behind them."""

CORE_OPACITY = float(np.log(2))
"""A wall needs a cell where a ray is half stopped, prod(1 - alpha) <= 1/2 at sum(alpha) = ln 2: mist has none."""

WIDEN = 0.5
"""Cells. Least sigma in the opacity field: a sheet of opacity 1 is then a wall for 0.8 cells on both sides, and walls
of two cells are tight for steps across faces."""

WALL_HALF = 1.2
"""Cells. Half the thickness of the wall that a well covered sheet makes: half a cell times sqrt(2 ln(d / sigma_th)),
0.8 where d = 1, 1.3 where d = 8. The skin is the outside's border, shifted by this."""

HAZE_SIZE = 0.05
"""Of the longest side. A Gaussian longer than this is haze if it is also faint."""
HAZE_OPACITY = 0.1

HUGE = 0.25
"""Of the longest side. Longer than this a Gaussian is background, whatever its opacity."""

OUTLIER = 1.0
"""Of the longest span between the 5th and 95th percentiles of the centres: a stem is not farther than this outside."""

FLOATER = 0.003
"""Of all Gaussians. A separate cluster with fewer of them is a floater: it may not widen the grid."""

COARSE = 64
"""Cells along the longest side of the grid on which clusters are told apart."""

MARGIN = 4
"""Cells around the outermost centres: a wall's own thickness, and a way around it for the flood."""

SMALLEST = 0.01
"""Of the largest hollow. Smaller ones are gaps between leaves or debris, not bodies."""


@dataclass(frozen=True)
class Found:
    """A body, and how it was found."""

    body: Body
    notes: tuple[str, ...] = field(default=())
    """What the user should know: holes that were closed, what was left out. One sentence each."""


def find_body(gaussians: Gaussians, cells: int = 128, name: str = "scene") -> Found:
    """The solid that a shell of Gaussians encloses, on a grid of `cells` cells along the longest side.

    Everything inside of the outermost shell is solid, whatever debris or inner shells the capture holds there: they
    cannot be seen, so they say nothing. A shell that leaks is closed where rays and caps hold a hollow for the inside
    (engine.enclosed). A single sheet (a mat, a leaf) encloses nothing.
    Memory: about 60 bytes a cell, so 0.2 GB for 128 and 1.1 GB for 256, however many Gaussians there are.
    Raises InputError if nothing is enclosed.
    """
    assert cells >= 8, cells
    shell, notes = without_haze(gaussians)
    if len(shell) < 4:
        raise InputError(
            f"{name}: no closed body found; {len(gaussians)} Gaussians are too few, too large or too faint for a skin"
        )
    grid = _grid(shell, cells)
    if grid is None:
        raise InputError(f"{name}: no closed body found; all Gaussians stand at one point")
    cell = grid.cell
    wall = _walls(opacity_field(shell, grid, WIDEN * cell))
    closed, cap_faces = enclosed(wall)
    inside = _bodies(_inner(closed, wall))
    if not inside.any():
        raise InputError(
            f"{name}: no closed body found; the {len(shell)} Gaussians enclose nothing (flat, too open or too thin)"
        )
    depth = signed_depth(inside, shell, grid)
    depth = np.where(_bodies(depth > 0) | (depth <= 0), depth, -np.abs(depth))
    if cap_faces >= 1e-3 * np.count_nonzero(inside ^ ndimage.binary_erosion(inside)):
        skin_faces = np.count_nonzero(inside) - np.count_nonzero(ndimage.binary_erosion(inside))
        notes.append(f"the shell is open: holes, {cap_faces / (cap_faces + skin_faces):.1%} of its skin, were closed")
    return Found(Body(grid.origin, cell, np.ascontiguousarray(depth, np.float32)), tuple(notes))


def _grid(gaussians: Gaussians, cells: int) -> Grid | None:
    """A grid around the centres with this many cells along their longest side; None if they all coincide."""
    low, high = gaussians.means.min(0).astype(np.float64), gaussians.means.max(0).astype(np.float64)
    cell = float((high - low).max()) / cells
    if not cell > 0:
        return None
    shape = np.ceil((high - low) / cell).astype(int) + 2 * MARGIN
    return Grid((low + high) / 2 - shape * cell / 2, cell, (int(shape[0]), int(shape[1]), int(shape[2])))


def without_haze(gaussians: Gaussians) -> tuple[Gaussians, list[str]]:
    """The Gaussians that may be part of a skin, and what was left out."""
    finite = np.isfinite(gaussians.means).all(1) & np.isfinite(gaussians.scales).all(1) & (gaussians.opacities > 0)
    gaussians = gaussians[finite]
    if not len(gaussians):
        return gaussians, []
    low, high = np.percentile(gaussians.means, [5, 95], axis=0)
    side = float((high - low).max())
    near = ((gaussians.means >= low - OUTLIER * side) & (gaussians.means <= high + OUTLIER * side)).all(1)
    longest = gaussians.scales.max(1)
    haze = (longest > HUGE * side) | ((longest > HAZE_SIZE * side) & (gaussians.opacities < HAZE_OPACITY))
    shell = gaussians[near & ~haze]
    floaters = _floaters(shell)
    notes = []
    if (near & haze).any():
        notes.append(f"{int((near & haze).sum())} large faint Gaussians (haze) were left out")
    if (~near).any() or floaters.any():
        notes.append(f"{int((~near).sum() + floaters.sum())} Gaussians apart from the object were left out")
    return shell[~floaters], notes


def _floaters(gaussians: Gaussians) -> NDArray[np.bool_]:
    """(N,). Gaussians in clusters that are too small to be a part of the object."""
    grid = _grid(gaussians, COARSE) if len(gaussians) else None
    if grid is None:
        return np.zeros(len(gaussians), bool)
    regions, count = ndimage.label(opacity_field(gaussians, grid, grid.cell) >= WALL_OPACITY)
    cells = np.clip(np.round(grid.index(gaussians.means)).astype(int), 0, np.array(grid.shape) - 1)
    own = regions[tuple(cells.T)]
    sizes = np.bincount(own, minlength=count + 1)
    sizes[0] = 0
    return sizes[own] < min(FLOATER * len(gaussians), sizes.max())


def _walls(opacity: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Cells that are opaque, or a little so and joined to some that are."""
    regions, count = ndimage.label(opacity >= WALL_OPACITY)
    cores = np.zeros(count + 1, bool)
    cores[regions[opacity >= CORE_OPACITY]] = True
    return cores[regions]


def _inner(closed: NDArray[np.bool_], wall: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The closed cells without the outer half of the wall; a cap has no wall and is left where it is."""
    touching = ~closed & ndimage.binary_dilation(wall)
    return closed & (nearest(touching)[0] > WALL_HALF + 0.5)


def _bodies(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The inside without what is thinner than three cells, and without crumbs."""
    core = nearest(~inside)[0] > 1.5
    regions, count = ndimage.label(inside)
    if not count:
        return inside
    sizes = np.bincount(regions[core], minlength=count + 1)
    sizes[0] = 0
    keep = (sizes >= max(8, SMALLEST * sizes.max())) & (sizes > 0)
    opened = nearest(core & keep[regions])[0] <= 2.0
    return inside & opened & keep[regions]


UNDER_SKIN = 0.75
"""Sigmas. Least depth of an interior atom: its half height, 1.18 sigmas, then stays behind the skin's own atoms."""

JITTER = 0.2
"""Pitches. Hides the lattice from cuts along it, and leaves the sum of the weights above half everywhere inside."""

COVERED = 0.25
"""Greatest weight of a surface atom at the skin above an interior atom, from which it cannot be seen."""


Colours = Callable[[NDArray[np.floating]], Float]
"""Colours (N, 3) at world points (N, 3), also a little outside of the body."""


def fill(
    body: Body, pitch: float, seed: int = 0, surface: SurfaceAtoms | None = None, colours: Colours | None = None
) -> InteriorAtoms:
    """Spheres on a cubic lattice, one for each cell whose centre lies inside the body; sigma is half the spacing.

    Without `colours` they are grey and all alike: count times pitch^3 is the body's volume, and the weights add up to
    engine.formula.LATTICE_DENSITY (their mean). With `colours` they take them, and where those are even one sphere
    stands for 2^3, 4^3 or 8^3 cells (engine.octree), which leaves the sum of the weights as it is.
    Atoms near the skin are pushed under it. With `surface`, those above which its atoms leave a hole come first and
    are counted as exposed; without, none is.
    """
    assert pitch > 0, pitch
    low, high = body.bounds()
    whole = 2**COARSEST  # with colours or without: an adaptive inside then stands on the uniform one's cells
    counts = -(-(np.ceil((high - low) / pitch).astype(int) + 2) // whole) * whole
    start = (low + high) / 2 - counts * pitch / 2
    solid = np.empty(tuple(counts), bool)
    rgb = None if colours is None else np.empty((*counts, 3), np.float32)
    for layer in range(counts[0]):  # one layer at a time: a grid of points takes six times the grid's memory
        cells = np.stack(np.meshgrid([layer], *map(np.arange, counts[1:]), indexing="ij"), -1)
        centres = start + (cells[0] + 0.5) * pitch
        solid[layer] = body.at(centres) > 0
        if rgb is not None and colours is not None:
            rgb[layer] = colours(centres.reshape(-1, 3)).reshape(*centres.shape)
    levels = np.zeros(solid.shape, np.int8) if rgb is None else leaf_levels(rgb, solid)
    rng = np.random.default_rng(seed)
    means, sigmas = [], []
    for level in range(int(levels.max(initial=0)) + 1):
        size = 2**level
        corners = np.argwhere(((levels == level) & solid)[::size, ::size, ::size]) * size
        centres = start + (corners + size / 2) * pitch
        means.append(centres + rng.uniform(-JITTER, JITTER, centres.shape) * size * pitch)
        sigmas.append(np.full(len(centres), size * pitch / 2, np.float32))
    points, sigma = np.concatenate(means), np.concatenate(sigmas)
    points = _pushed_under(body, points, UNDER_SKIN * sigma)
    exposed = 0
    if surface is not None and len(points):
        seen = _seen(body, points, sigma, pitch, surface)
        points, sigma = np.concatenate([points[seen], points[~seen]]), np.concatenate([sigma[seen], sigma[~seen]])
        exposed = int(seen.sum())
    colour = np.full(points.shape, 0.5, np.float32) if colours is None else colours(points).astype(np.float32)
    return InteriorAtoms(points.astype(np.float32), sigma, colour, exposed)


def _pushed_under(body: Body, points: NDArray[np.float64], depth: Float) -> NDArray[np.float64]:
    """The points (N, 3), those nearer to the skin than their `depth` (N,) moved inwards as far as the body allows."""
    points = points.copy()
    for _ in range(3):
        short = np.flatnonzero(body.at(points) < depth)
        if not len(short):
            break
        missing = depth[short] - body.at(points[short])
        points[short] += inwards(body, points[short]) * missing[:, None]
    return points


def _seen(
    body: Body, means: NDArray[np.float64], sigmas: Float, pitch: float, surface: SurfaceAtoms
) -> NDArray[np.bool_]:
    """(N,). Atoms in the outermost layer where the surface atoms do not cover the skin."""
    seen = np.zeros(len(means), bool)
    depth = body.at(means)
    outer = np.flatnonzero(depth < 2 * sigmas)
    into = inwards(body, means[outer])
    skin = means[outer] - into * depth[outer, None]
    seen[outer] = coverage_at(surface, skin, -into, pitch) < COVERED
    return seen
