"""A training job: `fruitninja-train` in a process of its own, followed through the events it writes to a file.

The job outlives the window, and the next one finds it and follows on. What it tells and prints stands in its folder
(`events.jsonl`, `job.log`). Which process it is and what it was asked for stands where the app keeps its own state, not
there: a folder may come from a stranger, and nothing that is read from it may start, hold or end a process.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import psutil

from app.jobs.job_events import Progress, read_line
from app.model.document import Document
from app.model.project import SUFFIX, Project, Viewing, load_project, save_project
from app.model.rigid_transform import Vec3
from app.model.settings import state_folder
from engine.errors import InputError, one_line
from engine.io.files import atomic, open_file, read_file, reason
from engine.processes import start_python
from training.families import Family

__all__ = ["Job", "command_for", "default_out", "missing_for_training", "note_path"]

LOG_TAIL = 6
"""Last lines of what a job printed that are shown when it died."""

READ_AT_ONCE = 1 << 20
"""Bytes of events taken in one poll, so that finding a long job again does not hold up a frame; the trainer's lines
have a few hundred."""

NOTE_LIMIT = 1 << 16
"""Bytes of the largest note that is read; a real one has a hundred."""


def missing_for_training(document: Document) -> str:
    """What the user still has to give before training can start; empty: nothing."""
    if document.scene is None:
        return "Open an object first."
    if document.training.prior == "stable-diffusion":
        if document.training.model is None:
            return "Choose the folder of a Stable Diffusion depth model, under More."
        if not document.families:
            return "Add a family of cuts first."
    elif not any(family.exemplars for family in document.families):
        return "Add a picture of a cut face first: drop one on a family, or choose one."
    gone = [path for family in document.families for path in family.exemplars if not path.is_file()]
    return f"The picture {gone[0].name} is no longer there. Remove it or put it back." if gone else ""


def default_out(scene: Path) -> Path:
    """Beside the scene, or where the app keeps its own files if nothing can be written there."""
    folder = scene.parent
    if not os.access(folder, os.W_OK):
        folder = state_folder() / "results"
    return folder / f"{scene.stem}-inside"


def command_for(document: Document, up: Vec3, out: Path) -> list[str]:
    """The trainer's arguments for a document. Raises InputError where something is missing."""
    if missing := missing_for_training(document):
        raise InputError(missing)
    training = document.training
    arguments = [str(document.scene), "-o", str(out), "--events", str(out / "events.jsonl")]
    arguments += ["--up", ",".join(repr(v) for v in up)]
    arguments += ["--detail", training.detail, "--prior", training.prior, "--seed", str(training.seed)]
    if training.prior == "stable-diffusion":
        arguments += ["--model", str(training.model), *(["--object", training.thing] if training.thing else [])]
    if training.iterations is not None:
        arguments += ["--iterations", str(training.iterations)]
    for family in document.families:
        arguments += _family(family)
    return arguments


def _family(family: Family) -> list[str]:
    """A family's arguments."""
    result: list[str] = []
    if family.kind == "custom":
        for plane in family.custom:
            result += ["--family", "custom:" + ",".join(repr(v) for v in (*plane.normal, plane.offset))]
    else:
        axis = "" if family.axis is None else ":" + ",".join(repr(v) for v in family.axis)
        span = "" if family.span == (0.0, 1.0) else f":{family.span[0]!r}..{family.span[1]!r}"
        result += ["--family", f"{family.kind}:{family.count}{axis}{span}"]
    for exemplar in family.exemplars:
        result += ["--exemplar", f"{family.kind}={exemplar}"]
    if family.prompt:
        result += ["--prompt", f"{family.kind}={family.prompt}"]
    return result


