"""Solves for the interior of a body from pictures of its cut faces.

Solid texture synthesis (Kopf et al. 2007) lets patches of all families vote on a volume. Here a layout is built from
layers that continue differently along an axis (`decompose`), and is so close to the pictures that voting only blurs
it: on the orange at 144 voxels two rounds of voting raised the patch distance from 1.1 to 2.0 times that of another
true orange and lowered the sharpness from 0.84 to 0.64, at seven times the cost. So there is no voting.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.scene.grid import Body
from engine.scene.inside import Inside
from engine.threads import side_by_side
from training.families import Family
from training.priors.exemplar.frames import (
    Frame,
    ScaledPicture,
    Space,
    View,
    frame_of,
    make_space,
    scale_to_voxels,
    upright_factor,
)
from training.priors.exemplar.layering.core_shell import extract_core_shell
from training.priors.exemplar.layering.correction import RING_SAMPLES, Correction
from training.priors.exemplar.layering.decompose import Layers, decompose
from training.priors.exemplar.layering.extrusion import Extrusion
from training.priors.exemplar.layering.grain import Grain
from training.priors.exemplar.layering.height_mask import HeightMask, make_height_mask
from training.priors.exemplar.layering.inside import LayeredInside
from training.priors.exemplar.layering.morph import Slices, match_slices
from training.priors.exemplar.layering.places import Shape
from training.priors.exemplar.layering.revolution import Revolution
from training.priors.exemplar.layering.scatter import scatter_details
from training.priors.exemplar.layering.sheet import Sheet
from training.priors.exemplar.lighting import colour_gain
from training.priors.exemplar.patches import FIXED, OVER, POLAR, RADIAL
from training.priors.exemplar.pictures import Picture, read_picture, resolved_share
from training.priors.exemplar.quilting.agreement import runs_upwards, show_one_thing
from training.priors.exemplar.quilting.disc import BallMap, Disc
from training.priors.exemplar.quilting.inside import FILM, QuiltInside
from training.priors.exemplar.quilting.labels import made_of_grains
from training.priors.exemplar.quilting.persistence import find_membranes
from training.priors.exemplar.quilting.quilt import make_quilt
from training.priors.exemplar.quilting.things.cores import show_chambers, show_core_that_ends
from training.priors.exemplar.record import MOST_SEED, MOST_SHEETS
from training.priors.exemplar.sharpen import sharpen
from training.priors.prior import Progress, Volume

__all__ = ["solve"]

log = logging.getLogger(__name__)

CELLS_PER_RESOLVED_PIXEL = 2.0
"""Cells per pixel that a picture resolves. One would blur it, as pictures are oblique to the grid: an orange from
pictures of 70 pixels has 0.46 of the true sharpness on 192 cells, 0.45 on 144, 0.40 on 112 and 0.29 on 80; the patch
distance is best at 144, which also needs 0.4 times the atoms of 192."""

_NOT_NEEDED = "all that it shows runs along the axis, so the pictures across the axis decide what is inside"


def solve(
    body: Body,
    up: NDArray[np.float64],
    families: Sequence[Family],
    voxels: int,
    seed: int,
    progress: Progress,
    same: bool = False,
) -> Volume:
    """The interior on a grid of `voxels` cells along the body's longest side, or fewer. Bit-equal for a seed.

    It has fewer cells if the pictures resolve less (CELLS_PER_RESOLVED_PIXEL). Horizontal and radial pictures that
    disagree where they meet, or show a core that ends, are quilted, unless they show the `same` thing; so is one of
    these families that shows things close together or chambers around the axis, which no layer can continue. All others
    continue layer by layer. Where radial pictures disagree with horizontal ones, but show that all runs along the axis,
    as in wood, that is all that is taken from them.
    Raises InputError if no family has an exemplar or a picture cannot be used.
    """
    families = _by_kind([f.as_standard_kind(body, up) for f in families if f.exemplars])
    if not families:
        raise InputError("no exemplar pictures: give at least one family a photograph of a cut face")
    each = [(family, path) for family in families for path in family.exemplars]
    if len(each) > MOST_SHEETS:
        raise InputError(f"{len(each)} pictures of cut faces; give at most {MOST_SHEETS}")
    rng = np.random.default_rng(seed)
    progress(0.0)
    read = iter(side_by_side(lambda one: read_picture(one[1], one[0].kind, one[0].marks_of(one[1])), each))
    taken = [[next(read) for _ in family.exemplars] for family in families]
    notes = tuple(f"{p.path}: {p.note}" for own in taken for p in own if p.note)
    pictures = _match_lighting(taken)
    space = make_space(body, up, voxels)
    cells = _needed_cells(space, families, pictures, voxels)
    if cells < voxels:
        space = make_space(body, up, cells)
    progress(0.1)
    views = [_make_view(space, family, own_pictures) for family, own_pictures in zip(families, pictures, strict=True)]
    if len(views) == 1 and views[0].kind != RADIAL and (stack := match_slices(views[0].pictures)) is not None:
        log.info("the pictures are slices of one thing, in order along %s", np.round(views[0].basis[2], 2).tolist())
        inside = LayeredInside.of(space, Slices(Shape.of(space, views[0]), stack))
        rgb = space.scatter(inside.at(space.points, float(space.body.grid.cell)))
        sharpen(space, rgb, views)
        return _make_volume(space, rgb, progress, inside, notes)
    discs: dict[Frame, list[Disc]] = {}
    if {family.kind for family in families} <= {"horizontal", "radial"}:
        across = next((view.stretch for view in views if view.kind != RADIAL), 1.0)
        shown = [p.proportions for view, own in zip(views, taken, strict=True) if view.kind == RADIAL for p in own]
        ball = BallMap.of(space, across, upright_factor(space.axial_proportions, float(np.mean(shown or [1.0]))))
        discs = _discs(views, taken)  # in their own light, which is part of the question
        if len(views) == 1:
            kind = RADIAL if views[0].kind == RADIAL else POLAR
            has_chambers = kind == POLAR and show_chambers(discs[POLAR])
            is_quilted = has_chambers or made_of_grains(discs[kind][0], kind == POLAR)
        else:
            show_one = same or show_one_thing(discs[POLAR], discs[RADIAL])
            along = next(own for view, own in zip(views, taken, strict=True) if view.kind == RADIAL)
            if not show_one and all(runs_upwards(picture) for picture in along):
                log.info("all runs along the axis: carried along it from the pictures across it alone")
                across_it = [family for family in families if family.kind != "radial"]
                volume = solve(body, up, across_it, voxels, seed, progress)
                return replace(volume, notes=(*notes, *(f"{picture.path}: {_NOT_NEEDED}" for picture in along)))
            is_quilted = not same and (not show_one or show_core_that_ends(discs[POLAR], discs[RADIAL], ball.height))
        if is_quilted:
            log.info("no picture goes on through the object: each is followed in its own plane, and mixed between")
            quilt = make_quilt(discs[POLAR], discs[RADIAL], seed, lambda part: progress(0.1 + 0.6 * part), ball.height)
            rgb = space.scatter(quilt.read(ball.to_ball(space.planar), (1 + FILM) / float(ball.skin.mean())))
            progress(0.8)
            sharpen(space, rgb, views)
            quilted = QuiltInside.of(space, ball, quilt, discs[POLAR], discs[RADIAL], seed)
            return _make_volume(space, rgb, progress, quilted, notes)
    layers = [_layers_of(view, discs.get(view.kind, [])) for view in views]
    progress(0.2)
    course, height_mask = _lay_course(space, views, layers, rng)
    inside = LayeredInside.of(space, course)
    progress(0.4)
    rgb = space.scatter(inside.at(space.points, 0))
    progress(0.7)
    own, advance = _carrier(views) or 0, lambda part: progress(0.7 + 0.1 * part)
    stamps = scatter_details(rgb, space, views, layers, course, own, height_mask, rng, advance)
    space.fill(rgb)
    gain = sharpen(space, rgb, views)
    log.info("%d details scattered, edges sharpened by %.2f", len(stamps.rows), gain)
    return _make_volume(space, rgb, progress, replace(inside, stamps=stamps), notes)


def _by_kind(families: list[Family]) -> list[Family]:
    """The families with the pictures of all that are horizontal, or radial, in the first of these: single planes may be
    of a kind that has a family of its own."""
    merged: list[Family] = []
    for family in families:
        n = next((n for n, one in enumerate(merged) if one.kind == family.kind != "parallel"), None)
        if n is None:
            merged.append(family)
            continue
        marks = dict(family.marks) | dict(merged[n].marks)
        exemplars = tuple(dict.fromkeys((*merged[n].exemplars, *family.exemplars)))
        merged[n] = replace(merged[n], exemplars=exemplars, marks=tuple(sorted(marks.items())))
    return merged


def _discs(views: list[View], pictures: list[list[Picture]]) -> dict[Frame, list[Disc]]:
    """The horizontal pictures as unit discs under POLAR, though the body may not be round, and the radial ones under
    RADIAL; an empty list for those that are not among the views."""
    own = {
        RADIAL if view.kind == RADIAL else POLAR: [Disc.of(p) for p in some]
        for view, some in zip(views, pictures, strict=True)
    }
    return {kind: own.get(kind, []) for kind in (POLAR, RADIAL)}


def _layers_of(view: View, discs: list[Disc]) -> list[Layers]:
    """The layers of a view's pictures. `discs`: the same pictures as discs, if the body is round."""
    if view.kind != POLAR or not discs:
        return [decompose(scaled, view.kind) for scaled in view.pictures]
    return [decompose(s, POLAR, _membranes_of(d, s)) for s, d in zip(view.pictures, discs, strict=True)]


