"""What is fuzzed, and what is held against each input: one clear line, or something finite that survives a round trip.

Each target starts from a file that is right, changes its structure with values chosen to hurt, and then some of its
bytes. `tests/test_fuzz.py` runs a fixed few thousand of them, `benchmarks/fuzz.py` as many as one likes.
"""

from __future__ import annotations

import copy
import gzip
import io
import json
import math
import struct
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from safetensors.numpy import save as safetensors_bytes

from app.camera_control import Eye
from app.document import Document, Part, Training
from app.job_events import Progress, read_line
from app.motion import Motion
from app.project import Project, Viewing, load_project, save_project
from engine.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.body import Body
from engine.errors import InputError
from engine.load import load
from engine.plane import Plane
from engine.ply import read_ply, write_ply
from engine.trained import Meta, load_trained, save_trained, sidecar_path
from training.batch.manifest import Mistakes, read_manifest
from training.checkpoint import Checkpoint
from training.cli import parse_axis, parse_families
from training.families import Family

__all__ = ["TARGETS", "Target"]

LONGEST = 1000
"""Characters of the longest line that a user is shown: a path, what is wrong with it, what to do."""

POISON: tuple[Any, ...] = (
    None, True, False, 0, -0.0, 1, -1, 2, 3, 255, 1e-320, 1e-30, 1e12, 1e38, 3.5e38, 1e308, -1e308, math.nan,
    math.inf, -math.inf, 2**31, 2**53, 2**63, -(2**63), 10**30, 10**400, "", "x", "\0", "NaN", "../..", "/etc/passwd",
    "²", "٣", "\ud800", "a" * 20_000, [], {}, [[]], [0, 0, 0], [1, 0, 0], [1e308] * 4, [math.nan] * 3, {"kind": 3},
)  # fmt: skip

NUMBERS = ("nan", "inf", "-inf", "1e38", "3.5e38", "1e39", "-1e38", "1e-45", "0", "-0", "1", "88", "-104", "1e308",
           "1e400", "30", "-30", "40", "1e9", "1e4", "9" * 22, "²", "", "x", "0x1p3", "1_0", "\0")  # fmt: skip


@dataclass(frozen=True)
class Target:
    """Something that reads what a user may give it."""

    inputs: st.SearchStrategy[Any]
    check: Callable[[Any, Path], bool]
    """Whether the input was accepted; raises where the promise is broken. The path is a folder to write in."""
    share: float
    """Of all inputs."""


def refused(read: Callable[[], Any]) -> Any:
    """What `read` gives, None where it refuses as it should: an InputError of printable lines."""
    try:
        return read()
    except InputError as error:
        text = str(error)
        assert text.strip(), "an empty message"
        for line in text.split("\n") if isinstance(error, Mistakes) else [text]:
            assert len(line) <= LONGEST and line.isprintable(), f"no readable line: {line[:LONGEST]!r}"
        assert not any(word in text for word in ("Traceback", "dtype")), text
        return None


# mutations

JUNK = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 9), st.integers(0, 255)), max_size=3)
"""Where, how, and with what the bytes of a file are changed."""


def broken(data: bytes, junk: list[tuple[float, int, int]]) -> bytes:
    """The bytes with a few overwritten, cut, repeated, or put elsewhere."""
    for where, how, value in junk:
        at = int(where * max(len(data) - 1, 0))
        if how < 4:
            data = data[:at] + bytes([value]) + data[at + 1 :]
        elif how == 4:
            data = data[:at]
        elif how == 5:
            data = data[:at] + data[at + 1 + value :]
        elif how == 6:
            data = data[: at + value] + data[at:]
        elif how == 7:
            data = data[:at] + struct.pack("<f", (math.nan, math.inf, 1e38, -1e38, 1e-45)[value % 5]) + data[at + 4 :]
        elif how == 8:
            data = data[:at] + b"\xff" * (value % 9) + data[at + value % 9 :]
        else:
            data = data[:at] + data[at:] * 2 if len(data) < 1 << 16 else data
    return data


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The way to every value of a JSON document, the document itself left out."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [found for key, item in items for found in ((*path, key), *places(item, (*path, key)))]


