"""Loads a scene in another process (`app.jobs.scene_worker`), so that the window never waits for it."""

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

from app.model.pieces import PointSample
from app.model.rigid_transform import Vec3
from app.translation import _
from engine.errors import InputError
from engine.io.fields import Fields
from engine.io.files import reason
from engine.io.mapped import map_arrays
from engine.io.scratch import Scratch
from engine.isolate.record import isolation_record, read_isolation
from engine.isolate.selection import Isolation
from engine.processes import start_python
from engine.render.culling.drawable import Drawable
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.inside import Inside
from training.settings import DetailName

__all__ = ["LoadedObject", "SceneLoader", "SceneRequest"]


LOOKED_AT = 300_000
"""Most centres that are used to find how large a capture is."""


@dataclass(frozen=True)
class SceneRequest:
    """The scene to load, and how fine to make it."""

    scene: Path
    detail: DetailName = "standard"
    seed: int = 0
    trained: Path | None = None
    """A finished training result of this scene, loaded in place of a plain inside."""
    isolation: Isolation = ()
    """The parts of the scene that do not belong to the object."""
    opened: bool = False
    """Whether the scene has just been opened, so that nobody has isolated the object yet: surroundings are left out."""
    refit: bool = False
    """Whether the object is shown already, so that only a skin fitted as closely as training does is wanted."""


@dataclass(frozen=True)
class LoadedObject:
    """As much of a scene as has been loaded so far."""

    request: SceneRequest
    capture: Gaussians | None = None
    """The whole capture, including what does not belong to the object."""
    atoms: Atoms | None = None
    solid: PointSample | None = None
    """The points of the atoms, or of the capture before there are atoms."""
    outline: PointSample | None = None
    """The points of the capture, including what lies beside the body: a mat, leaves. None until they are known."""
    up: Vec3 = (0.0, 0.0, 1.0)
    """Detected up axis, unit vector."""
    up_reason: str = ""
    """Why this axis, in words."""
    notes: tuple[str, ...] = ()
    """What the user should know about the scene, one line each."""
    trained: bool = False
    """Whether the inside has been trained."""
    rough: bool = False
    """Whether the skin can still be fitted more closely."""
    coarse: Gaussians | None = None
    """Some of a large capture's Gaussians, enlarged, to be shown until all are loaded."""
    drawn: Drawable | None = None
    """The atoms prepared for drawing, in a thread that the window does not wait for."""
    inside: Inside | None = None
    """What the faces of a trained object are read from when the view is at rest; None if it has only atoms."""

    @property
    def extent(self) -> NDArray[np.float64]:
        """(N, 3). Points of the visible part of the capture; none until something is loaded."""
        seen = self.outline or self.solid
        return np.zeros((0, 3)) if seen is None else seen.points