def _membranes_of(disc: Disc, scaled: ScaledPicture) -> NDArray[np.float32]:
    """(H, W). How surely each pixel of a horizontal picture, which `disc` shows too, belongs to a membrane. Range
    [0, 1]."""
    rows, columns = np.indices(scaled.depth.shape) / OVER
    right, high = columns - scaled.middle[0], scaled.middle[1] - rows
    angle = np.arctan2(high, right)
    r = np.hypot(right, high) / scaled.rim(angle)
    found = find_membranes(disc, walls=False)  # wider ones are structures of their own
    return Disc(np.repeat(found[..., None], 3, -1)).read(r * np.cos(angle), r * np.sin(angle))[..., 0]


def _match_lighting(families: list[list[Picture]]) -> list[list[Picture]]:
    """The pictures of all families matched to the illuminant of the first family's first picture.

    The first family stays unchanged: slices of one object differ for other reasons than light.
    """
    first = families[0][0]
    return families[:1] + [
        [replace(p, rgb=np.minimum(p.rgb * colour_gain(p.rgb, p.mask, first.rgb, first.mask), 1)) for p in family]
        for family in families[1:]
    ]


def _make_volume(
    space: Space, rgb: NDArray[np.float32], progress: Progress, inside: Inside, notes: tuple[str, ...]
) -> Volume:
    """The grid as a volume, its outside filled from the nearest voxel inside."""
    space.fill(rgb)
    progress(1.0)
    return Volume(space.body, rgb, inside=inside, notes=notes)