def poisoned(value: Any, changes: list[tuple[float, int, int]]) -> Any:
    """The document with a few values replaced by poison, taken away, or doubled."""
    value = copy.deepcopy(value)
    for where, how, which in changes:
        found = places(value)
        if not found:
            return value
        *way, last = found[int(where * (len(found) - 1))]
        holder = value
        for key in way:
            holder = holder[key]
        if how < 7:
            holder[last] = copy.deepcopy(POISON[which % len(POISON)])
        elif how == 7:
            del holder[last]
        elif how == 8 and isinstance(holder, list):
            holder.insert(last, copy.deepcopy(holder[last]))
        elif isinstance(holder, dict):
            holder[str(last) + "x"] = holder[last]
    return value


CHANGES = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 9), st.integers(0, 255)), max_size=3)


def documents(record: Any) -> st.SearchStrategy[bytes]:
    """Poisoned JSON, sometimes nested too deep, sometimes with broken bytes."""

    def text(changes: list[tuple[float, int, int]], junk: list[tuple[float, int, int]], deep: int) -> bytes:
        if deep == 0:
            return b"[" * 100_000
        return broken(json.dumps(poisoned(record, changes)).encode("utf-8", "surrogatepass"), junk)

    return st.builds(text, CHANGES, st.just([]) | JUNK, st.integers(0, 200))


# .ply

NAMES = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1",
         "rot_2", "rot_3")  # fmt: skip
TYPES = {"float": "f", "double": "d", "uchar": "B", "int": "i", "short": "h"}
COUNTS = ("-1", "0", "1", "2", "3", "4", "1000000000000", "18446744073709551616", "4294967296", "1e3", "", "x")


@st.composite
def plys(draw: st.DrawFn) -> bytes:
    """A small scene in some dialect, with poison in its rows and its header."""
    kind = draw(st.sampled_from(("ascii", "binary_little_endian", "binary_big_endian")))
    rest = draw(st.sampled_from((0, 0, 9, 24, 45, 8)))
    names = [*NAMES, *(f"f_rest_{i}" for i in range(rest))]
    rows = draw(st.integers(0, 4))
    type_ = draw(st.sampled_from(("float", "float", "float", "double", "int", "uchar", "quad")))
    table = [[0.1 * (i + j) for j in range(len(names))] for i in range(rows)]
    texts = [[f"{value:.6g}" for value in row] for row in table]
    for _ in range(draw(st.integers(0, 3)) if rows else 0):
        texts[draw(st.integers(0, rows - 1))][draw(st.integers(0, len(names) - 1))] = draw(st.sampled_from(NUMBERS))
    lines = ["ply", f"format {kind} 1.0", f"element vertex {rows}", *(f"property {type_} {name}" for name in names)]
    extra = draw(st.sampled_from(("", "list", "face", "camera")))
    body = b""
    if extra:
        lines[2:2] = [f"element {extra} 1", "property list uchar int i" if extra != "camera" else "property float f"]
        body = b"1 7\n" if kind == "ascii" else struct.pack("<Bi" if extra != "camera" else "<f", *((1, 7, 1.0)[:2] if extra != "camera" else (1.0,)))  # fmt: skip  # noqa: E501
    for _ in range(draw(st.integers(0, 2))):
        at = draw(st.integers(0, len(lines) - 1))
        how = draw(st.integers(0, 5))
        if how == 0:
            lines[at] = f"element vertex {draw(st.sampled_from(COUNTS))}"
        elif how == 1:
            del lines[at]
        elif how == 2:
            lines.insert(at, lines[at])
        elif how == 3:
            lines.insert(
                at, draw(st.sampled_from(("comment \xe9", "end_header", "", "property", "element", "obj_info")))
            )
        elif how == 4:
            lines[at] += draw(st.sampled_from((" ", "\t", "\r", " x", "\0")))
        else:
            lines.insert(at, "property list int int " + draw(st.sampled_from(NAMES)))
        if not lines:
            break
    head = draw(st.sampled_from(("\n", "\n", "\r\n", "\r"))).join([*lines, "end_header", ""]).encode("latin-1")
    if kind == "ascii":
        body += b"".join(" ".join(row).encode("latin-1", "replace") + b"\n" for row in texts)
    else:
        order, code = "<" if "little" in kind else ">", TYPES.get(type_, "f")
        body += b"".join(number(order + code, value) for row in texts for value in row)
    return broken(head + body, draw(st.just([]) | JUNK))


