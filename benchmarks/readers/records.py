"""Records that are valid JSON but wrong in meaning: swapped values, names of things that do not exist.

`inputs` breaks values and bytes; here every value has a type that belongs there, or nearly.
"""

from __future__ import annotations

import copy
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from hypothesis import strategies as st
from safetensors.numpy import save as safetensors_bytes

from app.jobs.live_colours import LiveColours
from app.jobs.training_job import Job, note_path
from app.model.document import Document, Part, Training
from app.model.pieces import PointSample, pieces
from app.model.project import SUFFIX, Outside, Project, Viewing, load_project, save_project
from app.model.settings import load_settings
from benchmarks.readers.inputs import CHANGES, documents, places, poisoned
from benchmarks.readers.rules import result_or_refusal
from engine.scene.plane import Plane
from tests.helpers.solids import scatter
from training.families import Family
from training.request import Request, read_request

__all__ = ["COLOURS", "JOBS", "MOVES", "REQUESTS", "SETTINGS", "check_colours", "check_job", "check_meant_project",
           "check_request", "check_settings", "misplaced"]  # fmt: skip

NUMBERS: tuple[Any, ...] = (0, -1, 1, 2, 3, 7, 255, 2**31, 2**53, 2**53 + 1, 2**63, 10**18, 1e-9, 0.5, 1e9, 1e12, -1e12)
TEXTS = ("", " ", "horizontal", "Knife 9", "Knife ²", "Knife " + "9" * 5000, "Piece 1", "../../a.ply", "..", ".", "~",
         "/etc/hostname", "C:\\a.ply", "\\\\host\\a.ply", "a.ply/../../b.ply", "link/a.ply", "con", "a" * 300, "-o",
         "--help", "\u202e", "$(id)", "`id`", "%n%s", "file:///etc/hostname", "http://127.0.0.1/a.ply")  # fmt: skip
"""Names that are taken, lead out of the folder, or mean something else to a shell, a printer or another system."""

MOVES = st.lists(
    st.tuples(st.floats(0, 1), st.floats(0, 1), st.integers(0, 11), st.integers(0, 255)), min_size=1, max_size=4
)


def misplaced(record: Any, moves: list[tuple[float, float, int, int]]) -> Any:
    """The record with values swapped, copied, repeated, left out of lists, or taken from `NUMBERS` and `TEXTS`."""
    record = copy.deepcopy(record)
    for where, other, how, which in moves:
        found = places(record)
        if not found:
            break
        way = found[int(where * (len(found) - 1))]
        value = at(record, way)
        alike = [p for p in found if type(at(record, p)) is type(value)]
        other_way = alike[int(other * (len(alike) - 1))]
        holder, key = at(record, way[:-1]), way[-1]
        if how < 3:
            holder[key] = copy.deepcopy(at(record, other_way))
        elif how < 5 and way[: len(other_way)] != other_way and other_way[: len(way)] != way:
            theirs = copy.deepcopy(at(record, other_way))
            at(record, other_way[:-1])[other_way[-1]] = value
            holder[key] = theirs
        elif how < 7 and isinstance(holder, list):
            holder[key:key] = [copy.deepcopy(value)] * (1 if which < 250 else 500)
        elif how == 7 and isinstance(holder, list):
            del holder[key]
        elif how == 8 and isinstance(value, list):
            holder[key] = []
        elif how == 9 and isinstance(value, list | dict):
            holder[key] = nested(value, which)
        elif isinstance(value, str):
            holder[key] = TEXTS[which % len(TEXTS)]
        elif isinstance(value, int | float) and not isinstance(value, bool):
            number = NUMBERS[which % len(NUMBERS)]
            holder[key] = type(value)(number) if how == 10 else number
    return record


def at(record: Any, way: tuple[Any, ...]) -> Any:
    """The value at the end of a path."""
    for key in way:
        record = record[key]
    return record


def nested(value: Any, depth: int) -> Any:
    """The value inside `depth` lists."""
    for _ in range(depth):
        value = [value]
    return value


# projects: a loaded project can be worked with, saved and loaded again

