"""A training job: `fruitninja-train` in another process, followed through the events that it writes to a file.

The job outlives the window, and the next window finds and follows it. Its events and output are in the result folder
(`events.jsonl`, `job.log`). Its request, its document and the process that runs it are recorded in the app's own state
folder: a result folder may come from a stranger, and nothing read from it may start, pause or end a process.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import psutil

from app.jobs.job_events import Progress, read_line
from app.model.document import Document
from app.model.project import SUFFIX, Project, Viewing, load_project, save_project
from app.model.rigid_transform import Vec3
from app.model.settings import state_folder
from app.translation import _
from engine.errors import InputError, one_line
from engine.io.files import atomic, open_file, read_file, reason, write_json
from engine.processes import start_python
from training.families import Family, Kind
from training.request import Request

__all__ = ["Job", "missing_for_training", "note_path", "request_for", "request_path"]

LOG_TAIL = 6
"""Lines at the end of a job's output that are shown if it fails."""

LOG_TAIL_BYTES = 8192
"""Bytes at the end of a job's output in which these lines are looked for: more than six lines of a traceback."""

READ_AT_ONCE = 1 << 20
"""Bytes of events read in one poll, so that catching up with a long job does not delay a frame; a line of the trainer
has a few hundred."""

NOTE_LIMIT = 1 << 16
"""Bytes of the largest note that is read; a real one has a hundred."""


def missing_for_training(document: Document) -> str:
    """What the user still has to provide before training can start; empty if nothing is missing."""
    if document.scene is None:
        return _("Open an object first.")
    if document.training.prior == "stable-diffusion":
        if document.training.model is None:
            return _("Choose the folder of a Stable Diffusion depth model, under More.")
        if not document.families:
            return _("Add a family of cuts first.")
    elif not any(family.exemplars for family in document.families):
        return _("Add a picture of a cut face first: drop one on a family, or choose one.")
    absent = [path for family in document.families for path in family.exemplars if not path.is_file()]
    if not absent:
        return ""
    return _("The picture {name} is no longer there. Remove it or put it back.").format(name=absent[0].name)


def request_for(document: Document, up: Vec3) -> Request:
    """The trainer's request for a document with this up axis. Raises InputError if something is missing."""
    if missing := missing_for_training(document):
        raise InputError(missing)
    assert document.scene is not None
    training = document.training
    families = sorted(document.families, key=lambda family: get_args(Kind).index(family.kind))
    diffusion = training.prior == "stable-diffusion"
    return Request(
        scene=document.scene,
        families=tuple(_trained_family(family) for family in families),
        detail=training.detail,
        up=up,
        seed=training.seed,
        iterations=training.iterations,
        prior=training.prior,
        model=training.model if diffusion else None,
        thing=(training.thing or None) if diffusion else None,
        isolation=document.isolation,
        same=training.same and not diffusion,
    )


def _trained_family(family: Family) -> Family:
    """The family without settings that its kind does not use, so that they never keep a run from being resumed."""
    if family.kind == "custom":
        return replace(family, count=len(family.custom), axis=None, span=(0.0, 1.0))
    return replace(family, axis=family.axis if family.kind == "parallel" else None, custom=())


