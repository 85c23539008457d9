"""Fuzzing targets and what each input is checked for: one clear line, or something finite that survives a round trip.

Each target starts from a valid file, changes its structure with values chosen to hurt, and then some of its bytes.
`tests/project/test_fuzz.py` runs a fixed few thousand inputs, `benchmarks/readers/fuzz.py` any number.
"""

from __future__ import annotations

import io
import json
import math
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from safetensors.numpy import save as safetensors_bytes

from app.jobs.job_events import Progress, read_line
from app.model.camera_control import OrbitCamera
from app.model.document import Document, Part, Training
from app.model.project import Project, Viewing, load_project, save_project
from app.model.rigid_transform import Motion
from benchmarks.readers.inputs import CAPTURES, CHANGES, JUNK, NUMBERS, POISON, broken, documents, plys, poisoned
from benchmarks.readers.pictures import FOREIGN, PICTURES, TEXTURES, check_foreign, check_picture, check_texture
from benchmarks.readers.records import (
    COLOURS,
    JOBS,
    MOVES,
    REQUESTS,
    SETTINGS,
    check_colours,
    check_job,
    check_meant_project,
    check_request,
    check_settings,
    misplaced,
)
from benchmarks.readers.rules import Target, result_or_refusal
from engine.io.load import load
from engine.io.splats.ply import read_ply, write_ply
from engine.io.trained import Meta, load_trained, save_trained, sidecar_path
from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane
from tests.helpers.solids import scatter
from training.batch.manifest import read_manifest
from training.checkpoint import Checkpoint
from training.cli import parse_axis, parse_families
from training.families import Family

__all__ = ["TARGETS", "Target"]


def check_scene(data: bytes, folder: Path, name: str = "a.ply") -> bool:
    path = folder / name
    path.write_bytes(data)
    loaded = result_or_refusal(lambda: load(path), folder)
    if loaded is None:
        return False
    g = loaded.gaussians
    assert len(g) > 0
    for key, values in vars(g).items():
        assert (key == "origin" or values.dtype == np.float32) and np.isfinite(values).all(), key
    assert (g.scales > 0).all()
    assert ((g.opacities >= 0) & (g.opacities <= 1)).all()
    assert np.abs(np.linalg.norm(g.quats.astype(np.float64), axis=1) - 1).max() < 1e-5
    write_ply(folder / "again.ply", g)
    again, dropped = read_ply(folder / "again.ply")
    assert not dropped and len(again) == len(g), dropped
    assert np.array_equal(again.means, g.means) and np.array_equal(again.sh, g.sh)
    assert np.allclose(again.scales, g.scales, rtol=1e-5) and np.allclose(again.opacities, g.opacities, atol=1e-6)
    return True


# projects


def whole_project(folder: Path) -> Project:
    """A project in which nothing has its default value."""
    document = Document(scene=folder / "melon.ply", up=(0.0, -1.0, 0.0), gap=0.3, explode=0.2)
    document = document.with_cut((Part(Plane.of((1, 2, 3), 0.1)),))
    document = document.with_cut((Part(Plane.of((-1, 0, 0), 0.7), ((1, -1),)), Part(Plane.of((0, 1, 0), 0.2))))
    motion = Motion.about((0.1, 0.2, 0.3), (1, 1, 1), 33.3)
    document = document.placed(((1, 1),), lambda p: type(p)(motion, False, True, "lid"))
    document = document.with_exemplars("horizontal", (folder / "a.png",))
    document = document.with_family(Family("custom", 1, custom=(Plane.of((3, 1, 2), 0.4),)))
    training = Training("high", "stable-diffusion", 7, 50, folder / "out", folder / "model", "bread")
    return Project(
        (Document(**vars(document) | {"training": training}),),
        Viewing(OrbitCamera((0.1, 1e9, -3.0)), "capture", (0.1, 0.2, 0.3)),
    )


def project_record() -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.fruitninja"
        save_project(path, whole_project(Path(folder)))
        return json.loads(path.read_bytes())


