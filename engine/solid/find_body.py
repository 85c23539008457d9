"""The solid that a shell of Gaussians encloses (paper, section 3.1)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body, Grid
from engine.solid.denoise_capture import WALL_OPACITY, grid_around, without_haze
from engine.solid.distance_transform import within
from engine.solid.enclosure import enclosed_cells
from engine.solid.opacity_field import opacity_field
from engine.solid.signed_distance import signed_depth
from engine.threads import cores

__all__ = ["Enclosure", "find_body"]

CORE_OPACITY = float(np.log(2))
"""A wall needs a cell that stops half of a ray, prod(1 - alpha) <= 1/2 at sum(alpha) = ln 2; mist has no such cell."""

WIDEN = 0.5
"""Cells. Least sigma in the opacity field: a sheet of opacity 1 is then a wall for 0.8 cells on both sides, and a wall
two cells thick lets no path of face neighbours through."""

WALL_HALF = 1.2
"""Cells. Half the thickness of the wall of a well covered sheet: half a cell times sqrt(2 ln(d / sigma_th)), 0.8 at
d = 1, 1.3 at d = 8. The skin is the border of the outside, shifted inwards by this."""

BORDER = 2
"""Cells. A border of the grid this wide is outside: Gaussians wider than its margin reach beyond it, and the body must
not. The skin is found at least WALL_HALF inwards of it, and moved outwards again by at most 1.5."""

SKIN = 3.0
"""Cells. Farther out than this from the body nothing is part of its skin: a wall is less than three cells thick."""

MIN_SIZE = 0.01
"""Share of the largest hollow's cells. Smaller hollows are gaps between leaves or debris, not bodies."""


GAIN = 0.1
"""Share of the Gaussians. There were gaps if this many more lie at the skin once Gaussians reach their neighbours, and
the share of caps besides: whole captures gain 0.06 at most, or as much as is capped, as a guitar whose strings are
joined to its body; thinned ones of which a part or nothing was found gain 0.13 to 1."""

CAPPED = 0.03
"""Share of the skin that caps close from which they may close gaps. There were gaps if less than half of it is left
once Gaussians reach their neighbours: a hole stays open. Caps close at most 0.01 of four whole captures, and up to 0.23
of these thinned to a third."""

NEIGHBOURS, REACHES = 6, (0.7, 1.0)
"""Number of neighbours around a Gaussian of a skin, and the least standard deviation that it gets, over the distance to
the farthest of them; the second if caps still close GAIN of the skin with the first. Eight captures thinned at random
to a tenth enclose 0.96 to 1.10 of what they did with 0.7, with 0.5 0.68 to 1.01, with 1 1.04 to 1.5; but a box with 0.7
0.6 on grids that are fine enough for its gaps, with 1 1.04. Whole captures of thin things grow, so it is not always
done."""


@dataclass(frozen=True)
class Enclosure:
    """The body that a capture encloses, and the shell that encloses it."""

    body: Body
    shell: Gaussians
    """The capture without haze."""
    opacity: NDArray[np.float32]
    """(X, Y, Z). Opacity field of the shell on the body's grid, no Gaussian thinner than WIDEN cells."""
    notes: tuple[str, ...] = field(default=())
    """What the user should know, one sentence each: holes that were closed, Gaussians that were left out."""


def find_body(gaussians: Gaussians, cells: int = 128, name: str = "scene") -> Enclosure:
    """The solid that a shell of Gaussians encloses, on a grid of `cells` cells along the longest side.

    Everything inside the outermost shell is solid: debris and inner shells were never visible, so they are no evidence.
    A leaking shell is closed where rays and caps find a hollow to be inside (engine.solid.enclosure). One with gaps all
    over, such as a thinned capture, is closed by widening its Gaussians to reach their neighbours. A single sheet (a
    mat, a leaf) encloses nothing. Memory: about 60 bytes per cell, so 0.2 GB for 128 and 1.1 GB for 256, whatever the
    number of Gaussians. Raises InputError if nothing is enclosed.
    """
    assert cells >= 8, cells
    shell, notes = without_haze(gaussians)
    if len(shell) < 4:
        raise InputError(
            f"{name}: no closed body found; {len(gaussians)} Gaussians are too few, too large or too faint for a skin"
        )
    grid = grid_around(shell, cells)
    if grid is None:
        raise InputError(f"{name}: no closed body found; all Gaussians stand at one point")
    found = _enclosed(shell, shell, grid)
    part, capped, with_gaps = _part_of_skin(shell, found, grid), found.capped if found else 0.0, False
    for reach in REACHES:
        if capped <= GAIN if with_gaps else capped <= CAPPED and part >= 1 - GAIN:
            break
        wide = _reaching_neighbours(shell, reach)
        closer = _enclosed(wide, shell, grid)
        if closer is None:
            break
        there = _part_of_skin(shell, closer, grid)
        grows, closes = there > part + GAIN + closer.capped, capped > max(CAPPED, 2 * closer.capped)
        if not (grows or closes) or _are_buried(wide, closer, grid):
            break
        found, part, capped, with_gaps = closer, there, closer.capped, True
    if with_gaps:
        notes.append("there are gaps between its Gaussians: each was taken to reach its neighbours")
    if found is None:
        raise InputError(
            f"{name}: no closed body found; the {len(shell)} Gaussians enclose nothing (flat, too open or too thin)"
        )
    opacity, depth = found.opacity, found.depth
    if found.capped >= 1e-3:
        notes.append(f"the shell is open: holes, {found.capped:.1%} of its skin, were closed")
    enclosing = float((depth[opacity >= CORE_OPACITY] > -SKIN * grid.cell).mean())
    if enclosing < 0.5:
        notes.append(f"only {enclosing:.0%} of what is shown encloses an inside; the rest is a skin without one")
    body = Body(grid, np.ascontiguousarray(depth))
    return Enclosure(body, shell, opacity, tuple(notes))


