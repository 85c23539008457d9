"""The document of one object that the user edits: cuts, placements of the pieces, families of planes to train. It is
plain frozen data; a scene with several bodies has a document for each.

Pieces are not stored but derived: every slice that is on divides the pieces that it was made for (`app.model.pieces`).
So a cut can be moved, switched off or removed later, and the pieces keep their placements.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Literal, get_args

from app.model.rigid_transform import STILL, Motion, Vec3
from app.translation import _
from engine.io.fields import LARGEST_INTEGER
from engine.isolate.selection import Isolation, Selection
from engine.scene.plane import Plane
from training.faces.marks import UNMARKED, Marks
from training.families import COUNTS, Family, Kind
from training.request import PriorName
from training.settings import DetailName

__all__ = [
    "MARKS",
    "WHOLE",
    "Cut",
    "CutKind",
    "Document",
    "Key",
    "Mark",
    "Part",
    "Placement",
    "Training",
    "agrees",
]

Key = tuple[tuple[int, int], ...]
"""Key of a piece: (cut id, side) for each cut that made it, in the order of the cuts. Side -1 is the kept side, 1 the
removed one."""

WHOLE: Key = ()
"""Key of the object before any cut."""

CutKind = Literal["slice", "section"]
"""A slice divides pieces; a section only hides what is on its removed side."""

Mark = Literal["", "circle", "square", "star", "heart", "moon", "bolt"]
MARKS: tuple[Mark, ...] = tuple(mark for mark in get_args(Mark) if mark)
"""Shapes to mark pieces with. Each has a colour of its own, but can be told apart without it."""

DEFAULT_GAP = 0.16
"""Gap between pieces, in radii of the object: wide enough to tell two pieces apart and see the rim of both faces."""


@dataclass(frozen=True)
class Part:
    """The plane of a cut through one piece. One stroke across moved pieces cuts the object at different places."""

    plane: Plane
    """In object space."""
    scope: Key = WHOLE
    """The piece that it cuts; WHOLE: every piece."""
    walls: tuple[Plane, ...] = ()
    """Half-spaces, in object space, that limit the cut to their kept sides. A curved blade has one plane in each of
    several sectors; the walls between the sectors cut nothing."""


@dataclass(frozen=True)
class Cut:
    """A knife stroke or a placed plane."""

    id: int
    name: str
    parts: tuple[Part, ...]
    kind: CutKind = "slice"
    shift: float = 0.0
    """How far the cut has been moved along its normal since it was made, world units."""
    on: bool = True

    def plane(self, part: Part) -> Plane:
        """The plane of a part, including the shift."""
        return Plane(part.plane.normal, part.plane.offset - self.shift)

    def with_plane(self, plane: Plane) -> Cut:
        """The cut, which must have a single part, along another plane in object space."""
        (part,) = self.parts
        return replace(self, parts=(replace(part, plane=plane),), shift=0.0)

    @property
    def curved(self) -> bool:
        """Whether it cuts pieces along more than one plane."""
        return any(part.walls for part in self.parts)

    def parts_for(self, key: Key) -> tuple[Part, ...]:
        """The parts that divide this piece; none if the cut was made for other pieces."""
        scope = next((part.scope for part in self.parts if agrees(part.scope, key)), None)
        return tuple(replace(part, plane=self.plane(part)) for part in self.parts if part.scope == scope)


@dataclass(frozen=True)
class Placement:
    """Where the user has put one piece, and whether it is shown."""

    motion: Motion = STILL
    visible: bool = True
    removed: bool = False
    name: str = ""
    """The user's name for the piece; empty: it is numbered."""
    group: str = ""
    """Name of the group that the piece is in; empty: none. Pieces cut from it are in the same group."""
    mark: Mark = ""
    """Mark that the user tells the piece by; pieces cut from it have the same."""


