"""All readers, each given any file: `benchmarks.readers.corpus` runs them in child processes.

A process reads requests, one JSON line each, from standard input and answers on standard output. What readers print
goes to standard error, which the parent keeps. A request names a reader and a file; the answer is a `Verdict`.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from app.jobs.job_events import Progress
from app.jobs.live_colours import LiveColours
from app.jobs.training_job import Job
from app.model.autosave import find_unsaved_work
from app.model.document import Document, Training
from app.model.project import load_project
from app.model.settings import load_settings
from benchmarks.readers.guard import guarded
from benchmarks.readers.rules import words_wrong
from engine.errors import InputError
from engine.io.load import load
from engine.io.meshes.mesh import read_mesh
from engine.io.splats.gltf import read_gltf
from engine.io.splats.ply import read_ply
from engine.io.splats.splat import read_splat
from engine.io.splats.spz import read_spz
from engine.io.trained import load_trained, sidecar_path
from engine.scene.gaussians import Gaussians
from training.batch.manifest import ManifestErrors, read_manifest
from training.batch.task import Task
from training.checkpoint import Checkpoint
from training.families import COUNTS
from training.priors.exemplar.pictures import read_picture

__all__ = ["PICTURE", "READERS", "SOLID", "Verdict", "read_one"]

SOLID = "solid.ply"
"""A sound trained object, for readers that need one beside the file."""
PICTURE = "face.png"
"""A sound picture of a cut, beside that object."""
SOLID_FILES = (".ply", ".fruitninja.json")

MEMORY = 4 << 30
"""Bytes that readers may allocate beyond what the imports took."""

Verdict = dict[str, Any]
"""`what`: loaded, refused or failed; `words`: the text of the refusal or the failure; `seconds`."""


@dataclass(frozen=True)
class Reader:
    """A way for a file into the program."""

    read: Callable[[Path, Path], Any]
    """Takes the file and a working folder; raises what the product's reader raises."""
    links: tuple[str, ...] = ()
    """Names under which the folder links to the file, for readers that look for a name; `SOLID` then lies there too."""


def read_scene(path: Path, work: Path) -> None:
    loaded = load(path)
    check_gaussians(loaded.gaussians)
    for line in loaded.warnings:
        wrong = refusal_wrong(line, path)
        assert not wrong, f"a warning that is {wrong}: {line}"


def check_gaussians(gaussians: Gaussians) -> None:
    """Asserts what renderers need: finite values, positive scales, opacities in [0, 1] and unit quats."""
    assert len(gaussians), "loaded, with nothing in it"
    for name, values in vars(gaussians).items():
        assert np.isfinite(values).all(), f"loaded, with NaN or Inf in {name}"
    assert (gaussians.scales > 0).all(), "loaded, with scales that are not above 0"
    assert ((gaussians.opacities >= 0) & (gaussians.opacities <= 1)).all(), "loaded, with opacities outside [0, 1]"
    assert np.allclose(np.linalg.norm(gaussians.quats, axis=1), 1, atol=1e-4), "loaded, with rotations of no length 1"


def read_object(path: Path, work: Path) -> None:
    atoms, _ = load_trained(path)
    for part in (atoms.surface, atoms.interior):
        for name, values in vars(part).items():
            assert np.isfinite(values).all(), f"loaded, with NaN or Inf in {name}"


def read_exemplar(path: Path, work: Path) -> None:
    for kind in COUNTS:
        picture = read_picture(path, kind)
        rgb = picture.rgb
        assert np.isfinite(rgb).all() and rgb.min() >= 0 and rgb.max() <= 1, f"{kind}: colours outside [0, 1]"
        assert picture.mask.any() and picture.rgb.shape[:2] == picture.mask.shape, f"{kind}: no cut face"


def read_project(path: Path, work: Path) -> None:
    """Opens a project as the app does at first, and again as after the user has allowed files outside its folder."""
    with suppress(InputError):
        load_project(path)
    load_project(path, outside=True)


def read_checkpoint(path: Path, work: Path) -> None:
    """Loads the colours as the window does while training goes on, and the checkpoint as the trainer does."""
    atoms, _ = load_trained(work / SOLID)
    watch = LiveColours(work)
    watch.folder = work
    watch.newer(atoms)
    Checkpoint(work, "run").load("training")


def read_job(path: Path, work: Path) -> None:
    """A result folder in which every file of a job is this one. What makes no sense counts as missing."""
    asked = Document(scene=path, training=Training(out=work))
    job = Job(asked, 0, 0.0, progress=Progress(work), ended=True)
    for _ in range(1000):
        if not job.poll():
            break
    job.log_tail()
    assert 0 <= job.progress.fraction <= 1, "progress outside [0, 1]"


