"""A film that another process saves (`app.jobs.film.film_worker`), while the user goes on using the window."""

from __future__ import annotations

import atexit
import contextlib
import json
import subprocess
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save_file

from app.jobs.export import ANIMATIONS, MOST_BYTES
from app.jobs.scene_loader import LoadedObject
from app.model.film.motion import frame_count
from app.model.film.timeline import FilmLook
from app.model.project import Project, save_project
from app.model.rigid_transform import Vec3
from engine.errors import InputError
from engine.io.files import WRITE_ERRORS, reason
from engine.io.scratch import Scratch
from engine.processes import start_python

__all__ = ["PROJECT", "FilmJob", "FilmRequest", "message_for", "too_large"]

PROJECT = "film.fruitninja"
"""Name of the project file in the folder that the process reads."""


@dataclass(frozen=True)
class FilmRequest:
    """What to save."""

    out: Path
    """A file (.webp, .gif, .mp4), or a folder of PNGs."""
    project: Project
    look: FilmLook
    ground: Vec3 | None
    """RGB behind the object, range [0, 1]; None: transparent."""
    up: Vec3
    """Which way is up in the view."""
    light: bool
    """Whether cut faces are lit."""
    loaded: Mapping[int, LoadedObject]
    """The objects that are solid, by the numbers of their documents, in the order of the documents."""


def too_large(out: Path, look: FilmLook, seconds: float) -> str:
    """Why a film cannot be saved in this form; empty if it can."""
    if out.suffix.lower() not in ANIMATIONS or out.suffix.lower() == ".mp4":
        return ""
    size = 4 * look.size[0] * look.size[1] * frame_count(seconds, look.rate)
    return f"{out.name}: too long or too large for {out.suffix}; choose a smaller size, or frames" * (size > MOST_BYTES)


def message_for(request: FilmRequest, folder: Path) -> dict[str, Any]:
    """Puts all that the process needs into a folder, and returns the message that describes it. Raises InputError if
    there is no room."""
    save_project(folder / PROJECT, request.project)
    solids = []
    for number, loaded in request.loaded.items():
        atoms = loaded.atoms
        assert atoms is not None
        s, i = atoms.surface, atoms.interior
        arrays = {"means": s.means, "scales": s.scales, "quats": s.quats, "sh": s.sh}
        arrays |= {"inside": i.means, "sigmas": i.sigmas, "rgb": i.rgb}
        file = folder / f"{number}.safetensors"
        contiguous: dict[str, NDArray[Any]] = {name: np.ascontiguousarray(a) for name, a in arrays.items()}
        try:
            save_file(contiguous, file)
        except WRITE_ERRORS as error:
            raise InputError(f"{folder.parent}: no room in the temporary folder ({reason(error)})") from error
        scene = loaded.request.trained or loaded.request.scene
        inside = None if loaded.inside is None else str(scene.absolute())
        solids.append(
            {
                "number": number,
                "file": str(file),
                "pitch": float(atoms.pitch),
                "inside": inside,
            }
        )
    return {
        "folder": str(folder),
        "out": str(request.out.absolute()),
        "size": list(request.look.size),
        "rate": request.look.rate,
        "ground": None if request.ground is None else list(request.ground),
        "up": list(request.up),
        "light": request.light,
        "solids": solids,
    }


class FilmJob:
    """Saves one film, in a thread and a process of its own; the attributes tell the window how far it is."""

    def __init__(self, request: FilmRequest) -> None:
        """Raises InputError without a temporary folder."""
        self.out = request.out
        self.fraction = 0.0
        """Part that is drawn. Range [0, 1]."""
        self.frames = 0
        """Number of the film's frames, once it is saved."""
        self.error = ""
        """Why it could not be saved, in one line."""
        self.cancelled = False
        self.ended = False
        self._scratch = Scratch("fruitninja-film-")
        self._process: subprocess.Popen[bytes] | None = None
        self._errors = b""
        atexit.register(self._clear)
        self._thread = threading.Thread(target=self._run, args=(request,), daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """Stops after the frame that is being drawn; no file is written, but frames in a folder stay."""
        self.cancelled = True
        process = self._process
        if process is not None and process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()

    def _run(self, request: FilmRequest) -> None:
        try:
            message = message_for(request, self._scratch.path)
            if not self.cancelled:
                self._follow(message)
        except InputError as error:
            self.error = str(error)
        except Exception as error:  # otherwise the window would wait for ever
            self.error = f"{self.out}: could not be saved ({error})"
        if self.cancelled:
            self.error = ""
        self.ended = True
        atexit.unregister(self._clear)
        self._clear()

    def _follow(self, message: dict[str, Any]) -> None:
        pipe = subprocess.PIPE
        self._process = process = start_python("app.jobs.film.film_worker", stdin=pipe, stdout=pipe, stderr=pipe)
        threading.Thread(target=self._collect_errors, args=(process,), daemon=True).start()
        assert process.stdin is not None and process.stdout is not None
        with contextlib.suppress(OSError, ValueError):
            process.stdin.write((json.dumps(message) + "\n").encode())
            process.stdin.flush()  # stdin stays open: the process stops when it is closed
        done = False
        with process.stdout as lines:
            for text in lines:
                try:
                    line = json.loads(text)
                except ValueError:
                    continue  # printed by a library
                self.fraction = float(line.get("part", self.fraction))
                self.error = str(line.get("error", self.error))
                self.frames = int(line.get("frames", self.frames))
                done = done or "error" in line or "frames" in line
        process.wait()
        if not done:
            last = self._errors.decode("utf-8", "replace").strip().splitlines()[-1:] or ["it gave no reason"]
            raise InputError(f"{self.out}: could not be saved ({last[0]})")

    def _collect_errors(self, process: subprocess.Popen[bytes]) -> None:
        """Keeps the end of what the process writes to standard error, to explain a crash."""
        assert process.stderr is not None
        with process.stderr as lines:
            for line in lines:
                self._errors = (self._errors + line)[-4096:]

    def _clear(self) -> None:
        """Leaves neither a process nor files behind, even if the app ends before the film."""
        if self._process is not None:
            self._process.kill()
        self._scratch.close()