class SceneLoader:
    """Loads one scene. `poll` delivers it step by step: the capture, preceded by a sample if it is large, then the
    atoms. Of a trained object, the atoms come first."""

    def __init__(self, request: SceneRequest, shown: LoadedObject | None = None) -> None:
        """`shown`: what is shown of the object already, if it is only to be fitted again."""
        self.request = request
        opening = _("Opening {name}").format(name=request.scene.name)
        self.stage = _("Matching the skin in detail") if request.refit else opening
        """What is being done, in words."""
        self.fraction = 0.0
        """Part that is done. Range [0, 1]."""
        self.error = ""
        """Why loading ended early, in one line; what was loaded before stays."""
        self.ended = False
        self.announced = False
        """Whether the user has been told that the object can be cut."""
        self.scene = LoadedObject(request) if shown is None else replace(shown, request=request)
        self._queue: queue.SimpleQueue[tuple[dict[str, Any], dict[str, Any]]] = queue.SimpleQueue()
        self._scratch = Scratch("fruitninja-")
        pipe = subprocess.PIPE
        self._process = start_python("app.jobs.scene_worker", stdin=pipe, stdout=pipe, stderr=pipe)
        self._threads = [
            threading.Thread(target=self._listen, daemon=True),
            threading.Thread(target=self._collect_errors, daemon=True),
        ]
        self._errors = b""
        atexit.register(self._clear)
        for thread in self._threads:
            thread.start()
        trained = None if request.trained is None else str(request.trained.absolute())
        message: dict[str, Any] = {"scene": str(request.scene.absolute()), "folder": str(self._scratch.path)}
        message |= {"detail": request.detail, "seed": request.seed, "trained": trained}
        message |= {"isolation": isolation_record(request.isolation), "opened": request.opened}
        message |= {"refit": request.refit}
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write((json.dumps(message) + "\n").encode())
            self._process.stdin.close()

    def poll(self) -> bool:
        """Takes over what has arrived; True if `scene` has grown."""
        grown = False
        while not self.ended:
            try:
                line, arrays = self._queue.get_nowait()
            except queue.Empty:
                break
            self.stage = str(line.get("stage", self.stage))
            self.fraction = float(line.get("part", self.fraction))
            self.error = str(line.get("error", self.error))
            if "ready" in line:
                self._take(line["ready"], arrays, line["facts"])
                grown = True
            self.ended = bool(line.get("end"))
        return grown

    def cancel(self) -> None:
        """Stops at once; what was loaded stays."""
        self.ended = True
        self._process.kill()

    def _take(self, what: str, arrays: dict[str, Any], facts: dict[str, Any]) -> None:
        if what == "inside":
            notes = tuple(dict.fromkeys((*self.scene.notes, *facts["notes"])))
            self.scene = replace(self.scene, inside=arrays["inside"], notes=notes)
            return
        if what in ("coarse", "capture"):
            gaussians = Gaussians(*(arrays[name] for name in ("means", "scales", "quats", "opacities", "sh")))
            x, y, z = facts["up"]
            if what == "coarse":
                self.scene = replace(self.scene, coarse=gaussians, solid=arrays["solid"], up=(x, y, z))
                return
            isolation = read_isolation(Fields(self.request.scene, "request"), facts["isolation"])
            self.request = replace(self.request, isolation=isolation, opened=False)
            self.scene = replace(
                self.scene,
                request=self.request,
                capture=gaussians,
                coarse=None,
                solid=self.scene.solid if self.scene.atoms is not None else arrays["solid"],
                outline=arrays["solid"],
                up=(x, y, z),
                up_reason=facts["reason"],
                notes=tuple(facts["warnings"]),
            )
            return
        drawn: Drawable = arrays["drawn"]
        notes = tuple(dict.fromkeys((*self.scene.notes, *facts["notes"])))
        self.scene = replace(
            self.scene,
            atoms=drawn.atoms,
            drawn=drawn,
            solid=arrays["solid"],
            notes=notes,
            trained=facts["trained"],
            rough=facts["rough"],
        )
        if "up" in facts:  # a trained object, whose atoms come before its capture
            x, y, z = facts["up"]
            self.scene = replace(self.scene, up=(x, y, z), up_reason=facts["reason"])

    def _listen(self) -> None:
        """Reads the lines, and the files that they name, in a thread of its own."""
        try:
            self._read_lines()
        except Exception as error:  # otherwise the window would wait for a dead thread
            name = self.request.scene.name
            self._queue.put(({"error": f"{name}: opening it failed ({reason(error)})", "end": True}, {}))
        atexit.unregister(self._clear)
        self._clear()

    def _read_lines(self) -> None:
        assert self._process.stdout is not None
        ended = False
        with self._process.stdout as lines:
            for text in lines:
                try:
                    line = json.loads(text)
                except ValueError:
                    continue  # printed by a library
                arrays = _prepared(line, map_arrays(Path(line["file"]))) if "file" in line else {}
                ended = ended or bool(line.get("end"))
                self._queue.put((line, arrays))
                if line.get("ready") == "atoms" and line["facts"]["trained"]:
                    self._read_inside()
        self._process.wait()
        if not ended:
            self._threads[1].join(1.0)
            last = self._errors.decode("utf-8", "replace").strip().splitlines()[-1:] or ["it gave no reason"]
            name = self.request.scene.name
            self._queue.put(({"error": f"{name}: opening it failed ({last[0]})", "end": True}, {}))

    def _read_inside(self) -> None:
        """Reads the inside of the trained object whose atoms have arrived."""
        from training.priors.inside_file import read_inside  # only trained objects need its kernels

        self._queue.put(({"stage": _("Reading the inside"), "part": 0.9}, {}))
        inside, notes = None, []
        try:
            inside = read_inside(self.request.trained or self.request.scene)
        except InputError as error:
            notes = [str(error)]
        self._queue.put(({"ready": "inside", "facts": {"notes": notes}}, {"inside": inside}))

    def _clear(self) -> None:
        """Leaves neither a process nor files behind, even if the app ends while loading."""
        self._process.kill()
        self._scratch.close()

    def _collect_errors(self) -> None:
        """Keeps the end of what the process writes to standard error, to explain a crash."""
        assert self._process.stderr is not None
        with self._process.stderr as lines:
            for line in lines:
                self._errors = (self._errors + line)[-4096:]


def _prepared(line: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
    """The arrays of a line with whatever takes time to make of them, made in the thread that reads them."""
    if line["ready"] == "atoms":
        surface = SurfaceAtoms(arrays["means"], arrays["scales"], arrays["quats"], arrays["sh"])
        interior = InteriorAtoms(arrays["inside"], arrays["sigmas"], arrays["rgb"])
        atoms = Atoms(surface, interior, line["facts"]["pitch"])
        return {"drawn": Drawable(atoms), "solid": PointSample.of_atoms(atoms)}
    means = arrays["means"]
    step = -(-len(means) // LOOKED_AT) or 1
    means = means[::step]
    return arrays | {"solid": _extent(means[~arrays["removed"][::step]] if "removed" in arrays else means)}


def _extent(means: NDArray[np.float32]) -> PointSample:
    """A solid of centres (N, 3), without the few outliers that most captures have: these must not determine what fits
    the window."""
    low, high = np.percentile(means, [2, 98], axis=0) if len(means) else np.zeros((2, 3))
    return PointSample.of(means[((means >= low) & (means <= high)).all(1)])