BOX = PointSample.of(np.stack(np.meshgrid(*[np.linspace(-1, 1, 6)] * 3), -1).reshape(-1, 3))


def check_meant_project(record: Any, folder: Path) -> bool:
    path = folder / "a.fruitninja"
    path.write_bytes(json.dumps(record).encode("utf-8", "surrogatepass"))
    try:
        inside = result_or_refusal(lambda: load_project(path), folder)
    except Outside:
        inside = None
    if inside is not None:
        for name in (path for document in inside.documents for path in named(document)):
            assert os.path.realpath(name).startswith(os.path.realpath(folder)), f"it leads out: {name}"
    project = result_or_refusal(lambda: load_project(path, outside=True), folder)
    if project is None:
        return False
    document = project.documents[0]
    shown = pieces(document, BOX)
    assert all(np.isfinite(piece.motion.matrix).all() for piece in shown), "a piece lies nowhere"
    more = document.with_cut((Part(Plane.of((0, 0, 1), 0.1)),))
    fewer = more.without_cut(more.cuts[0].id)
    for changed in (more, fewer, document.reassembled()):
        pieces(changed, BOX)
        again = replace(project, documents=(changed,))
        save_project(folder / "b.fruitninja", again)
        kept = load_project(folder / "b.fruitninja", outside=True)
        assert kept == again, "saved and loaded it is another project"
    return True


def named(document: Any) -> list[Path]:
    """All files named in a document."""
    training = document.training
    found = [document.scene, training.out, training.model, *(p for f in document.families for p in f.exemplars)]
    return [path for path in found if path is not None]


# requests: a request that was read is written and read back the same

PLANES = (Plane.of((1, 2, 3), 0.1), Plane.of((0, 0, 1), -0.5))
REQUEST = Request(
    Path("/a.ply"),
    (Family("horizontal", 4, (Path("/a.png"), Path("/b.png")), "red", span=(0.1, 0.9)),
     Family("parallel", 3, (Path("/c.png"),), axis=(0.0, 1.0, 0.0)), Family("custom", 2, custom=PLANES)),
    "draft", (0.0, 0.0, 1.0), 7, 50, "stable-diffusion", Path("/model"), Path("/midas"), "bread",
)  # fmt: skip
REQUESTS: st.SearchStrategy[bytes] = documents(json.loads(REQUEST.to_json())) | st.builds(
    lambda moves: json.dumps(misplaced(json.loads(REQUEST.to_json()), moves)).encode("utf-8", "surrogatepass"), MOVES
)


def check_request(data: bytes, folder: Path) -> bool:
    path = folder / "request.json"
    path.write_bytes(data)
    request = result_or_refusal(lambda: read_request(path), folder)
    if request is None:
        return False
    assert all(file.is_absolute() for file in request.files), "a relative path"
    again = folder / "again.json"
    again.write_text(request.to_json(), encoding="utf-8")
    assert read_request(again) == request, "written and read it is another request"
    return True


# a result folder: its files may be anything, and the window looks at it all the same

NOTE = {"pid": 1, "started": 1.5, "stopped": False}
EVENTS = [
    {"event": "started", "seconds": 0.1, "host": "h", "pid": 1},
    {"event": "stage", "seconds": 0.2, "stage": "train", "title": "Training"},
    {"event": "progress", "seconds": 1.5, "stage": "train", "part": 0.5, "iteration": 4, "iterations": 9,
     "losses": {"section": 0.1, "surface": 0.2}},
    {"event": "previews", "seconds": 2.0, "paths": ["a.png", "b.png"]},
    {"event": "warning", "seconds": 2.5, "message": "m"},
    {"event": "done", "seconds": 3.0, "scene": "s.ply", "report": "r.json"},
]  # fmt: skip


def lines(record: Any) -> bytes:
    """The items of a list as JSON lines; anything else as one line."""
    rows = record if isinstance(record, list) else [record]
    return b"".join(json.dumps(row).encode("utf-8", "surrogatepass") + b"\n" for row in rows)