def number(code: str, text: str) -> bytes:
    """A number as bytes, as near as the type allows."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    try:
        return struct.pack(code, value if code[1] in "fd" else int(value))
    except (struct.error, OverflowError, ValueError):
        return b"\xff" * struct.calcsize(code)


def check_scene(data: bytes, folder: Path, name: str = "a.ply") -> bool:
    path = folder / name
    path.write_bytes(data)
    loaded = refused(lambda: load(path))
    if loaded is None:
        return False
    g = loaded.gaussians
    assert len(g) > 0
    for key, values in vars(g).items():
        assert values.dtype == np.float32 and np.isfinite(values).all(), key
    assert (g.scales > 0).all()
    assert ((g.opacities >= 0) & (g.opacities <= 1)).all()
    assert np.abs(np.linalg.norm(g.quats.astype(np.float64), axis=1) - 1).max() < 1e-5
    write_ply(folder / "again.ply", g)
    again, dropped = read_ply(folder / "again.ply")
    assert not dropped and len(again) == len(g), dropped
    assert np.array_equal(again.means, g.means) and np.array_equal(again.sh, g.sh)
    assert np.allclose(again.scales, g.scales, rtol=1e-5) and np.allclose(again.opacities, g.opacities, atol=1e-6)
    return True


# other captures: .splat, .spz, SuperSplat's compressed .ply


def compressed() -> bytes:
    """Two Gaussians in SuperSplat's packing."""
    ends = [f"{end}_{what}" for end in ("min", "max") for what in ("x", "y", "z", "scale_x", "scale_y", "scale_z")]
    packed = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
    head = ["ply", "format binary_little_endian 1.0", "element chunk 1", *(f"property float {name}" for name in ends)]
    head += ["element vertex 2", *(f"property uint {name}" for name in packed), "end_header", ""]
    bounds = struct.pack("<12f", -1, -1, -1, -5, -5, -5, 1, 1, 1, -2, -2, -2)
    return "\n".join(head).encode() + bounds + struct.pack("<8I", *([0x3FE7F9FF, 0x20080200, 77, 0x80FF40C0] * 2))


def spz(version: int, count: int, degree: int, bits: int, flags: int, body: bytes) -> bytes:
    """An .spz of these header fields."""
    return gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, bits, flags, 0) + body, mtime=0)


SPZ_BYTES = st.builds(
    spz,
    st.sampled_from((2, 2, 3, 1, 4)),
    st.sampled_from((2, 2, 2, 0, 3, 2**24, 2**32 - 1)),
    st.sampled_from((0, 0, 1, 3, 4, 255)),
    st.sampled_from((12, 12, 0, 23, 255)),
    st.sampled_from((0, 1, 2, 255)),
    st.builds(lambda n, b: bytes([b]) * n, st.sampled_from((0, 38, 40, 56, 130, 4000)), st.integers(0, 255)),
)
SPLAT_ROW = struct.pack("<6f8B", 0.1, 0.2, 0.3, 0.01, 0.02, 0.03, 9, 99, 199, 255, 228, 128, 128, 128)
CAPTURES = st.one_of(
    st.tuples(st.just("a.splat"), st.builds(lambda n, j: broken(SPLAT_ROW * n, j), st.integers(0, 120), JUNK)),
    st.tuples(st.just("a.spz"), st.builds(broken, SPZ_BYTES, st.just([]) | JUNK)),
    st.tuples(st.just("a.ply"), st.builds(broken, st.just(compressed()), JUNK)),
    st.tuples(st.sampled_from(("a.obj", "a.stl", "a.glb", "a.ksplat", "a")), st.binary(max_size=60)),
)


# projects


