"""The process that saves a film of the window's; `app.jobs.film.film_job` starts it.

It reads one request as JSON from standard input, draws frame by frame and writes JSON lines to standard output. It
stops when its input is closed: the user has cancelled, or there is no window any more.
"""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.jobs.export import save_animation
from app.jobs.film.film_job import PROJECT
from app.jobs.film.frame_folder import save_frames
from app.model.film.motion import frame_count, frame_times
from app.model.film.timeline import played
from app.model.pieces import Solid, placed_pieces
from app.model.project import load_project
from engine.errors import InputError
from engine.io.files import open_file
from engine.io.mapped import map_arrays
from engine.render.face_detail import Detailed
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from fruitninja.drawing import drawing, frame
from training.priors.inside_file import read_inside

Frame = Callable[[], NDArray[np.uint8]]


def main() -> None:
    """Serves one request."""
    request = json.loads(sys.stdin.readline())
    stop = threading.Event()
    threading.Thread(target=_listen, args=(stop,), daemon=True).start()
    try:
        _write_line(frames=save(request, stop))
    except InputError as error:
        _write_line(error=str(error))
    except MemoryError:
        _write_line(error=f"{request['out']}: not enough memory; choose a smaller size")


def _listen(stop: threading.Event) -> None:
    """Waits until the window wants no more of it."""
    sys.stdin.read()
    stop.set()


def save(request: dict[str, Any], stop: threading.Event) -> int:
    """Saves the film, and returns how many frames it has. Raises InputError if that fails or `stop` is set."""
    folder, out = Path(request["folder"]), Path(request["out"])
    project = load_project(folder / PROJECT, outside=True)  # the window has written it
    solids = [_read_solid(entry) for entry in request["solids"]]
    numbers = [entry["number"] for entry in request["solids"]]
    details = [_read_detail(entry, atoms) for entry, atoms in zip(request["solids"], solids, strict=True)]
    samples = {n: Solid.of_atoms(atoms) for n, atoms in zip(numbers, solids, strict=True)}
    documents = tuple(document for document in project.documents if document.number in samples)
    shown, closed = played(project.film, documents, samples)
    count = frame_count(project.film.seconds, request["rate"])
    order = {number: k for k, number in enumerate(numbers)}
    ground = None if request["ground"] is None else tuple(request["ground"])
    width, height = request["size"]
    with drawing(solids, True) as (draw, who):

        def picture(number: int, time: float) -> NDArray[np.uint8]:
            if stop.is_set():
                raise InputError(f"{out}: stopped")
            eye, opened = shown(time)
            drawn = [
                piece
                for document in opened
                if document.visible
                for piece in placed_pieces(document, samples[document.number], order[document.number])
            ]
            camera = eye.camera(width, height, request["up"])
            rgba = frame(draw, details, camera, drawn, ground, request["light"])
            _write_line(part=(number + 1) / count)
            return rgba if ground is None or out.suffix else rgba[..., :3]

        def all_frames() -> Iterator[Frame]:
            for number, time in enumerate(frame_times(project.film.seconds, count, closed)):
                yield partial(picture, number, time)

        if out.suffix:
            return save_animation(out, (draw_one() for draw_one in all_frames()), request["rate"])
        settings = {key: request[key] for key in ("size", "rate", "ground", "up", "light")} | {"drawn": who}
        files = [folder / PROJECT, *(Path(entry["file"]) for entry in request["solids"])]
        save_frames(out, settings | {"of": [_hash(file) for file in files]}, all_frames())
        return count


def _read_solid(entry: dict[str, Any]) -> Atoms:
    arrays = map_arrays(Path(entry["file"]))
    surface = SurfaceAtoms(arrays["means"], arrays["scales"], arrays["quats"], arrays["sh"])
    return Atoms(
        surface, InteriorAtoms(arrays["inside"], arrays["sigmas"], arrays["rgb"], entry["exposed"]), entry["pitch"]
    )


def _read_detail(entry: dict[str, Any], atoms: Atoms) -> Detailed | None:
    """What faces are read from; the window has read the same file."""
    inside = None if entry["inside"] is None else read_inside(Path(entry["inside"]))
    return None if inside is None else Detailed(inside, atoms.pitch)


def _hash(path: Path) -> str:
    digest = sha256()
    with open_file(path) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _write_line(**facts: Any) -> None:
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    main()
