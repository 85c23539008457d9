"""Draws the film of a project: into one file, or frame by frame into a folder, where a stopped film is continued."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.jobs.export import save_animation
from app.jobs.film.frame_folder import save_frames
from app.model.film.motion import frame_count, frame_times
from app.model.film.timeline import FilmLook, played
from app.model.pieces import PointSample, placed_pieces
from app.model.project import Project
from app.model.rigid_transform import Vec3
from engine.io.files import open_file
from engine.render.face_detail import Detailed
from engine.scene.atoms import Atoms
from fruitninja.drawing import drawing, frame

__all__ = ["Filmed", "Shooting", "save_project_film"]

Frame = Callable[[], NDArray[np.uint8]]


@dataclass(frozen=True)
class Filmed:
    """A solid object of the project."""

    atoms: Atoms
    detail: Detailed | None
    """What its faces are read from; None: the atoms."""


@dataclass(frozen=True)
class Shooting:
    """How a film is drawn."""

    look: FilmLook
    ground: Vec3 | None
    """RGB behind the objects, range [0, 1]; None: transparent."""
    up: Vec3
    """Which way is up in the view."""
    light: bool
    """Whether cut faces are lit."""

    def record(self) -> dict[str, Any]:
        """The settings as JSON."""
        return {
            "size": list(self.look.size),
            "rate": self.look.rate,
            "ground": None if self.ground is None else list(self.ground),
            "up": list(self.up),
            "light": self.light,
        }


def save_project_film(
    out: Path,
    project: Project,
    objects: Mapping[int, Filmed],
    shooting: Shooting,
    sources: Sequence[Path],
    drawn: Callable[[float], None],
) -> int:
    """Saves the film of a project with at least one keyframe, and returns the number of its frames.

    `objects`: those that are solid, by the numbers of their documents. `sources`: the files that decide what they look
    like. `drawn` is called before each frame with the part that is drawn, range [0, 1], and may raise to stop. Raises
    InputError if the film cannot be saved.
    """
    samples = {number: PointSample.of_atoms(one.atoms) for number, one in objects.items()}
    documents = tuple(document for document in project.documents if document.number in samples)
    shown, closed = played(project.film, documents, samples)
    look, seconds = shooting.look, project.film.seconds
    count = frame_count(seconds, look.rate)
    order = {number: k for k, number in enumerate(objects)}
    details = [one.detail for one in objects.values()]
    with drawing([one.atoms for one in objects.values()], True) as (draw, who):

        def picture(number: int, time: float) -> NDArray[np.uint8]:
            drawn(number / count)
            eye, opened = shown(time)
            pieces = [
                piece
                for document in opened
                if document.visible
                for piece in placed_pieces(document, samples[document.number], order[document.number])
            ]
            rgba = frame(draw, details, eye.camera(*look.size, shooting.up), pieces, shooting.ground, shooting.light)
            return rgba if shooting.ground is None or out.suffix else rgba[..., :3]

        def all_frames() -> Iterator[Frame]:
            for number, time in enumerate(frame_times(seconds, count, closed)):
                yield partial(picture, number, time)

        if out.suffix:
            save_animation(out, (draw_one() for draw_one in all_frames()), look.rate)
        else:
            settings = shooting.record() | {"drawn": who, "of": [_hash_of(path) for path in sources]}
            save_frames(out, settings, all_frames())
    return count


def _hash_of(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal."""
    digest = sha256()
    with open_file(path) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
