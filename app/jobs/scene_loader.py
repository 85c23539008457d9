"""Follows the process that reads a scene and makes it solid, so that the window never waits for it."""

from __future__ import annotations

import atexit
import contextlib
import json
import queue
import subprocess
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file

from app.model.pieces import Solid
from app.model.rigid_transform import Vec3
from engine.io.scratch import Scratch
from engine.processes import start_python
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from training.settings import DetailName

__all__ = ["Object", "Preparing", "Request"]


@dataclass(frozen=True)
class Request:
    """What is to be read."""

    scene: Path
    detail: DetailName = "standard"
    seed: int = 0
    trained: Path | None = None
    """A finished training result for this scene, shown in place of a plain inside."""


@dataclass(frozen=True)
class Object:
    """What the window shows, as far as it is there."""

    request: Request
    capture: Gaussians | None = None
    atoms: Atoms | None = None
    solid: Solid | None = None
    """Of the atoms; of the capture while there are none."""
    up: Vec3 = (0.0, 0.0, 1.0)
    """As detected."""
    up_reason: str = ""
    notes: tuple[str, ...] = ()
    trained: bool = False
    """The inside was trained."""


class Preparing:
    """One scene on its way. Poll it; what is ready comes in steps: the capture first, then the atoms."""

    def __init__(self, request: Request) -> None:
        self.request = request
        self.stage = f"Opening {request.scene.name}"
        self.part = 0.0
        self.error = ""
        """One line for the user; what was ready before it stays."""
        self.ended = False
        self.ready = False
        """The user has been told that it can be cut."""
        self.object = Object(request)
        self._queue: queue.SimpleQueue[tuple[dict[str, Any], dict[str, NDArray[Any]]]] = queue.SimpleQueue()
        self._scratch = Scratch("fruitninja-")
        pipe = subprocess.PIPE
        self._process = start_python("app.jobs.scene_worker", stdin=pipe, stdout=pipe, stderr=pipe)
        self._threads = [
            threading.Thread(target=self._listen, daemon=True),
            threading.Thread(target=self._keep_errors, daemon=True),
        ]
        self._errors = b""
        atexit.register(self._clear)
        for thread in self._threads:
            thread.start()
        trained = None if request.trained is None else str(request.trained.absolute())
        asked: dict[str, Any] = {"scene": str(request.scene.absolute()), "folder": str(self._scratch.path)}
        asked |= {"detail": request.detail, "seed": request.seed, "trained": trained}
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write((json.dumps(asked) + "\n").encode())
            self._process.stdin.close()

    def poll(self) -> bool:
        """Takes what has come; True where `object` has grown."""
        grown = False
        while not self.ended:
            try:
                said, arrays = self._queue.get_nowait()
            except queue.Empty:
                break
            self.stage = str(said.get("stage", self.stage))
            self.part = float(said.get("part", self.part))
            self.error = str(said.get("error", self.error))
            if "ready" in said:
                self._take(said["ready"], arrays, said["facts"])
                grown = True
            self.ended = bool(said.get("end"))
        return grown

    def cancel(self) -> None:
        """Stops at once; what was ready stays."""
        self.ended = True
        self._process.kill()

    def _take(self, what: str, arrays: dict[str, NDArray[Any]], facts: dict[str, Any]) -> None:
        if what == "capture":
            x, y, z = facts["up"]
            capture = Gaussians(*(arrays[name] for name in ("means", "scales", "quats", "opacities", "sh")))
            # Most captures have a few stray Gaussians far away; they must not decide what fits the window.
            low, high = np.percentile(capture.means, [2, 98], axis=0) if len(capture) else np.zeros((2, 3))
            near = capture.means[((capture.means >= low) & (capture.means <= high)).all(1)]
            self.object = replace(
                self.object,
                capture=capture,
                solid=Solid.of(near),
                up=(x, y, z),
                up_reason=facts["reason"],
                notes=tuple(facts["warnings"]),
            )
            return
        surface = SurfaceAtoms(arrays["means"], arrays["scales"], arrays["quats"], arrays["sh"])
        interior = InteriorAtoms(arrays["inside"], arrays["sigmas"], arrays["rgb"], facts["exposed"])
        atoms = Atoms(surface, interior, facts["pitch"])
        notes = tuple(dict.fromkeys((*self.object.notes, *facts["notes"])))
        self.object = replace(
            self.object, atoms=atoms, solid=Solid.of_atoms(atoms), notes=notes, trained=facts["trained"]
        )

    def _listen(self) -> None:
        """Reads lines, and the files they name, away from the window's thread."""
        assert self._process.stdout is not None
        ended = False
        for line in self._process.stdout:
            try:
                said = json.loads(line)
            except ValueError:
                continue  # a library that prints
            arrays = load_file(said["file"]) if "file" in said else {}
            ended = ended or bool(said.get("end"))
            self._queue.put((said, arrays))
        self._process.wait()
        if not ended:
            self._threads[1].join(1.0)
            last = self._errors.decode("utf-8", "replace").strip().splitlines()[-1:] or ["it gave no reason"]
            name = self.request.scene.name
            self._queue.put(({"error": f"{name}: opening it failed ({last[0]})", "end": True}, {}))
        atexit.unregister(self._clear)
        self._clear()

    def _clear(self) -> None:
        """Leaves neither a process nor files behind, even when the app ends in the middle."""
        self._process.kill()
        self._scratch.close()

    def _keep_errors(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._errors = (self._errors + line)[-4096:]