def check_project(data: bytes, folder: Path) -> bool:
    path = folder / "a.fruitninja"
    path.write_bytes(data)
    result_or_refusal(lambda: load_project(path), folder)
    project = result_or_refusal(lambda: load_project(path, outside=True), folder)
    if project is None:
        return False
    save_project(folder / "b.fruitninja", project)
    assert load_project(folder / "b.fruitninja", outside=True) == project
    for cut in project.documents[0].cuts:
        for part in cut.parts:
            assert np.isfinite([*cut.plane(part).normal, cut.plane(part).offset]).all()
    return True


def json_bytes(record: Any) -> bytes:
    """A document as JSON bytes, whatever characters are in it."""
    return json.dumps(record).encode("utf-8", "surrogatepass")


# checkpoints

ARRAYS = {"rgb": np.linspace(0, 1, 12, dtype=np.float32).reshape(4, 3), "sh": np.ones((2, 1, 3), np.float32)}


def checkpoint_bytes() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return Checkpoint(Path(folder), "run").save("training", ARRAYS, {"losses": [0.5, 0.25]}).read_bytes()


def foreign_checkpoint(facts: Any, run: str) -> bytes:
    """A checkpoint with facts that this project did not write."""
    return safetensors_bytes(ARRAYS, {"run": run, "facts": json.dumps(facts)})


def check_checkpoint(data: bytes, folder: Path) -> bool:
    (folder / "training.safetensors").write_bytes(data)
    kept = result_or_refusal(lambda: Checkpoint(folder, "run").load("training"), folder)
    if kept is None:
        return False
    arrays, facts = kept
    assert facts == {"losses": [0.5, 0.25]} and arrays.keys() == ARRAYS.keys(), "silent corruption"
    assert all(np.array_equal(arrays[name], ARRAYS[name]) for name in ARRAYS), "silent corruption"
    return True


# trained objects


def trained_files(suffix: str) -> tuple[Any, bytes]:
    """A sidecar, and its .ply or .spz."""
    atoms = scatter(3, 4)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        save_trained(path, atoms, Meta(families=({"kind": "radial", "count": 3},), prior="exemplar", source="a.ply"))
        return json.loads(sidecar_path(path).read_bytes()), path.read_bytes()


SIDECAR, TRAINED = trained_files(".ply")
COMPACT_SIDECAR, COMPACT_OBJECT = trained_files(".spz")


def check_trained(value: tuple[bytes, bytes], folder: Path, good: bytes = TRAINED, suffix: str = ".ply") -> bool:
    path = folder / f"t{suffix}"
    sidecar_path(path).write_bytes(value[0])
    path.write_bytes(value[1])
    loaded = result_or_refusal(lambda: load_trained(path), folder)
    if loaded is None:
        return False
    assert value[1] == good, "another file's atoms"
    atoms, meta = loaded
    save_trained(folder / "u.ply", atoms, meta)
    again, meta_again = load_trained(folder / "u.ply")
    assert meta_again == meta and again.pitch == atoms.pitch
    assert np.array_equal(again.interior.means, atoms.interior.means)
    assert np.allclose(again.interior.rgb, atoms.interior.rgb, atol=1e-6)
    return True


# arguments

WORD = st.sampled_from((*NUMBERS, "x", "-y", "+z", "horizontal", "radial", "parallel", "custom", "40", "3", "1,0,0",
                        "0,0,0", "1e308,1e308,1e308", "1e-13,0,0", "nan,0,1", "1,2,3,4", "0,0,0,1", "99999999999",
                        "1" * 5000, "٣", ":", "=", ",", "--"))  # fmt: skip