def whole_project(folder: Path) -> Project:
    """A project in which nothing has its default."""
    document = Document(scene=folder / "melon.ply", up=(0.0, -1.0, 0.0), gap=0.3, explode=0.2)
    document = document.with_cut((Part(Plane.of((1, 2, 3), 0.1)),))
    document = document.with_cut((Part(Plane.of((-1, 0, 0), 0.7), ((1, -1),)), Part(Plane.of((0, 1, 0), 0.2))))
    motion = Motion.about((0.1, 0.2, 0.3), (1, 1, 1), 33.3)
    document = document.placed(((1, 1),), lambda p: type(p)(motion, False, True, "lid"))
    document = document.with_exemplars("horizontal", (folder / "a.png",))
    document = document.with_family(Family("custom", 1, custom=(Plane.of((3, 1, 2), 0.4),)))
    training = Training("high", "stable-diffusion", 7, 50, folder / "out", folder / "model", "bread")
    return Project(
        Document(**vars(document) | {"training": training}), Viewing(Eye((0.1, 1e9, -3.0)), "capture", (0.1, 0.2, 0.3))
    )


def project_record() -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.fruitninja"
        save_project(path, whole_project(Path(folder)))
        return json.loads(path.read_bytes())


def check_project(data: bytes, folder: Path) -> bool:
    path = folder / "a.fruitninja"
    path.write_bytes(data)
    refused(lambda: load_project(path))
    project = refused(lambda: load_project(path, outside=True))
    if project is None:
        return False
    save_project(folder / "b.fruitninja", project)
    assert load_project(folder / "b.fruitninja", outside=True) == project
    for cut in project.document.cuts:
        for part in cut.parts:
            assert np.isfinite([*cut.plane(part).normal, cut.plane(part).offset]).all()
    return True


# checkpoints

ARRAYS = {"rgb": np.linspace(0, 1, 12, dtype=np.float32).reshape(4, 3), "sh": np.ones((2, 1, 3), np.float32)}


def checkpoint_bytes() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return Checkpoint(Path(folder), "run").save("training", ARRAYS, {"losses": [0.5, 0.25]}).read_bytes()


def foreign_checkpoint(facts: Any, run: str) -> bytes:
    """A checkpoint whose facts are not this project's."""
    return safetensors_bytes(ARRAYS, {"run": run, "facts": json.dumps(facts)})


def check_checkpoint(data: bytes, folder: Path) -> bool:
    (folder / "training.safetensors").write_bytes(data)
    kept = refused(lambda: Checkpoint(folder, "run").load("training"))
    if kept is None:
        return False
    arrays, facts = kept
    assert facts == {"losses": [0.5, 0.25]} and arrays.keys() == ARRAYS.keys(), "silent corruption"
    assert all(np.array_equal(arrays[name], ARRAYS[name]) for name in ARRAYS), "silent corruption"
    return True


# trained objects