def _needed_cells(space: Space, families: list[Family], pictures: list[list[Picture]], voxels: int) -> int:
    """Cells along the longest side: CELLS_PER_RESOLVED_PIXEL times what the sharpest picture resolves, at most
    `voxels`."""
    cells = min(
        np.sqrt(_frame_and_area(space, family)[2] / p.mask.sum()) / resolved_share(p)
        for family, own_pictures in zip(families, pictures, strict=True)
        for p in own_pictures
    )
    return min(voxels, int(np.ceil(voxels * CELLS_PER_RESOLVED_PIXEL / cells)))


def _make_view(space: Space, family: Family, pictures: list[Picture]) -> View:
    """The frame of a family and its pictures at the scale of the voxels."""
    kind, basis, area = _frame_and_area(space, family)
    stretch = float(np.sqrt(pictures[0].proportions / space.proportions(basis))) if kind == FIXED else 1.0
    return View(kind, basis, [scale_to_voxels(p, space, kind, area) for p in pictures], stretch)


def _frame_and_area(space: Space, family: Family) -> tuple[Frame, NDArray[np.float64], float]:
    """The frame and basis of a family, and the area that its pictures show in square cells."""
    if family.kind == "radial":
        return RADIAL, space.basis, float(space.axial_area)
    basis = space.basis
    if family.kind != "horizontal":
        normal = family.normal(space.body, space.up)
        high = space.up - normal * (normal @ space.up)
        high = high / np.linalg.norm(high) if np.linalg.norm(high) > 1e-3 else space.basis[1]
        basis = np.stack([np.cross(high, normal), high, normal])
    return frame_of(family.kind, space), basis, space.widest_slice((space.cells - space.centre) @ basis[2])