FAMILY = st.one_of(
    st.builds(":".join, st.lists(WORD, min_size=1, max_size=4)),
    st.builds(lambda k, n: f"{k}:{n}", st.sampled_from(("horizontal", "radial", "parallel", "custom")), WORD),
    st.text(max_size=12),
)
ARGUMENTS = st.tuples(
    st.lists(FAMILY, max_size=3), st.just([]) | st.lists(FAMILY, max_size=2), st.one_of(WORD, st.text(max_size=8))
)
CUBES = Grid(np.full(3, -1.0), 0.25, (8, 8, 8))
BALL = Body(CUBES, (1 - np.linalg.norm(CUBES.centres(), axis=-1)).astype(np.float32))


def check_arguments(value: tuple[list[str], list[str], str], folder: Path) -> bool:
    families, prompts, word = value
    axis = result_or_refusal(lambda: parse_axis(word, "--up"))
    assert axis is None or (np.isfinite(axis).all() and any(axis))
    found = result_or_refusal(lambda: parse_families([], families, [p.replace(":", "=", 1) for p in prompts], False))
    for family in found or ():
        planes = family.planes(BALL, np.array([0.0, 0.0, 1.0]))
        assert len(planes) == (len(family.custom) or family.count)
        rows = np.array([[*plane.normal, plane.offset] for plane in planes])
        assert np.isfinite(rows).all() and np.abs(np.linalg.norm(rows[:, :3], axis=1) - 1).max() < 1e-9, family
    return found is not None


@st.composite
def planes(draw: st.DrawFn) -> tuple[list[float], float]:
    """Normals of any length, including denormal and huge ones, and offsets."""
    some = st.sampled_from((0.0, -0.0, 1.0, -1.0, 1e-320, 1e-200, 1e-12, 1e-7, 1e154, 1e200, 1e308, math.nan, math.inf))
    value = st.one_of(some, st.floats())
    return draw(st.lists(value, min_size=draw(st.sampled_from((3, 3, 3, 2))), max_size=3)), draw(value)


def check_plane(value: tuple[list[float], float], folder: Path) -> bool:
    plane = result_or_refusal(lambda: Plane.of(*value))
    if plane is None:
        return False
    assert np.isfinite([*plane.normal, plane.offset]).all(), plane
    assert abs(math.hypot(*plane.normal) - 1) < 1e-9, plane
    again = Plane.of(plane.normal, plane.offset)
    assert np.allclose([*again.normal, again.offset], [*plane.normal, plane.offset], rtol=1e-12)
    return True


# manifests

ENTRY = {"scene": "a.ply", "name": "one", "exemplar": {"horizontal": ["a.png"]}, "family": ["horizontal:4"],
         "prompt": {"horizontal": "fruit"}, "up": "z", "detail": "draft", "prior": "exemplar", "object": "fruit",
         "iterations": 9, "seed": 1, "model": "", "midas": ""}  # fmt: skip


