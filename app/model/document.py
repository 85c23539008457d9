"""What the user makes: cuts, how the pieces lie, families of planes to train. Plain frozen data, no window.

Pieces are not stored, they follow: every slice that is on divides the pieces it was made for (`app.model.pieces`). So a
cut can be moved, switched off and taken away later, and the pieces keep how they were placed.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Literal

from app.model.rigid_transform import STILL, Motion, Vec3
from engine.io.fields import LARGEST_INTEGER
from engine.scene.plane import Plane
from training.families import COUNTS, Family, Kind
from training.request import PriorName
from training.settings import DetailName

__all__ = [
    "WHOLE",
    "Cut",
    "CutKind",
    "Document",
    "Key",
    "Part",
    "Placement",
    "Training",
    "agrees",
]

Key = tuple[tuple[int, int], ...]
"""Name of a piece: (id of a cut, side) for each cut that made it, in their order. Side -1 is the kept one."""

WHOLE: Key = ()

CutKind = Literal["slice", "section"]
"""A slice divides pieces; a section only hides what lies on its removed side."""

DEFAULT_GAP = 0.16
"""Of the object's radius: wide enough to see that there are two pieces, and the rim of both faces."""


@dataclass(frozen=True)
class Part:
    """Where a cut goes through one piece. Pieces that were moved are met at different places of the object."""

    plane: Plane
    """In the object's own space."""
    scope: Key = WHOLE
    """The piece it was made for; the whole object: every piece."""


@dataclass(frozen=True)
class Cut:
    """A knife stroke or a placed plane."""

    id: int
    name: str
    parts: tuple[Part, ...]
    kind: CutKind = "slice"
    shift: float = 0.0
    """World units along the normal that the cut was moved by, after it was made."""
    on: bool = True

    def plane(self, part: Part) -> Plane:
        """The plane of a part, moved by the shift."""
        return Plane(part.plane.normal, part.plane.offset - self.shift)

    def plane_for(self, key: Key) -> Plane | None:
        """The plane that divides this piece; None where the cut was made for others."""
        for part in self.parts:
            if agrees(part.scope, key):
                return self.plane(part)
        return None


@dataclass(frozen=True)
class Placement:
    """What the user did to one piece."""

    motion: Motion = STILL
    visible: bool = True
    removed: bool = False
    name: str = ""
    """Empty: numbered."""


@dataclass(frozen=True)
class Training:
    """The settings of the next training run."""

    detail: DetailName = "standard"
    prior: PriorName = "exemplar"
    seed: int = 0
    iterations: int | None = None
    """Most iterations; None: the detail's own number."""
    out: Path | None = None
    """Folder of the result; None: beside the scene."""
    model: Path | None = None
    """Folder of the diffusion model, for `stable-diffusion`."""
    thing: str = ""
    """What the object is called in prompts; empty: the name of the scene's file."""