@dataclass(frozen=True)
class Training:
    """The settings of the next training run."""

    detail: DetailName = "standard"
    prior: PriorName = "exemplar"
    seed: int = 0
    iterations: int | None = None
    """Most iterations; None: as in `training.request.Request`."""
    out: Path | None = None
    """Result folder; None: beside the scene."""
    model: Path | None = None
    """Folder of the diffusion model, for `stable-diffusion`."""
    thing: str = ""
    """What the object is called in prompts; empty: the name of the scene's file."""
    same: bool = False
    """Whether the user knows that all pictures show the very same object."""


@dataclass(frozen=True)
class Document:
    """Everything of an object that undo and the project file cover."""

    scene: Path | None = None
    up: Vec3 | None = None
    """Unit vector; None: as detected."""
    isolation: Isolation = ()
    """The parts of the capture that do not belong to the object; () for none."""
    selection: Selection = ()
    """The selected part of the rest of the capture, to be kept or removed next."""
    cuts: tuple[Cut, ...] = ()
    placements: tuple[tuple[Key, Placement], ...] = ()
    """Placements sorted by key; a piece without one has that of the piece that it was cut from."""
    families: tuple[Family, ...] = ()
    training: Training = field(default_factory=Training)
    gap: float = DEFAULT_GAP
    """Gap between the two sides of a slice, in radii of the object. Range [0, 2]."""
    explode: float = 0.0
    """How far pieces are moved away from the centre, relative to their distance from it. Range [0, 2]."""
    number: int = 0
    """0 for the only object of a scene; several objects have different, permanent numbers from 1. It is part of the
    result folder's name."""
    name: str = ""
    """The user's name for the object; empty: it is called by its number."""
    visible: bool = True

    @property
    def title(self) -> str:
        """What the window calls the object."""
        return self.name or _("Object {number}").format(number=self.number)

    # cuts

    def cut(self, cut_id: int) -> Cut:
        """The cut with this id. Raises KeyError if there is none."""
        for cut in self.cuts:
            if cut.id == cut_id:
                return cut
        raise KeyError(cut_id)

    @property
    def next_id(self) -> int:
        """An id that neither a cut nor the key of a placement uses."""
        used = [cut.id for cut in self.cuts] + [i for key, _ in self.placements for i, _ in key]
        last = max(used, default=0)
        # A project file may contain any id; one more than the largest allowed could not be saved.
        return last + 1 if last < LARGEST_INTEGER else next(i for i in count(1) if i not in used)

    def next_name(self, stem: str) -> str:
        """The stem with the next free number: 'Knife 3' after 'Knife 2'."""
        # Names may come from a stranger's file: \d would match digits of any script, and a number may be endless.
        numbers = [re.fullmatch(re.escape(stem) + r" ([0-9]{1,9})", cut.name) for cut in self.cuts]
        return f"{stem} {max((int(match[1]) for match in numbers if match), default=0) + 1}"

    def with_cut(self, parts: tuple[Part, ...], stem: str = _("Knife"), kind: CutKind = "slice") -> Document:
        """With a cut added after all others."""
        return replace(self, cuts=(*self.cuts, Cut(self.next_id, self.next_name(stem), parts, kind)))

    def changed_cut(self, cut_id: int, change: Callable[[Cut], Cut]) -> Document:
        """With one cut changed."""
        self.cut(cut_id)
        return replace(self, cuts=tuple(change(cut) if cut.id == cut_id else cut for cut in self.cuts))

    def without_cut(self, cut_id: int) -> Document:
        """Without a cut: the pieces on its two sides become one again, later cuts stay."""
        self.cut(cut_id)
        cuts = tuple(replace(cut, parts=_widened(cut.parts, cut_id)) for cut in self.cuts if cut.id != cut_id)
        placements = tuple((key, placement) for key, placement in self.placements if cut_id not in dict(key))
        return replace(self, cuts=cuts, placements=placements)

    # pieces

    def placement(self, key: Key) -> Placement:
        """The placement of a piece: its own, or that of the piece that it was cut from."""
        placements = dict(self.placements)
        for length in range(len(key), -1, -1):
            if key[:length] in placements:
                found = placements[key[:length]]
                return found if length == len(key) else replace(found, name="")
        return Placement()

    def placed(self, key: Key, change: Callable[[Placement], Placement]) -> Document:
        """With the placement of one piece changed; as it is if one of the cuts around it is gone."""
        if not {cut for cut, _ in key} <= {cut.id for cut in self.cuts}:
            return self
        placements = dict(self.placements) | {key: change(self.placement(key))}
        return replace(self, placements=tuple(sorted(placements.items(), key=lambda item: item[0])))

    def reassembled(self) -> Document:
        """With all pieces back in place, shown, none removed; the cuts stay."""
        names = tuple(
            (key, Placement(name=p.name, group=p.group, mark=p.mark))
            for key, p in self.placements
            if p.name or p.group or p.mark
        )
        return replace(self, placements=names, gap=0.0, explode=0.0)

    # families

    def family(self, kind: Kind) -> Family | None:
        """The family of this kind."""
        return next((family for family in self.families if family.kind == kind), None)

    def with_family(self, family: Family) -> Document:
        """With this family in place of the one of its kind."""
        others = [f for f in self.families if f.kind != family.kind]
        return replace(self, families=tuple(sorted([*others, family], key=lambda f: list(COUNTS).index(f.kind))))

    def without_family(self, kind: Kind) -> Document:
        """Without the family of this kind."""
        return replace(self, families=tuple(family for family in self.families if family.kind != kind))

    def with_exemplars(self, kind: Kind, paths: tuple[Path, ...]) -> Document:
        """With more pictures for a family, which is added if it is missing. No picture is listed twice."""
        family = self.family(kind) or Family(kind, COUNTS[kind])
        new = tuple(path for path in dict.fromkeys(paths) if path not in family.exemplars)
        return self.with_family(replace(family, exemplars=(*family.exemplars, *new)))

    def without_exemplar(self, kind: Kind, path: Path) -> Document:
        """Without one of a family's pictures and the marks of its face."""
        family = self.family(kind)
        if family is None:
            return self
        others = tuple(other for other in family.exemplars if other != path)
        return self.with_family(replace(family.with_marks(path, UNMARKED), exemplars=others))

    def moved_exemplar(self, path: Path, kind: Kind, to: Kind) -> Document:
        """With a picture moved to another family, along with its outline and axis."""
        family = self.family(kind)
        if family is None or kind == to:
            return self
        other = self.family(to)
        if other is not None and path in other.exemplars:  # with marks of its own
            return self.without_exemplar(kind, path)
        document = self.without_exemplar(kind, path).with_exemplars(to, (path,))
        return document.with_marks(to, path, family.marks_of(path))

    def with_marks(self, kind: Kind, path: Path, marks: Marks) -> Document:
        """With the user's marks of the face in one of a family's pictures."""
        family = self.family(kind)
        if family is None or path not in family.exemplars:
            return self
        return self.with_family(family.with_marks(path, marks))


def agrees(scope: Key, key: Key) -> bool:
    """Whether a cut made for the piece `scope` also cuts the piece `key`, which is so unless some cut has them on
    opposite sides."""
    sides = dict(scope)
    return all(sides.get(cut, side) == side for cut, side in key)


def _without(key: Key, cut_id: int) -> Key:
    """The key without a cut."""
    return tuple(step for step in key if step[0] != cut_id)


def _widened(parts: tuple[Part, ...], cut_id: int) -> tuple[Part, ...]:
    """The parts of a cut once another cut is removed: if several then cut the same piece, only the first of them."""
    first: dict[Key, Key] = {}
    for part in parts:
        first.setdefault(_without(part.scope, cut_id), part.scope)
    kept = [part for part in parts if first[_without(part.scope, cut_id)] == part.scope]
    return tuple(replace(part, scope=_without(part.scope, cut_id)) for part in kept)