def toml(value: Any) -> str:
    """A value in TOML, as far as TOML can express it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(str(k))} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value)


SCENES = {"defaults": {"up": "z", "seed": 2}, "scene": [ENTRY, ENTRY | {"name": "two"}]}


def manifest(value: Any, junk: list[tuple[float, int, int]]) -> bytes:
    """A manifest in TOML, with broken bytes."""
    lines = []
    for key, part in value.items():
        tables = part if isinstance(part, list) and key == "scene" else [part]
        for table in tables:
            if isinstance(table, dict):
                lines += [f"[[{key}]]" if key == "scene" else f"[{json.dumps(key)}]"]
                lines += [f"{json.dumps(name)} = {toml(item)}" for name, item in table.items() if item is not None]
            else:
                lines.insert(0, f"{json.dumps(key)} = {toml(table)}")
    return broken("\n".join(lines).encode("utf-8", "surrogatepass"), junk)


def check_manifest(data: bytes, folder: Path) -> bool:
    picture = io.BytesIO()
    if not (folder / "a.png").exists():
        from PIL import Image

        Image.new("RGB", (4, 4)).save(picture, "png")
        (folder / "a.png").write_bytes(picture.getvalue())
        (folder / "a.ply").write_bytes(b"")
    path = folder / "all.toml"
    path.write_bytes(data)
    scenes = result_or_refusal(lambda: read_manifest(path), folder)
    if scenes is None:
        return False
    assert scenes
    assert len({scene.name for scene in scenes}) == len(scenes)
    for scene in scenes:
        assert (folder / scene.name).resolve().parent == folder.resolve(), scene.name
        assert scene.request.fingerprint() == scene.request.fingerprint()
        assert scene.request.up is None or np.isfinite(scene.request.up).all()
    return True


# events that the trainer sends to the window

EVENT = {"event": "progress", "seconds": 1.5, "stage": "train", "part": 0.5, "iteration": 4,
         "iterations": 9, "losses": {"section": 0.1, "surface": 0.2}, "paths": ["a"], "message": "m", "scene": "s",
         "report": "r"}  # fmt: skip


def check_event(data: bytes, folder: Path) -> bool:
    progress = Progress(section=[0.5], surface=[0.5])
    read_line(progress, data)
    assert 0 <= progress.stage_fraction <= 1 and 0 <= progress.fraction <= 1 and len(progress.section) <= 100_002
    assert math.isfinite(progress.seconds) and (progress.remaining is None or math.isfinite(progress.remaining))
    return True


def quiet(check: Callable[[Any, Path], bool]) -> Callable[[Any, Path], bool]:
    """The check with every RuntimeWarning as an error: an overflow that only warns is a wrong number."""

    def checked(value: Any, folder: Path) -> bool:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            return check(value, folder)

    return checked


TARGETS: dict[str, Target] = {
    "ply": Target(plys(), quiet(check_scene), 0.3),
    "captures": Target(CAPTURES, quiet(lambda value, folder: check_scene(value[1], folder, value[0])), 0.15),
    "project": Target(documents(project_record()), quiet(check_project), 0.15),
    "checkpoint": Target(
        st.builds(broken, st.just(checkpoint_bytes()), JUNK)
        | st.builds(foreign_checkpoint, st.sampled_from(POISON[:30]), st.sampled_from(("run", "", "other"))),
        quiet(check_checkpoint),
        0.1,
    ),
    "trained": Target(
        st.tuples(
            documents(SIDECAR) | st.builds(lambda moves: json_bytes(misplaced(SIDECAR, moves)), MOVES),
            st.just(TRAINED) | st.builds(broken, st.just(TRAINED), JUNK),
        ),
        quiet(check_trained),
        0.1,
    ),
    "compact": Target(
        st.tuples(
            documents(COMPACT_SIDECAR) | st.builds(lambda moves: json_bytes(misplaced(COMPACT_SIDECAR, moves)), MOVES),
            st.just(COMPACT_OBJECT) | st.builds(broken, st.just(COMPACT_OBJECT), JUNK),
        ),
        quiet(lambda value, folder: check_trained(value, folder, COMPACT_OBJECT, ".spz")),
        0.05,
    ),
    "arguments": Target(ARGUMENTS, quiet(check_arguments), 0.1),
    "plane": Target(planes(), quiet(check_plane), 0.05),
    "manifest": Target(
        st.builds(manifest, st.builds(poisoned, st.just(SCENES), CHANGES), st.just([]) | JUNK)
        | st.builds(manifest, st.builds(misplaced, st.just(SCENES), MOVES), st.just([])),
        quiet(check_manifest),
        0.05,
    ),
    "events": Target(documents(EVENT), quiet(check_event), 0.05),
    "meaning": Target(st.builds(misplaced, st.just(project_record()), MOVES), quiet(check_meant_project), 0.05),
    "job": Target(JOBS, quiet(check_job), 0.05),
    "request": Target(REQUESTS, quiet(check_request), 0.05),
    "colours": Target(COLOURS, quiet(check_colours), 0.05),
    "settings": Target(SETTINGS, quiet(check_settings), 0.03),
    "pictures": Target(PICTURES, quiet(check_picture), 0.05),
    "textures": Target(TEXTURES, quiet(check_texture), 0.05),
    "foreign": Target(FOREIGN, quiet(check_foreign), 0.03),
}