@dataclass(frozen=True)
class Document:
    """Everything that undo, redo and the project file keep."""

    scene: Path | None = None
    up: Vec3 | None = None
    """Unit vector; None: as detected."""
    cuts: tuple[Cut, ...] = ()
    placements: tuple[tuple[Key, Placement], ...] = ()
    """Sorted by key; pieces without one lie where the piece they were cut from lay."""
    families: tuple[Family, ...] = ()
    training: Training = field(default_factory=Training)
    gap: float = DEFAULT_GAP
    """Between the two sides of a slice, in radii of the object. Range [0, 2]."""
    explode: float = 0.0
    """How far pieces stand from the middle, in their own distance from it. Range [0, 2]."""

    # cuts

    def cut(self, cut_id: int) -> Cut:
        """The cut with this id; KeyError where there is none."""
        for cut in self.cuts:
            if cut.id == cut_id:
                return cut
        raise KeyError(cut_id)

    @property
    def next_id(self) -> int:
        """An id that no cut has, and none had that a placement remembers."""
        used = [cut.id for cut in self.cuts] + [i for key, _ in self.placements for i, _ in key]
        last = max(used, default=0)
        # A project file may count from anywhere; one more than the largest that it may hold could not be saved.
        return last + 1 if last < LARGEST_INTEGER else next(i for i in count(1) if i not in used)

    def next_name(self, stem: str) -> str:
        """'Knife 3' after 'Knife 2'."""
        # The names may be a stranger's: other scripts' digits are none here, and a number may be too long for one.
        numbers = [re.fullmatch(re.escape(stem) + r" ([0-9]{1,9})", cut.name) for cut in self.cuts]
        return f"{stem} {max((int(match[1]) for match in numbers if match), default=0) + 1}"

    def with_cut(self, parts: tuple[Part, ...], stem: str = "Knife", kind: CutKind = "slice") -> Document:
        """One more cut, after all others."""
        return replace(self, cuts=(*self.cuts, Cut(self.next_id, self.next_name(stem), parts, kind)))

    def changed_cut(self, cut_id: int, change: Callable[[Cut], Cut]) -> Document:
        """The same with one cut changed."""
        self.cut(cut_id)
        return replace(self, cuts=tuple(change(cut) if cut.id == cut_id else cut for cut in self.cuts))

    def without_cut(self, cut_id: int) -> Document:
        """The same without the cut: what it parted is one again, what was cut after it stays cut."""
        self.cut(cut_id)
        cuts = tuple(
            replace(cut, parts=_distinct(tuple(replace(p, scope=_without(p.scope, cut_id)) for p in cut.parts)))
            for cut in self.cuts
            if cut.id != cut_id
        )
        kept = tuple((key, placement) for key, placement in self.placements if cut_id not in dict(key))
        return replace(self, cuts=cuts, placements=kept)

    # pieces

    def placement(self, key: Key) -> Placement:
        """How a piece lies: its own placement, or that of the piece it was cut from."""
        placements = dict(self.placements)
        for length in range(len(key), -1, -1):
            if key[:length] in placements:
                found = placements[key[:length]]
                return found if length == len(key) else replace(found, name="")
        return Placement()

    def placed(self, key: Key, change: Callable[[Placement], Placement]) -> Document:
        """The same with one piece's placement changed."""
        placements = dict(self.placements) | {key: change(self.placement(key))}
        return replace(self, placements=tuple(sorted(placements.items(), key=lambda item: item[0])))

    def reassembled(self) -> Document:
        """All pieces back where they were cut, shown, none removed; the cuts stay."""
        names = tuple((key, Placement(name=p.name)) for key, p in self.placements if p.name)
        return replace(self, placements=names, gap=0.0, explode=0.0)

    # families

    def family(self, kind: Kind) -> Family | None:
        """The family of this kind."""
        return next((family for family in self.families if family.kind == kind), None)

    def with_family(self, family: Family) -> Document:
        """The same with this family in the place of its kind's."""
        others = [f for f in self.families if f.kind != family.kind]
        return replace(self, families=tuple(sorted([*others, family], key=lambda f: list(COUNTS).index(f.kind))))

    def without_family(self, kind: Kind) -> Document:
        """The same without the family of this kind."""
        return replace(self, families=tuple(family for family in self.families if family.kind != kind))

    def with_exemplars(self, kind: Kind, paths: tuple[Path, ...]) -> Document:
        """The same with more pictures for a family, which is made where it is missing; a picture counts once."""
        family = self.family(kind) or Family(kind, COUNTS[kind])
        new = tuple(path for path in dict.fromkeys(paths) if path not in family.exemplars)
        return self.with_family(replace(family, exemplars=(*family.exemplars, *new)))


def agrees(scope: Key, key: Key) -> bool:
    """Whether a cut made for the piece `scope` meets the piece `key`: no cut they share has them on two sides."""
    sides = dict(scope)
    return all(sides.get(cut, side) == side for cut, side in key)


def _without(key: Key, cut_id: int) -> Key:
    """The key without a cut."""
    return tuple(step for step in key if step[0] != cut_id)


def _distinct(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """The first part of each scope: after a cut has gone, two parts may be meant for the same piece."""
    return tuple({part.scope: part for part in reversed(parts)}.values())[::-1]