@dataclass
class Job:
    """One run of the trainer, started by this session or an earlier one."""

    document: Document
    """What is trained: the scene, isolation, up axis, families and training settings. It has no cuts."""
    pid: int
    started: float
    """When the process started, seconds since 1970: a pid may be reused, but a pid with a start time is unique."""
    stopped: bool = False
    """Whether the user has stopped it."""
    progress: Progress = field(default_factory=Progress)
    child: subprocess.Popen[bytes] | None = None
    """The process, if this session started it."""
    ended: bool = False
    """Whether the process has ended."""
    offset: int = 0
    """Number of bytes of the events file that have been read."""
    suspended: float | None = None
    """When this session suspended the process, by the clock that never goes back; None while it runs."""

    @staticmethod
    def start(document: Document, up: Vec3, out: Path, resume: bool = False, program: Sequence[str] = ()) -> Job:
        """Starts the trainer, with `out` as the result folder. `program`: a command to run in its place, for tests.

        Raises InputError if something is missing, the folder cannot be written, or a job is already running in it.
        """
        out = out.absolute()
        other = Job.find(out)
        if other is not None and not other.ended:
            raise InputError(f"{out}: a job already works here; stop it first, or choose another folder")
        request, path = request_for(document, up), request_path(out)
        with atomic(path) as temporary:
            temporary.write_text(request.to_json(), encoding="utf-8")
        arguments = ["--request", str(path), "-o", str(out), "--events", str(out / "events.jsonl")]
        arguments += ["--resume"] if resume else []
        training = replace(document.training, out=out)
        trained = Document(
            scene=document.scene,
            up=up,
            isolation=document.isolation,
            families=document.families,
            training=training,
            number=document.number,
            name=document.name,
        )
        save_project(note_path(out).with_suffix(SUFFIX), Project((trained,), Viewing()))
        try:
            out.mkdir(parents=True, exist_ok=True)
            # The files are created anew: a link of the same name might lead anywhere.
            if not resume:
                (out / "events.jsonl").unlink(missing_ok=True)
                (out / "events.jsonl").touch(exist_ok=False)
            (out / "job.log").unlink(missing_ok=True)
            with (out / "job.log").open("xb") as log:
                child = _spawn(arguments, program, log)
        except (OSError, ValueError) as error:  # a ValueError for a path with a null character
            raise InputError(f"{out}: training cannot start here ({reason(error)})") from error
        try:
            started = psutil.Process(child.pid).create_time()
        except psutil.Error:  # it has ended already; its log says why
            started = 0.0
        job = Job(trained, child.pid, started, progress=Progress(out), child=child)
        try:
            job._write_note()
        except InputError:
            child.kill()  # no later session could find it
            raise
        return job

    @staticmethod
    def find(out: Path) -> Job | None:
        """The job that this app started in a folder, running or not; None if there was none."""
        path = note_path(out)
        try:
            note = json.loads(read_file(path, NOTE_LIMIT))
            document = load_project(path.with_suffix(SUFFIX), outside=True).documents[0]  # the app wrote it itself
            out = document.training.out or out
            job = Job(document, int(note["pid"]), float(note["started"]), bool(note["stopped"]), Progress(out))
        except (InputError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            return None
        if document.scene is None or document.training.out is None:
            return None
        job.ended = not job._is_trainer()
        return job

    @property
    def phase(self) -> str:
        """'running', 'paused', 'stopping', 'done', 'stopped' or 'failed'."""
        if not self.ended and self.stopped:
            return "stopping"
        if not self.ended:
            return "paused" if self._is_paused() else "running"
        if self.progress.result is not None:
            return "done"
        return "stopped" if self.stopped else "failed"

    @property
    def scene(self) -> Path:
        """The capture that is trained."""
        assert self.document.scene is not None
        return self.document.scene

    @property
    def out(self) -> Path:
        """The result folder."""
        assert self.document.training.out is not None
        return self.document.training.out

    def poll(self) -> bool:
        """Reads new events and checks whether the process has ended; True if anything has changed."""
        was = self.ended
        if not self.ended:
            self.ended = (self.child.poll() is not None) if self.child else self._process() is None
        return self._read() or self.ended != was

    def pause(self) -> None:
        """Suspends the process. It stays in memory, so a pause does not survive a restart of the computer."""
        self._signal(lambda process: process.suspend())
        self.suspended = time.monotonic()

    def unpause(self) -> None:
        """Lets a suspended process run again."""
        if self.suspended is not None:
            self.progress.paused += time.monotonic() - self.suspended
            self.suspended = None
        self._signal(lambda process: process.resume())

    def stop(self) -> None:
        """Asks the trainer to write a checkpoint and end; a suspended process is woken up for that."""
        self.stopped = True
        self._write_note()
        self._signal(lambda process: process.resume())
        self._signal(lambda process: process.terminate())

    def resume(self, program: Sequence[str] = ()) -> Job:
        """Starts the same job again from its last checkpoint. Raises InputError if it cannot start."""
        job = Job.start(self.document, self.document.up or (0.0, 0.0, 1.0), self.out, resume=True, program=program)
        job.progress = self.progress.resumed()
        job.offset = self.offset
        return job

    def log_tail(self) -> list[str]:
        """The last lines that the process has printed."""
        try:
            with open_file(self.out / "job.log") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - LOG_TAIL_BYTES))
                text = file.read(LOG_TAIL_BYTES).decode("utf-8", "replace")
        except (OSError, InputError):
            return []
        return [one_line(line.rstrip()) for line in text.splitlines() if line.strip()][-LOG_TAIL:]

    def _read(self) -> bool:
        """Reads the complete lines that were written since the last call; True if there were any."""
        try:
            with open_file(self.out / "events.jsonl") as file:
                if file.seek(0, os.SEEK_END) < self.offset:  # a new file
                    self.offset, self.progress = 0, Progress(self.out)
                file.seek(self.offset)
                block = file.read(READ_AT_ONCE)
        except (OSError, InputError):
            return False
        end = block.rfind(b"\n") + 1
        if not end and len(block) == READ_AT_ONCE:  # the trainer never writes such a long line
            end = len(block)
        for line in block[:end].splitlines():
            read_line(self.progress, line)
        self.offset += end
        return end > 0

    def _process(self) -> psutil.Process | None:
        """The running process; None if it has ended, or if its pid now belongs to another process."""
        try:
            process = psutil.Process(self.pid)
            same = abs(process.create_time() - self.started) < 1.0
            return process if same and process.status() != psutil.STATUS_ZOMBIE else None
        except (psutil.Error, ValueError, OverflowError):  # the last two for an impossible pid
            return None

    def _is_trainer(self) -> bool:
        """Whether the process runs and was started to write this job's events; the note alone is not trusted."""
        process = self._process()
        try:
            return process is not None and str(self.out / "events.jsonl") in process.cmdline()
        except psutil.Error:
            return False

    def _is_paused(self) -> bool:
        process = self._process()
        try:
            return process is not None and process.status() == psutil.STATUS_STOPPED
        except psutil.Error:
            return False

    def _signal(self, act: Callable[[psutil.Process], object]) -> None:
        """Calls `act` with each child of the process, then with the process itself."""
        process = self._process()
        if process is None:
            return
        with contextlib.suppress(psutil.Error):
            for one in [*process.children(recursive=True), process]:
                act(one)

    def _write_note(self) -> None:
        """Records which process runs the job."""
        write_json(note_path(self.out), {"pid": self.pid, "started": self.started, "stopped": self.stopped})


def note_path(out: Path) -> Path:
    """The app's note on the process that trains into a result folder; the document and request are beside it."""
    name = hashlib.sha256(os.fsencode(out.resolve())).hexdigest()[:32]
    return state_folder() / "jobs" / f"{name}.json"


def request_path(out: Path) -> Path:
    """The trainer's request file for a result folder, beside the note."""
    return note_path(out).with_suffix(".request.json")


def _spawn(arguments: Sequence[str], program: Sequence[str], log: Any) -> subprocess.Popen[bytes]:
    """Starts a process that does not end when the window or its terminal is closed."""
    options: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": subprocess.STDOUT}
    if sys.platform == "win32":
        options["creationflags"] = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    else:
        options["start_new_session"] = True
    if program:
        return subprocess.Popen([*program, *arguments], **options)
    return start_python("training.cli", arguments, **options)