class _Found(NamedTuple):
    """What a shell encloses."""

    opacity: NDArray[np.float32]
    """(X, Y, Z). The field whose walls enclose it."""
    depth: NDArray[np.float32]
    """(X, Y, Z). Depth below the skin, world units."""
    capped: float
    """Share of the skin that caps close. Range [0, 1]."""


def _enclosed(walls: Gaussians, shell: Gaussians, grid: Grid) -> _Found | None:
    """What `walls` enclose below the skin of a shell; None if nothing."""
    opacity = opacity_field(walls, grid, WIDEN * grid.cell)
    wall = _walls(opacity)
    closed, cap_faces = enclosed_cells(wall)
    inside = _drop_fragments(_trim_outer_wall(closed, wall))
    if not inside.any():
        return None
    depth = signed_depth(inside, shell, grid)
    depth = np.where(_drop_fragments(depth > 0) | (depth <= 0), depth, -np.abs(depth)).astype(np.float32)
    skin_cells = np.count_nonzero(inside ^ ndimage.binary_erosion(inside))
    return _Found(opacity, depth, cap_faces / (cap_faces + skin_cells))


def _part_of_skin(shell: Gaussians, found: _Found | None, grid: Grid) -> float:
    """Share of the shell's Gaussians at the skin of what was found, or below it."""
    return 0.0 if found is None else float((Body(grid, found.depth).at(shell.means) > -SKIN * grid.cell).mean())


def _are_buried(wide: Gaussians, found: _Found, grid: Grid) -> bool:
    """Whether half of the widened Gaussians lie deeper below the skin than they reach: they are misplaced in depth, a
    cloud in which the neighbours of one are far where nothing is missing. In seven captures thinned to a tenth or a
    fiftieth the median depth is at most 0.4 times the median standard deviation, 0.8 times with the wider reach; in
    those moved by 0.02 longest sides it is 1.2 to 7 times."""
    depth = Body(grid, found.depth).at(wide.means)
    return bool(np.median(depth) > np.median(wide.scales.max(1)))


def _reaching_neighbours(gaussians: Gaussians, reach: float) -> Gaussians:
    """The Gaussians, wide enough along their skin to meet those beside them: a thinned capture, or a mesh sampled with
    few, has gaps wider than any cell. Their shortest axis, across the skin, stays."""
    number = min(NEIGHBOURS + 1, len(gaussians))  # each is its own nearest
    away = cKDTree(gaussians.means).query(gaussians.means, k=[number], workers=cores())[0]
    along = gaussians.scales > gaussians.scales.min(1, keepdims=True)
    along[~along.any(1), :2] = True  # balls have no skin to lie along: two of their axes will do
    wide = np.maximum(gaussians.scales, (reach * away).astype(np.float32))
    return replace(gaussians, scales=np.where(along, wide, gaussians.scales))


def _walls(opacity: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(X, Y, Z). Opaque cells, and slightly opaque ones connected to them, none in the grid's border."""
    regions, count = ndimage.label(opacity >= WALL_OPACITY)
    cores = np.zeros(count + 1, bool)
    cores[regions[opacity >= CORE_OPACITY]] = True
    wall = np.zeros(opacity.shape, bool)
    inner = (slice(BORDER, -BORDER),) * 3
    wall[inner] = cores[regions[inner]]
    return wall


def _trim_outer_wall(closed: NDArray[np.bool_], wall: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(X, Y, Z). The closed cells without the outer half of the wall; caps have no wall and stay."""
    outer = ~closed & ndimage.binary_dilation(wall)
    return closed & ~within(outer, WALL_HALF + 0.5)


def _drop_fragments(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(X, Y, Z). The inside without parts thinner than three cells and without small separate pieces."""
    core = ~within(~inside, 1.5)
    regions, count = ndimage.label(inside)
    if not count:
        return inside
    sizes = np.bincount(regions[core], minlength=count + 1)
    sizes[0] = 0
    keep = (sizes >= max(8, MIN_SIZE * sizes.max())) & (sizes > 0)
    opened = within(core & keep[regions], 2.0)
    return inside & opened & keep[regions]
