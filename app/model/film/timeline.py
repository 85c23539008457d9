"""The film of a project: keyframes of the view, the planes and the explosion, with the motion of all films between them
(`app.model.film.motion`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from app.model.camera_control import OrbitCamera
from app.model.document import DEFAULT_GAP, Cut, Document, Part
from app.model.film import presets
from app.model.film.motion import Film, Keyframe, motion, seen
from app.model.film.record import LONGEST
from app.model.pieces import PointSample
from app.model.rigid_transform import Vec3
from engine.scene.plane import Plane

__all__ = [
    "BACKGROUNDS",
    "Background",
    "FilmLook",
    "Opened",
    "SceneKeyframe",
    "Timeline",
    "exploding",
    "played",
    "sweeping",
    "turning",
]

APART = 0.1
"""Least seconds between two keyframes: nobody could see more of them, and none hides another on the timeline."""

MARGIN = 0.02
"""Distance in radii that a plane that opens nothing keeps from the object."""

Background = Literal["window", "white", "black", "own", "transparent"]
BACKGROUNDS: tuple[Background, ...] = get_args(Background)


@dataclass(frozen=True)
class FilmLook:
    """How a film is saved."""

    size: tuple[int, int] = (1920, 1080)
    """Width, height in pixels."""
    rate: float = 25.0
    """Frames a second."""
    background: Background = "white"
    colour: Vec3 = (0.0, 0.45, 0.4)
    """Colour of the background `own`. RGB, range [0, 1]."""


@dataclass(frozen=True)
class Opened:
    """How one object is opened."""

    number: int
    """Number of its document."""
    gap: float
    explode: float
    """As in the document."""
    planes: tuple[tuple[int, Plane], ...] = ()
    """Planes of its sections in object space, each after the id of its cut."""

    @staticmethod
    def of(document: Document) -> Opened:
        """How an object is opened in its document."""
        planes = ((cut.id, cut.plane(cut.parts[0])) for cut in document.cuts if cut.kind == "section" and cut.on)
        return Opened(document.number, document.gap, document.explode, tuple(planes))


@dataclass(frozen=True)
class SceneKeyframe:
    """What the window shows at one time of the film: the view, and how all objects are opened."""

    time: float
    """Seconds. Range [0, inf)."""
    eye: OrbitCamera
    objects: tuple[Opened, ...] = ()

    @staticmethod
    def of(time: float, eye: OrbitCamera, documents: tuple[Document, ...]) -> SceneKeyframe:
        """What is shown now, as the keyframe at a time."""
        return SceneKeyframe(time, eye, tuple(Opened.of(document) for document in documents))


@dataclass(frozen=True)
class Timeline:
    """The keyframes of a film, sorted by time."""

    keyframes: tuple[SceneKeyframe, ...] = ()

    @property
    def seconds(self) -> float:
        """How long the film is: the time of its last keyframe."""
        return self.keyframes[-1].time if self.keyframes else 0.0

    def at(self, time: float) -> int | None:
        """Index of the keyframe at a time, if there is one."""
        near = [k for k, one in enumerate(self.keyframes) if abs(one.time - time) < APART / 2]
        return near[0] if near else None

    def with_keyframe(self, new: SceneKeyframe) -> Timeline:
        """With a keyframe added; it replaces one at the same time."""
        others = [other for other in self.keyframes if abs(other.time - new.time) >= APART / 2]
        return Timeline(tuple(sorted([*others, new], key=lambda one: one.time)))

    def without(self, index: int) -> Timeline:
        """Without one of the keyframes."""
        return Timeline(self.keyframes[:index] + self.keyframes[index + 1 :])

    def renumbered(self, old: int, new: tuple[int, ...]) -> Timeline:
        """With objects of the new numbers in place of one, each opened as that was."""
        keyframes = []
        for one in self.keyframes:
            kept = [opened for opened in one.objects if opened.number not in (old, *new)]
            made = [replace(opened, number=n) for opened in one.objects if opened.number == old for n in new]
            keyframes.append(replace(one, objects=(*kept, *made)))
        return Timeline(tuple(keyframes))

    def moved(self, index: int, time: float) -> Timeline:
        """With a keyframe moved to another time, kept between its neighbours."""
        low = self.keyframes[index - 1].time + APART if index else 0.0
        high = self.keyframes[index + 1].time - APART if index + 1 < len(self.keyframes) else LONGEST
        new = replace(self.keyframes[index], time=float(np.clip(round(time, 2), low, max(low, high))))
        return Timeline((*self.keyframes[:index], new, *self.keyframes[index + 1 :]))


Played = Callable[[float], tuple[OrbitCamera, tuple[Document, ...]]]
"""The camera of a film at a time, and the documents as the film shows them then."""


def played(
    timeline: Timeline, documents: tuple[Document, ...], solids: Mapping[int, PointSample]
) -> tuple[Played, bool]:
    """What a film of at least one keyframe shows at any time, and whether it loops without a jolt.

    `solids`: those of the documents, by their numbers. A plane that a keyframe does not have opens nothing then: it has
    left the object. What the keyframes do not record, such as pieces that were moved, stays as it is in the documents.
    """
    films = [_Tracks.of(timeline, document, solids[document.number]) for document in documents]
    closed = all(one.film.closed for one in films)
    curves = [motion(one.film, solids[d.number].centre, closed) for one, d in zip(films, documents, strict=True)]
    # A zoom is the inverse of the distance, and a target the place itself, for an eye at distance 1 from the origin.
    origin = replace(timeline.keyframes[0].eye, target=(0.0, 0.0, 0.0), distance=1.0)

    def at(time: float) -> tuple[OrbitCamera, tuple[Document, ...]]:
        shown = [curve(min(max(time, 0.0), timeline.seconds)) for curve in curves]
        opened = (one.opened(document, key) for one, document, key in zip(films, documents, shown, strict=True))
        return seen(origin, shown[0]), tuple(opened)

    return at, closed


@dataclass(frozen=True)
class _Tracks:
    """The film of one object, and the id of the cut that each of its planes belongs to."""

    film: Film
    ids: tuple[int, ...]

    @staticmethod
    def of(timeline: Timeline, document: Document, solid: PointSample) -> _Tracks:
        found = [next((o for o in one.objects if o.number == document.number), None) for one in timeline.keyframes]
        known = [opened for opened in found if opened is not None] or [Opened.of(document)]
        states = [known[0] if opened is None else opened for opened in found]
        tracks = [(id_, run) for id_ in _ids(states) for run in _runs([dict(s.planes).get(id_) for s in states])]
        keys = []
        for k, (one, state) in enumerate(zip(timeline.keyframes, states, strict=True)):
            planes = tuple(run[k] or _outside(run, k, solid) for _, run in tracks)
            eye = one.eye
            keys.append(
                Keyframe(
                    one.time, eye.azimuth, eye.elevation, 1 / eye.distance, planes, state.explode, state.gap, eye.target
                )
            )
        if keys[0].time > 0 or len(keys) == 1:  # until then nothing moves
            keys.insert(0, replace(keys[0], time=0.0))
        if keys[0].time == keys[1].time:
            keys[1] = replace(keys[1], time=1.0)  # a single keyframe at the beginning is a still
        return _Tracks(Film(tuple(keys)), tuple(id_ for id_, _ in tracks))

    def opened(self, document: Document, shown: Keyframe) -> Document:
        """A document opened as in a frame."""
        slices = tuple(cut for cut in document.cuts if cut.kind == "slice")
        sections = (Cut(id_, "", (Part(plane),), "section") for id_, plane in zip(self.ids, shown.planes, strict=True))
        return replace(document, gap=shown.parted, explode=shown.explosion, cuts=(*slices, *sections))


def _ids(states: list[Opened]) -> list[int]:
    """Ids of the cuts that the planes belong to, each once."""
    return list(dict.fromkeys(id_ for state in states for id_, _ in state.planes))


def _runs(planes: list[Plane | None]) -> list[list[Plane | None]]:
    """A plane over the keyframes, split where it turns by more than 90 degrees: one plane leaves, another one comes."""
    runs: list[list[Plane | None]] = []
    last: Plane | None = None
    for k, plane in enumerate(planes):
        if plane is None:
            continue
        if last is None or np.dot(last.normal, plane.normal) < -1e-9:
            runs.append([None] * len(planes))
        runs[-1][k] = last = plane
    return runs


def _outside(run: list[Plane | None], k: int, solid: PointSample) -> Plane:
    """A plane that stands in where one is missing at keyframe `k`: turned as before, or else as later, but outside the
    object, so that it opens nothing."""
    before, after = [p for p in run[:k] if p is not None], [p for p in run[k:] if p is not None]
    normal = (before[-1] if before else after[0]).normal
    reach = float((solid.points @ np.asarray(normal)).max()) if len(solid.points) else 0.0
    return Plane(normal, -reach - MARGIN * solid.radius)


def turning(now: SceneKeyframe, seconds: float) -> Timeline:
    """Once around what is shown now."""
    film = presets.turntable(Keyframe(0.0, now.eye.azimuth, now.eye.elevation), seconds)
    return Timeline(
        tuple(replace(now, time=key.time, eye=replace(now.eye, azimuth=key.azimuth)) for key in film.keyframes)
    )


def sweeping(
    now: SceneKeyframe, seconds: float, number: int, cut_id: int, plane: Plane, solid: PointSample
) -> Timeline:
    """A plane that moves through the object of this number and back. `cut_id`: the cut that it belongs to."""
    film = presets.sweep(Keyframe(0.0, 0.0, 0.0), seconds, plane, solid.points)

    def at(key: Keyframe) -> SceneKeyframe:
        moved = (cut_id, key.planes[0])
        objects = (
            replace(one, planes=(moved, *(pair for pair in one.planes if pair[0] != cut_id)))
            if one.number == number
            else one
            for one in now.objects
        )
        return replace(now, time=key.time, objects=tuple(objects))

    return Timeline(tuple(at(key) for key in film.keyframes))


def exploding(now: SceneKeyframe, seconds: float) -> Timeline:
    """The pieces move apart and together again."""
    film = presets.explode(Keyframe(0.0, 0.0, 0.0), seconds, ())

    def at(key: Keyframe) -> SceneKeyframe:
        gap = DEFAULT_GAP * key.explosion
        objects = tuple(replace(one, gap=gap, explode=key.explosion) for one in now.objects)
        return SceneKeyframe(key.time, replace(now.eye, distance=now.eye.distance / key.zoom), objects)

    return Timeline(tuple(at(key) for key in film.keyframes))