def trained_files() -> tuple[Any, bytes]:
    """A sidecar and its .ply."""
    rng = np.random.default_rng(0)
    quats = np.tile(np.float32([1, 0, 0, 0]), (3, 1))
    sh = rng.random((3, 4, 3)).astype(np.float32)
    surface = SurfaceAtoms(rng.random((3, 3)).astype(np.float32), np.full((3, 3), 0.1, np.float32), quats, sh)
    inner = [rng.random(shape).astype(np.float32) for shape in ((4, 3), 4, (4, 3))]
    atoms = Atoms(surface, InteriorAtoms(inner[0], inner[1] + np.float32(0.1), inner[2], 1), 0.1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.ply"
        save_trained(path, atoms, Meta(families=({"kind": "radial", "count": 3},), prior="exemplar", source="a.ply"))
        return json.loads(sidecar_path(path).read_bytes()), path.read_bytes()


SIDECAR, TRAINED = trained_files()


def check_trained(value: tuple[bytes, bytes], folder: Path) -> bool:
    path = folder / "t.ply"
    sidecar_path(path).write_bytes(value[0])
    path.write_bytes(value[1])
    loaded = refused(lambda: load_trained(path))
    if loaded is None:
        return False
    assert value[1] == TRAINED, "another file's atoms"
    atoms, meta = loaded
    save_trained(folder / "u.ply", atoms, meta)
    again, meta_again = load_trained(folder / "u.ply")
    assert meta_again == meta and again.pitch == atoms.pitch and again.interior.exposed == atoms.interior.exposed
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
BALL = Body(np.full(3, -1.0), 0.25, (1 - np.linalg.norm(np.stack(np.meshgrid(*[np.linspace(-0.875, 0.875, 8)] * 3), -1),
                                                        axis=-1)).astype(np.float32))  # fmt: skip


def check_arguments(value: tuple[list[str], list[str], str], folder: Path) -> bool:
    families, prompts, word = value
    axis = refused(lambda: parse_axis(word, "--up"))
    assert axis is None or (np.isfinite(axis).all() and any(axis))
    found = refused(lambda: parse_families([], families, [p.replace(":", "=", 1) for p in prompts], False))
    for family in found or ():
        planes = family.planes(BALL, np.array([0.0, 0.0, 1.0]))
        assert len(planes) == (len(family.custom) or family.count)
        rows = np.array([[*plane.normal, plane.offset] for plane in planes])
        assert np.isfinite(rows).all() and np.abs(np.linalg.norm(rows[:, :3], axis=1) - 1).max() < 1e-9, family
    return found is not None


@st.composite
def planes(draw: st.DrawFn) -> tuple[list[float], float]:
    """Normals of any length, denormal and huge ones among them, and offsets."""
    some = st.sampled_from((0.0, -0.0, 1.0, -1.0, 1e-320, 1e-200, 1e-12, 1e-7, 1e154, 1e200, 1e308, math.nan, math.inf))
    value = st.one_of(some, st.floats())
    return draw(st.lists(value, min_size=draw(st.sampled_from((3, 3, 3, 2))), max_size=3)), draw(value)


def check_plane(value: tuple[list[float], float], folder: Path) -> bool:
    plane = refused(lambda: Plane.of(*value))
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
    """A value in TOML, as far as TOML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(str(k))} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value)


def manifest(changes: list[tuple[float, int, int]], junk: list[tuple[float, int, int]]) -> bytes:
    value = poisoned({"defaults": {"up": "z", "seed": 2}, "scene": [ENTRY, ENTRY | {"name": "two"}]}, changes)
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
    scenes = refused(lambda: read_manifest(path))
    if scenes is None:
        return False
    assert scenes
    assert len({scene.name for scene in scenes}) == len(scenes)
    for scene in scenes:
        assert (folder / scene.name).resolve().parent == folder.resolve(), scene.name
        assert scene.request.fingerprint() == scene.request.fingerprint()
        assert scene.request.up is None or np.isfinite(scene.request.up).all()
    return True


# what the trainer says to the window

EVENT = {"event": "progress", "seconds": 1.5, "stage": "train", "part": 0.5, "eta": 3.0, "iteration": 4,
         "iterations": 9, "losses": {"section": 0.1, "surface": 0.2}, "paths": ["a"], "message": "m", "scene": "s",
         "report": "r"}  # fmt: skip


def check_event(data: bytes, folder: Path) -> bool:
    progress = Progress(section=[0.5], surface=[0.5])
    read_line(progress, data)
    assert 0 <= progress.part <= 1 and 0 <= progress.whole <= 1 and len(progress.section) <= 100_002
    assert math.isfinite(progress.seconds) and (progress.left is None or math.isfinite(progress.left))
    return True


def quiet(check: Callable[[Any, Path], bool]) -> Callable[[Any, Path], bool]:
    """The check with every RuntimeWarning an error: an overflow that is only warned of is a wrong number."""

    def checked(value: Any, folder: Path) -> bool:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            return check(value, folder)

    return checked


TARGETS: dict[str, Target] = {
    "ply": Target(plys(), quiet(check_scene), 0.3),
    "captures": Target(CAPTURES, quiet(lambda value, folder: check_scene(value[1], folder, value[0])), 0.1),
    "project": Target(documents(project_record()), quiet(check_project), 0.15),
    "checkpoint": Target(
        st.builds(broken, st.just(checkpoint_bytes()), JUNK)
        | st.builds(foreign_checkpoint, st.sampled_from(POISON[:30]), st.sampled_from(("run", "", "other"))),
        quiet(check_checkpoint),
        0.1,
    ),
    "trained": Target(
        st.tuples(documents(SIDECAR), st.just(TRAINED) | st.builds(broken, st.just(TRAINED), JUNK)),
        quiet(check_trained),
        0.1,
    ),
    "arguments": Target(ARGUMENTS, quiet(check_arguments), 0.1),
    "plane": Target(planes(), quiet(check_plane), 0.05),
    "manifest": Target(st.builds(manifest, CHANGES, st.just([]) | JUNK), quiet(check_manifest), 0.05),
    "events": Target(documents(EVENT), quiet(check_event), 0.05),
}