@dataclass
class Job:
    """One run of the trainer, this session's or an earlier one's."""

    document: Document
    """What it was asked for: the scene, its up axis, the families and how to train them. No cuts."""
    pid: int
    started: float
    """When the process began, as the system says; a number is used again, a number and a start are not."""
    stopped: bool = False
    """The user stopped it."""
    progress: Progress = field(default_factory=Progress)
    child: subprocess.Popen[bytes] | None = None
    """The process, if this session started it."""
    ended: bool = False
    """The process is gone."""
    offset: int = 0
    """Bytes of the events already read."""

    @staticmethod
    def start(document: Document, up: Vec3, out: Path, resume: bool = False, program: Sequence[str] = ()) -> Job:
        """Starts the trainer with a folder for its result. `program`: something else that speaks the same events.

        Raises InputError where something is missing, the folder cannot be written, or a job already works in it.
        """
        out = out.absolute()
        other = Job.find(out)
        if other is not None and not other.ended:
            raise InputError(f"{out}: a job already works here; stop it first, or choose another folder")
        arguments = [*command_for(document, up, out), *(["--resume"] if resume else [])]
        training = replace(document.training, out=out)
        asked = Document(scene=document.scene, up=up, families=document.families, training=training)
        save_project(note_path(out).with_suffix(SUFFIX), Project(asked, Viewing()))
        try:
            out.mkdir(parents=True, exist_ok=True)
            # New files, never what a link of that name leads to.
            if not resume:
                (out / "events.jsonl").unlink(missing_ok=True)
                (out / "events.jsonl").touch(exist_ok=False)
            (out / "job.log").unlink(missing_ok=True)
            with (out / "job.log").open("xb") as log:
                child = _spawn(arguments, program, log)
        except (OSError, ValueError) as error:  # a ValueError for words that no command line holds
            raise InputError(f"{out}: training cannot start here ({reason(error)})") from error
        try:
            started = psutil.Process(child.pid).create_time()
        except psutil.Error:  # it has died already; its log says why
            started = 0.0
        job = Job(asked, child.pid, started, progress=Progress(out), child=child)
        try:
            job._note()
        except InputError:
            child.kill()  # nobody would find it again
            raise
        return job

    @staticmethod
    def find(out: Path) -> Job | None:
        """The job that this app started in a folder, running or not; None where there was none."""
        path = note_path(out)
        try:
            note = json.loads(read_file(path, NOTE_LIMIT))
            asked = load_project(path.with_suffix(SUFFIX), outside=True).document  # the app wrote it itself
            out = asked.training.out or out
            job = Job(asked, int(note["pid"]), float(note["started"]), bool(note["stopped"]), Progress(out))
        except (InputError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            return None
        if asked.scene is None or asked.training.out is None:
            return None
        job.ended = not job._is_trainer()
        return job

    @property
    def phase(self) -> str:
        """'running', 'paused', 'done', 'stopped' or 'failed'."""
        if not self.ended:
            return "paused" if self._is_paused() else "running"
        if self.progress.result is not None:
            return "done"
        return "stopped" if self.stopped else "failed"

    @property
    def scene(self) -> Path:
        """The capture it works on."""
        assert self.document.scene is not None
        return self.document.scene

    @property
    def out(self) -> Path:
        """The folder of its result."""
        assert self.document.training.out is not None
        return self.document.training.out

    def poll(self) -> bool:
        """Reads what is new; True where something is."""
        was = self.ended
        if not self.ended:
            self.ended = (self.child.poll() is not None) if self.child else self._process() is None
        return self._read() or self.ended != was

    def pause(self) -> None:
        """Holds the process where it is, for as long as the computer runs. It keeps its memory."""
        self._signal(lambda process: process.suspend())

    def go_on(self) -> None:
        """Lets a paused process run again."""
        self._signal(lambda process: process.resume())

    def stop(self) -> None:
        """Asks the trainer to keep what it has and end. A paused one is woken for that."""
        self.stopped = True
        self._note()
        self._signal(lambda process: process.resume())
        self._signal(lambda process: process.terminate())

    def kill(self) -> None:
        """Ends it at once; what came after the last checkpoint is lost."""
        self.stopped = True
        self._note()
        self._signal(lambda process: process.kill())

    def resume(self, program: Sequence[str] = ()) -> Job:
        """The same job once more, from its last checkpoint. Raises InputError where it cannot start."""
        job = Job.start(self.document, self.document.up or (0.0, 0.0, 1.0), self.out, resume=True, program=program)
        job.progress = self.progress.again()
        job.offset = self.offset
        return job

    def last_words(self) -> list[str]:
        """The last lines that the process printed."""
        try:
            with open_file(self.out / "job.log") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - 8192))
                text = file.read(8192).decode("utf-8", "replace")
        except (OSError, InputError):
            return []
        return [one_line(line.rstrip()) for line in text.splitlines() if line.strip()][-LOG_TAIL:]

    def _read(self) -> bool:
        """Takes the complete lines that were written since the last time."""
        try:
            with open_file(self.out / "events.jsonl") as file:
                if file.seek(0, os.SEEK_END) < self.offset:  # begun anew
                    self.offset, self.progress = 0, Progress(self.out)
                file.seek(self.offset)
                block = file.read(READ_AT_ONCE)
        except (OSError, InputError):
            return False
        end = block.rfind(b"\n") + 1
        if not end and len(block) == READ_AT_ONCE:  # no line of the trainer's
            end = len(block)
        for line in block[:end].splitlines():
            read_line(self.progress, line)
        self.offset += end
        return end > 0

    def _process(self) -> psutil.Process | None:
        """The living process, None where it has gone or its number belongs to another one now."""
        try:
            process = psutil.Process(self.pid)
            same = abs(process.create_time() - self.started) < 1.0
            return process if same and process.status() != psutil.STATUS_ZOMBIE else None
        except (psutil.Error, ValueError, OverflowError):  # the last two for what is no process's number
            return None

    def _is_trainer(self) -> bool:
        """Whether the process lives and was started to write this job's events: a note may have been tampered with."""
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
        """Does something to the process, its children first."""
        process = self._process()
        if process is None:
            return
        with contextlib.suppress(psutil.Error):
            for one in [*process.children(recursive=True), process]:
                act(one)

    def _note(self) -> None:
        """Writes who works here."""
        note = {"pid": self.pid, "started": self.started, "stopped": self.stopped}
        with atomic(note_path(self.out)) as temporary:
            temporary.write_text(json.dumps(note) + "\n", encoding="utf-8")


def note_path(out: Path) -> Path:
    """Where the app keeps who works in a result folder; what was asked for stands beside it, as a project."""
    name = hashlib.sha256(os.fsencode(out.resolve())).hexdigest()[:32]
    return state_folder() / "jobs" / f"{name}.json"


def _spawn(arguments: Sequence[str], program: Sequence[str], log: Any) -> subprocess.Popen[bytes]:
    """A process apart from this one, so that closing the window or its terminal does not end it."""
    options: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": subprocess.STDOUT}
    if sys.platform == "win32":
        options["creationflags"] = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    else:
        options["start_new_session"] = True
    if program:
        return subprocess.Popen([*program, *arguments], **options)
    return start_python("training.cli", arguments, **options)