JOBS: st.SearchStrategy[tuple[bytes, bytes]] = st.tuples(
    documents(NOTE)
    | st.builds(lambda moves: json.dumps(misplaced(NOTE, moves)).encode("utf-8", "surrogatepass"), MOVES),
    st.builds(lambda moves, changes: lines(poisoned(misplaced(EVENTS, moves), changes)), MOVES, st.just([]) | CHANGES),
)


def check_job(value: tuple[bytes, bytes], folder: Path) -> bool:
    out, home = folder / "result", folder / "home"
    out.mkdir(exist_ok=True)
    (out / "events.jsonl").write_bytes(value[1])
    (out / "job.log").write_bytes(value[1])
    asked = Document(scene=folder / "a.ply", training=Training(out=out))
    with mock.patch.dict(os.environ, FRUITNINJA_HOME=str(home)):
        note = note_path(out)
        save_project(note.with_suffix(SUFFIX), Project((asked,), Viewing()))
        note.write_bytes(value[0])
        found = result_or_refusal(lambda: Job.find(out), out, home)
    job = found or Job(asked, 0, 0.0, ended=True)
    job.ended = True  # whatever process it names, it is none of ours
    result_or_refusal(job.poll, out)
    assert job.phase in ("done", "stopped", "failed")
    job.log_tail()
    assert 0 <= job.progress.stage_fraction <= 1 and 0 <= job.progress.fraction <= 1, "progress outside [0, 1]"
    return found is not None


# colours written by a training


ATOMS = scatter(4, 4, degree=0)
SHAPES = st.sampled_from(((4, 3), (4,), (4, 1, 3), (4, 4, 3), (5, 3), (0, 3), (0,), (), (4, 2), (4, 3, 1)))
TYPES = st.sampled_from((np.float32, np.float32, np.float64, np.int32, np.bool_, np.float16))
VALUES = st.sampled_from((0.5, 0.5, 0.0, -1.0, 3.0, np.nan, np.inf, 1e38))


@st.composite
def colours(draw: st.DrawFn) -> bytes:
    """A stage's file whose arrays may differ from the object's in shape, type and values."""
    right = {"means": (4, 3), "sigmas": (4,), "rgb": (4, 3), "sh": (4, 1, 3)}
    arrays: dict[str, np.ndarray] = {}
    for name, shape in right.items():
        if draw(st.integers(0, 3)):
            chosen = draw(SHAPES) if draw(st.integers(0, 3)) == 0 else shape
            with np.errstate(all="ignore"):
                arrays[name] = np.full(chosen, draw(VALUES)).astype(draw(TYPES))
    return safetensors_bytes(arrays, {"facts": "{}", "run": "run"})


COLOURS = colours()


def check_colours(data: bytes, folder: Path) -> bool:
    checkpoint = folder / "out/checkpoint"
    checkpoint.mkdir(parents=True, exist_ok=True)
    (checkpoint / "training.safetensors").write_bytes(data)
    found = result_or_refusal(lambda: LiveColours(folder / "out").newer(ATOMS), checkpoint)
    if found is None:
        return False
    for part in (found.surface, found.interior):
        for name, values in vars(part).items():
            if isinstance(values, np.ndarray):
                assert values.dtype == np.float32 and np.isfinite(values).all(), name
    assert (found.interior.sigmas > 0).all(), "atoms of no size"
    return True


# settings: whatever they contain, the window starts

SETTINGS: st.SearchStrategy[bytes] = documents(
    {
        "theme": "light",
        "recent": ["a.ply"],
        "jobs": ["out"],
        "trusted": ["p"],
        "face_light": False,
        "window": [900, 700],
        "seen_hint": True,
    }
)


def check_settings(data: bytes, folder: Path) -> bool:
    path = folder / "settings.json"
    path.write_bytes(data)
    found = result_or_refusal(lambda: load_settings(path), folder)
    assert found.theme in ("dark", "light")
    assert len(found.window) == 2 and all(200 <= side < 1 << 15 for side in found.window), f"no window: {found.window}"
    for names in (found.recent, found.jobs, found.trusted):
        assert all(isinstance(name, str) for name in names)
        _ = [Path(name).is_file() for name in names]
    return True