READERS = {
    "scene": Reader(read_scene),
    "mesh": Reader(lambda path, work: check_gaussians(read_mesh(path, count=2000))),
    "ply": Reader(lambda path, work: check_gaussians(read_ply(path)[0])),
    "splat": Reader(lambda path, work: check_gaussians(read_splat(path)[0])),
    "spz": Reader(lambda path, work: check_gaussians(read_spz(path)[0])),
    "gltf": Reader(lambda path, work: check_gaussians(read_gltf(path)[0])),
    "trained object": Reader(read_object),
    "sidecar": Reader(lambda path, work: load_trained(work / SOLID), (sidecar_path(SOLID).name,)),
    "picture": Reader(read_exemplar),
    "project": Reader(read_project),
    "manifest": Reader(lambda path, work: read_manifest(path)),
    "checkpoint": Reader(read_checkpoint, ("training.safetensors",)),
    "settings": Reader(lambda path, work: load_settings(path)),
    "job": Reader(read_job, ("job.json", "events.jsonl", "job.log")),
    "autosave": Reader(lambda path, work: find_unsaved_work(work), ("a.fruitninja", "a.json")),
    "batch result": Reader(lambda path, work: Task("t", dict, {}, path, "f").load_facts()),
}
"""The last four refuse nothing: what they cannot read counts as missing."""


def refusal_wrong(line: str, *paths: Path) -> str:
    """What is wrong with a message that should begin with one of these paths; empty if nothing is."""
    begins = line.startswith(tuple(map(str, paths)))
    return words_wrong(line, *map(str, paths)) or ("" if begins else "silent about the file")


def read_one(name: str, path: Path, work: Path, solid: Path) -> Verdict:
    """Gives the file to a reader. `work`: an empty folder, which is emptied again; `solid`: a trained object.

    Catches everything but the end of the process.
    """
    reader = READERS[name]
    links = [(work / link, path) for link in reader.links]
    links += [(work / Path(SOLID).with_suffix(end), solid.with_suffix(end)) for end in SOLID_FILES if reader.links]
    for link, target in links:
        if not link.is_symlink():
            link.symlink_to(target)
    begun = time.perf_counter()
    what, words = "loaded", ""
    with guarded(path.parent, work, solid.parent) as tried:
        try:
            reader.read(path, work)
        except InputError as error:
            what, words = "refused", str(error)
            for line in words.split("\n") if isinstance(error, ManifestErrors) else [words]:
                if wrong := refusal_wrong(line, path, path.parent, work):
                    what, words = "failed", f"a refusal that is {wrong}: {line[:300]}"
        except MemoryError:
            what, words = "failed", f"out of memory: over {MEMORY >> 30} GB"
        except AssertionError as error:
            what, words = "failed", f"{error or 'an assertion'} ({place(error)})"
        except BaseException as error:  # of any kind: this is what the corpus looks for
            what, words = "failed", f"{type(error).__name__}: {str(error)[:300]} ({place(error)})"
    seconds = time.perf_counter() - begun
    left = sorted(set(os.listdir(work)) - {link.name for link, _ in links})
    for name in os.listdir(work):
        (work / name).unlink()
    deeds = [*tried, *(f"left {name} behind" for name in left), *(f"left {p} running" for p in children())]
    if said := printed():
        deeds.append(f"printed {said!r}")
    if deeds:
        what, words = "failed", "; ".join(deeds[:3])
    return {"what": what, "words": words, "seconds": round(seconds, 3)}


def place(error: BaseException) -> str:
    """File and line that raised the error."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(frame.filename).name}:{frame.lineno}"


def children() -> list[str]:
    """Processes started by native code, which no audit hook sees."""
    return [f"process {child.pid}" for child in psutil.Process().children()]


def printed() -> str:
    """First line of standard error since the last call; empties the file."""
    sys.stdout.flush()
    sys.stderr.flush()
    said = os.pread(2, 300, 0).decode("utf-8", "replace")
    os.ftruncate(2, 0)
    os.lseek(2, 0, os.SEEK_SET)  # or the next writer would leave zeros before its text
    return "\n".join(said.splitlines()[:1]).replace(sys.prefix, "...")  # tables show no path of this machine


def main() -> None:
    """Answers requests until there are no more. Arguments: the working folder, and a trained object."""
    work, solid = (Path(argument) for argument in sys.argv[1:3])
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # catches what native code prints, too
    warnings.simplefilter("always")  # each time, not only once per line of code
    for name in READERS:  # warm-up: late compiles and imports are not held against files
        for sample in (solid, solid.with_name(PICTURE)):
            read_one(name, sample, work, solid)
    used = psutil.Process().memory_info().vms
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        print(json.dumps(read_one(request["reader"], Path(request["file"]), work, solid)), file=answers, flush=True)


if __name__ == "__main__":
    main()