def _carrier(views: list[View]) -> int | None:
    """Index of the view whose pictures are carried along an axis, None if all are radial."""
    kinds = [v.kind for v in views]
    return next((kinds.index(kind) for kind in (POLAR, FIXED) if kind in kinds), None)


def _lay_course(
    space: Space, views: list[View], layers: list[list[Layers]], rng: np.random.Generator
) -> tuple[Extrusion | Revolution, HeightMask | None]:
    """How the layers of one family's pictures continue through the body, corrected by the radial ones.

    Also returns the height mask of its structures, None without radial pictures or structures. Removes the line around
    a core from `layers`, in place: it is drawn separately.
    """
    kinds = [v.kind for v in views]
    carrier = _carrier(views)
    radial = kinds.index(RADIAL) if RADIAL in kinds else None
    if carrier is None:
        log.info("radial pictures alone: turned about the axis")
        shape = Shape.of(space, views[0])
        grain = Grain.of(layers[0], [], turns=False)
        return Revolution(shape, Sheet.of(layers[0][0]), grain, int(rng.integers(MOST_SEED))), None
    view = views[carrier]
    shape = Shape.of(space, view)
    grain = Grain.of(layers[carrier], layers[radial] if radial is not None else [], turns=shape.is_round)
    way = "up" if view.kind == POLAR else "fixed"
    log.info("carried along the %s axis, texture in layers of %.2f cells", way, grain.thickness)
    core, height_mask = None, None
    if radial is not None:
        if view.kind == POLAR:
            others = [extract_core_shell(parts, layers[radial])[1] for parts in layers[carrier][1:]]
            core, first, layers[radial] = extract_core_shell(layers[carrier][0], layers[radial])
            layers[carrier] = [first, *others]
        height_mask = make_height_mask(layers[carrier][0], layers[radial], rng)
    main = layers[carrier][0]
    course = Extrusion(shape, Sheet.of(main), grain, int(rng.integers(MOST_SEED)), height_mask, core)
    if radial is None:
        return course, height_mask
    # Random, not strided: in a straight body a stride would skip whole levels.
    some = np.random.default_rng(0).integers(len(space.cells), size=min(len(space.cells), RING_SAMPLES))
    places = shape.places((space.cells[some] - space.centre).astype(np.float64))
    sheets = [Sheet.of(parts) for parts in layers[radial]]
    correction = Correction.of(sheets, shape, main.source, places, course.uncorrected(places))
    return replace(course, correction=correction), height_mask
