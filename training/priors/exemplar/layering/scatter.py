"""Scatters details such as seeds and pores through the body, in the number and size that the pictures show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from training.priors.exemplar.frames import Space, View, voxel_gate
from training.priors.exemplar.layering.decompose import Detail, Layers
from training.priors.exemplar.layering.extrusion import Extrusion
from training.priors.exemplar.layering.height_mask import HeightMask
from training.priors.exemplar.layering.revolution import Revolution
from training.priors.exemplar.layering.stamps import COLUMNS, GROW, Crops, Stamps, paint
from training.priors.exemplar.patches import POLAR, RADIAL, frame_at
from training.priors.prior import Progress

__all__ = ["scatter_details"]

BIN_SIZE = 0.4
"""Edge of a bin of gate coordinates; a detail may be placed in its own bin and the neighbours."""

MEAN_SECTION = np.pi / 4
"""Mean size of a random section of an ellipsoid over that of its largest."""

SAME_COLOUR = 0.25
"""Largest RGB distance between the ground at a new place and in the picture: no crumbs in the cream."""

MAX_TRIES = 20
"""Positions tried for a detail before it may touch another."""


class _GateIndex:
    """Rows binned by gate coordinates, for drawing some near given coordinates."""

    def __init__(self, gates: NDArray[np.float32], rows: NDArray[np.intp]) -> None:
        keys = self._keys(np.floor(gates[rows] / BIN_SIZE).astype(np.int64))
        order = np.argsort(keys, kind="stable")
        self.rows = rows[order]
        self.keys, self.first, self.count = np.unique(keys[order], return_index=True, return_counts=True)

    @staticmethod
    def _keys(bins: NDArray[np.int64]) -> NDArray[np.int64]:
        return (bins + 8) @ np.array([1_000_000, 1_000, 1])

    def _near(self, gate: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """First row and number of rows of the bins around gate coordinates."""
        around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
        wanted = self._keys(np.floor(gate / BIN_SIZE).astype(np.int64) + around)
        at = np.minimum(np.searchsorted(self.keys, wanted), len(self.keys) - 1)
        found = self.keys[at] == wanted
        return self.first[at[found]], self.count[at[found]]

    def number(self, gate: NDArray[np.float32]) -> int:
        """Number of rows in the bins around these coordinates."""
        return int(self._near(gate)[1].sum()) if len(self.keys) else 0

    def draw(self, gate: NDArray[np.float32], count: int, rng: np.random.Generator) -> NDArray[np.intp]:
        """(count,). Rows around these coordinates, drawn uniformly; there must be at least one."""
        first, number = self._near(gate)
        ends = np.cumsum(number)
        pick = rng.integers(ends[-1], size=count)
        which = np.searchsorted(ends, pick, side="right")
        return self.rows[first[which] + pick - (ends[which] - number[which])]


@dataclass(frozen=True)
class _Template:
    """A detail of a picture and how to place its copies in the body."""

    view: int
    layers: int
    detail: int
    across: float
    """Half length along the picture's normal, cells."""
    copies: float
    """Expected number of copies in the body."""
    places: _GateIndex
    gate: NDArray[np.float32]
    """(3,). Gate coordinates of the copies' centres."""


