"""The process that saves a film for the window; `app.jobs.film.film_job` starts it.

It reads one request as JSON from standard input, draws frame by frame and writes JSON lines to standard output. It
stops when its input is closed: the user has cancelled, or there is no window any more.
"""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from typing import Any

from app.jobs.film.film_job import PROJECT
from app.jobs.film.project_film import Filmed, Shooting, save_project_film
from app.model.film.timeline import FilmLook
from app.model.project import load_project
from engine.errors import InputError
from engine.io.mapped import map_arrays
from engine.render.face_detail import Detailed
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from training.priors.inside_file import read_inside


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
    """Waits until the window closes the input, and sets `stop`."""
    sys.stdin.read()
    stop.set()


def save(request: dict[str, Any], stop: threading.Event) -> int:
    """Saves the film, and returns the number of its frames. Raises InputError if that fails or `stop` is set."""
    folder, out = Path(request["folder"]), Path(request["out"])
    project = load_project(folder / PROJECT, outside=True)  # the window has written it

    def drawn(part: float) -> None:
        if stop.is_set():
            raise InputError(f"{out}: stopped")
        _write_line(part=part)

    objects = {entry["number"]: _read_object(entry) for entry in request["solids"]}
    look = FilmLook(tuple(request["size"]), request["rate"])
    ground = None if request["ground"] is None else tuple(request["ground"])
    shooting = Shooting(look, ground, tuple(request["up"]), request["light"])
    sources = [folder / PROJECT, *(Path(entry["file"]) for entry in request["solids"])]
    return save_project_film(out, project, objects, shooting, sources, drawn)


def _read_object(entry: dict[str, Any]) -> Filmed:
    """An object, and what its faces are read from, which the window has read from the same files."""
    arrays = map_arrays(Path(entry["file"]))
    surface = SurfaceAtoms(arrays["means"], arrays["scales"], arrays["quats"], arrays["sh"])
    interior = InteriorAtoms(arrays["inside"], arrays["sigmas"], arrays["rgb"])
    inside = None if entry["inside"] is None else read_inside(Path(entry["inside"]))
    detail = None if inside is None else Detailed(inside, entry["pitch"])
    return Filmed(Atoms(surface, interior, entry["pitch"]), detail)


def _write_line(**facts: Any) -> None:
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    main()