def scatter_details(
    rgb: NDArray[np.float32],  # [X, Y, Z, 3]
    space: Space,
    views: Sequence[View],
    layers: Sequence[Sequence[Layers]],
    course: Extrusion | Revolution,
    own_view: int,
    height_mask: HeightMask | None,
    rng: np.random.Generator,
    progress: Progress,
) -> Stamps:
    """Paints the details of all pictures into the grid, in place, and returns them.

    The own plane of the `course`, which the first picture of the `own_view` shows, gets the details of that picture and
    no others. Elsewhere a detail is taken for a section of an object whose length across the picture follows the aspect
    of the other families' details or, without any, equals its width. A plane crosses an object of length L with
    probability L / H, so a face showing n of them stands for n H / L in the body.
    """
    templates = _make_templates(space, views, layers, height_mask)
    shown = [(layers[t.view][t.layers], layers[t.view][t.layers].details[t.detail]) for t in templates]
    crops = Crops.of(shown)
    order = np.argsort([-k.across for k in templates], kind="stable").tolist()
    rows, crop = [np.zeros((0, COLUMNS), np.float32)], []
    grid = _Occupancy(space)
    own = _OwnPlane(space, course)

    def stamp(n: int, point: NDArray[np.float32], grow: float) -> None:
        view, (parts, detail) = views[templates[n].view], shown[n]
        frame = frame_at(view.kind, view.basis.astype(np.float32), space.centre, *point)
        in_picture = detail.x, detail.y, detail.reach, *parts.source.ab[detail.pixel] * grow
        row = np.array([*point, *frame, *in_picture, templates[n].across, *detail.ground], np.float32)
        paint(rgb, space.number, row, crops, n)
        rows.append(row[None])
        crop.append(n)

    copies = [template.copies for template in templates]
    for n in order:
        template, (parts, detail) = templates[n], shown[n]
        if (template.view, template.layers) == (own_view, 0):
            point = own.point(detail, parts.source.ab[detail.pixel], views[own_view])
            if point is not None:
                grid.occupy(point, max(*detail.half, template.across))
                stamp(n, point, float(GROW))
                copies[n] -= 1
    for done, n in enumerate(order):
        progress(done / len(order))
        template, detail = templates[n], shown[n][1]
        whole, part = divmod(max(copies[n], 0), 1)
        for _ in range(int(whole) + (rng.random() < part)):
            choice = template.places.draw(template.gate, MAX_TRIES, rng)
            i, j, k = space.cells[choice].T
            fits = np.linalg.norm(rgb[i, j, k] - detail.ground, axis=1) < SAME_COLOUR
            choice = choice[fits & (own.away[choice] > template.across + 1)]
            if len(choice) == 0:
                continue
            at = grid.place(choice, max(*detail.half, template.across))
            stamp(n, space.cells[at].astype(np.float32) + rng.uniform(-0.5, 0.5, 3).astype(np.float32), 1)
    return Stamps(crops, np.concatenate(rows), np.array(crop, np.int32))


class _OwnPlane:
    """The plane in which a course shows its picture as it is."""

    def __init__(self, space: Space, course: Extrusion | Revolution) -> None:
        self.centre, self.normal = space.centre.astype(np.float64), course.own_normal
        offsets = space.cells - self.centre
        self.away = np.abs(offsets @ self.normal).astype(np.float32)
        """(N,). Distance of the voxels from the plane, cells."""
        near = np.flatnonzero(self.away <= 0.75)
        self.cells = space.cells[near]
        self.places = np.stack(course.position(course.shape.places(offsets[near])), axis=-1)
        self.tree = KDTree(self.places)

    def point(self, detail: Detail, ab: NDArray[np.float32], view: View) -> NDArray[np.float32] | None:
        """(3,). Where the plane shows a detail of its picture, in cells; None if the body has no such place.

        `ab` (4,): directions a and b at the detail.
        """
        distance, at = self.tree.query((detail.x, detail.y))
        if distance > 2:
            return None
        cell = self.cells[at].astype(np.float32)
        frame = np.array(frame_at(view.kind, view.basis.astype(np.float32), self.centre.astype(np.float32), *cell))
        offset = np.array([detail.x, detail.y]) - self.places[at]
        point = cell + offset @ ab[:2] * frame[:3] + offset @ ab[2:] * frame[3:]
        return (point - self.normal * ((point - self.centre) @ self.normal)).astype(np.float32)


class _Occupancy:
    """Positions of placed details in a coarse grid, to keep them from overlapping."""

    def __init__(self, space: Space) -> None:
        self.space = space
        self.step = 8
        self.placed: dict[tuple[int, ...], list[tuple[NDArray[np.float32], float]]] = {}

    def place(self, choice: NDArray[np.intp], size: float) -> int:
        """Takes the first of some rows of `space.cells` with room for a detail of this half length, else the last;
        returns it."""
        for at in choice.tolist():
            point = self.space.cells[at].astype(np.float32)
            key = self._key(point)
            reach = 1 + int(1.5 * size // self.step)
            near = (
                other
                for i in range(-reach, reach + 1)
                for j in range(-reach, reach + 1)
                for k in range(-reach, reach + 1)
                for other in self.placed.get((key[0] + i, key[1] + j, key[2] + k), ())
            )
            if all(float(((point - p) ** 2).sum()) > (0.8 * (size + s)) ** 2 for p, s in near):
                break
        self.occupy(point, size)
        return at

    def occupy(self, point: NDArray[np.float32], size: float) -> None:
        """Takes the room of a detail of this half length at a point."""
        self.placed.setdefault(self._key(point), []).append((point, size))

    def _key(self, point: NDArray[np.float32]) -> tuple[int, ...]:
        return tuple((point // self.step).astype(int).tolist())


def _make_templates(
    space: Space, views: Sequence[View], layers: Sequence[Sequence[Layers]], height_mask: HeightMask | None
) -> list[_Template]:
    """A template for each detail of each picture: its length across, number of copies and allowed positions.

    Leaves out details enclosed by an extruded structure, such as the seeds in an apple's carpels.
    """
    with_details = [v for v in range(len(views)) if any(p.details for p in layers[v])]
    # Where a radial or parallel family shows the height and depth of details, those of the others go there too.
    aspects = [_aspect(layers[v]) for v in range(len(views))]
    templates = []
    for v in with_details:
        other_aspects = [aspects[o] for o in with_details if o != v]
        gates = voxel_gate(space, views[v].kind)
        pixels = np.concatenate([p.source.gate for p in layers[v]])
        everywhere = _GateIndex(gates, np.arange(len(gates)))
        in_pictures = _GateIndex(pixels, np.arange(len(pixels)))
        allowed = everywhere
        if views[v].kind == POLAR:
            near_detail = _near_known_details(
                space, views, layers, [o for o in with_details if views[o].kind == RADIAL]
            )
            allowed = _GateIndex(gates, np.flatnonzero(near_detail))
        for n, parts in enumerate(layers[v]):
            for d, detail in enumerate(parts.details):
                gate = parts.source.gate[detail.pixel]
                if height_mask is not None and views[v].kind == RADIAL and _is_enclosed(height_mask, parts, detail):
                    continue
                voxels, area = everywhere.number(gate), in_pictures.number(gate)
                if voxels == 0 or area == 0:
                    continue
                places = allowed if allowed.number(gate) else everywhere
                width = float(np.sqrt(detail.half[0] * detail.half[1]))
                across = width * float(np.mean(other_aspects)) if other_aspects else width
                across = float(np.clip(across, 0.5 * min(detail.half), 1.5 * max(detail.half))) / MEAN_SECTION
                templates.append(
                    _Template(
                        v, n, d, across, voxels / area / (2 * MEAN_SECTION * across) / len(with_details), places, gate
                    )
                )
    return templates


def _is_enclosed(height_mask: HeightMask, parts: Layers, detail: Detail) -> bool:
    """Whether an extruded structure encloses this detail of a radial picture."""
    (across, up), (half_across, half_up) = parts.source.middle, parts.source.half
    radius = np.array([abs(detail.x - across) / half_across])
    return bool(height_mask.explains(radius, np.array([(up - detail.y) / half_up]))[0])


def _aspect(layers: Sequence[Layers]) -> float:
    """Median ratio of the half lengths along b and a of a family's larger details, within [0.5, 2]."""
    halves = np.array([d.half for parts in layers for d in parts.details]).reshape(-1, 2)
    if len(halves) == 0:
        return 1.0
    large = halves[halves.prod(1) >= np.median(halves.prod(1))]
    ratio = float(np.median(large[:, 1] / large[:, 0]))
    return float(np.clip(ratio, 0.5, 2.0))


def _near_known_details(
    space: Space, views: Sequence[View], layers: Sequence[Sequence[Layers]], families: Sequence[int]
) -> NDArray[np.bool_]:
    """(N,). Voxels with gate coordinates near a detail of these families; all voxels without such families."""
    near_detail = np.full(len(space.cells), not families)
    for v in families:
        gates = voxel_gate(space, views[v].kind)
        for parts in layers[v]:
            for detail in parts.details:
                near_detail |= (np.abs(gates - parts.source.gate[detail.pixel]) <= 0.8).all(1)
    return near_detail
