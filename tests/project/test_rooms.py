"""The arrows between the rooms: which may import which, as drawn in docs/ARCHITECTURE.md.

Imports are read from the source, including those inside functions and under TYPE_CHECKING: readers have to follow all
of them.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

from tests.paths import ROOT

PACKAGES = ("app", "engine", "fruitninja", "sample_scenes", "shaders", "training")
"""The installed packages."""

FILES_OF_A_ROOM = 14
"""Most files in a room: as many names as a reader takes in at a glance; `__init__.py` does not count."""

LINES_OF_A_FILE = 450

FOUNDATION = ("engine.errors", "engine.compiler", "engine.light", "engine.processes", "engine.threads")
"""Errors, compiling, processes and threads: they know no Gaussians, and every room of the engine may use them."""

DRAWING = (*FOUNDATION, "engine.scene", "engine.render.projection", "engine.render.lanes")
"""Modules that all renderers share."""

MAY_IMPORT = {
    "shaders": (),
    "engine": FOUNDATION,
    "engine.scene": FOUNDATION,
    "engine.io": (*FOUNDATION, "engine.scene"),
    "engine.command": (*FOUNDATION, "engine.scene", "engine.io"),
    "engine.render": (*FOUNDATION, "engine.scene", "engine.render.lanes"),
    "engine.render.culling": DRAWING,
    "engine.render.classic": DRAWING,
    "engine.render.cpu": (*DRAWING, "engine.render.culling", "engine.render.classic"),
    "engine.render.gl": (
        *DRAWING,
        "engine.render.culling",
        "engine.render.classic",
        "engine.render.cpu",
        "engine.render.defines",
        "shaders",
    ),
    "engine.render.face_detail": (*DRAWING, "engine.render.cpu"),
    "engine.solid": (*FOUNDATION, "engine.scene", "engine.io", "engine.render"),
    "engine.export": (*FOUNDATION, "engine.scene", "engine.io", "engine.render", "engine.solid"),
    "engine.export.page": (*FOUNDATION, "engine.scene", "engine.io", "engine.render", "engine.export", "shaders"),
    "engine.isolate": (*FOUNDATION, "engine.scene", "engine.io", "engine.solid"),
    "engine.fit": (*FOUNDATION, "engine.scene", "engine.io", "engine.render", "engine.solid"),
    "training": ("engine",),
    "training.evaluate": ("engine", "sample_scenes", "training"),
    "sample_scenes": ("engine", "training.families"),
    "fruitninja": ("engine", "training"),
    "app.translation": (),
    "app.model": ("app.translation", "engine", "training"),
    "app.jobs": ("app.translation", "app.model", "engine", "training"),
    "app.jobs.film": ("app.translation", "app.model", "app.jobs", "engine", "fruitninja", "training"),
    "app.session": ("app.translation", "app.model", "app.jobs", "engine", "training"),
    "app.ui": ("app.translation", "app.model", "app.jobs", "app.session", "engine", "training"),
    "app.main": ("app", "engine", "training"),
    "app.film_cli": ("app.model", "app.jobs", "engine", "training"),
    "app.render_cli": ("app.film_cli", "app.jobs", "engine", "fruitninja", "training"),
    "app.export_cli": ("engine", "fruitninja"),
}
"""The project's own modules that each room may import beside itself; the longest room name that fits a module decides.

`sample_scenes` describes its cuts with `training.families`, and only `training.evaluate`, which cuts scenes of known
inside, imports it in turn.
"""

USERS = ("benchmarks", "tests", "tools")
"""What is not installed."""

EQUIPMENT = ("tests.browser", "tests.helpers", "tests.paths", "tests.reference")
"""Sample objects, slow references, a browser, what moves the window's pointer: all that benchmarks and tools may import
of the tests. It knows neither them nor any test."""

NO_OPENGL = ("imgui_bundle", "glfw", "moderngl")

KEEPS_OFF = {
    "app.model": (*NO_OPENGL, "subprocess"),
    "app.session": (*NO_OPENGL, "subprocess"),
    "engine.scene": NO_OPENGL,
    "engine.io": NO_OPENGL,
    "engine.render.culling": NO_OPENGL,
    "engine.render.classic": NO_OPENGL,
    "engine.render.cpu": NO_OPENGL,
    "engine.render.gl": ("imgui_bundle", "glfw"),
    "engine.solid": NO_OPENGL,
    "engine.export": NO_OPENGL,
    "engine.isolate": NO_OPENGL,
    "engine.fit": NO_OPENGL,
    "training": NO_OPENGL,
    "fruitninja": NO_OPENGL,
    "sample_scenes": NO_OPENGL,
}
"""Libraries that a room must do without: a window, OpenGL, other processes."""


def module_of(path: Path) -> str:
    """The dotted name of a source file."""
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    return name.removesuffix(".__init__")


@cache
def sources(tops: tuple[str, ...] = PACKAGES) -> dict[str, Path]:
    """Every module in these folders, or every installed one, by its dotted name."""
    return {module_of(path): path for top in tops for path in sorted((ROOT / top).rglob("*.py"))}


@cache
def imports(name: str) -> frozenset[str]:
    """Modules that a module imports, our own by full name: `from engine.scene import sh` is `engine.scene.sh`."""
    ours = sources((*PACKAGES, *USERS))
    path = ours[name]
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = package.rsplit(".", node.level - 1)[0]
                base = f"{parent}.{base}".rstrip(".")
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                found.add(inner if inner in ours else base)
    return frozenset(found)


def within(name: str, room: str) -> bool:
    return name == room or name.startswith(room + ".")


def room_of(name: str) -> str:
    """The room whose rules hold for a module."""
    return max((room for room in MAY_IMPORT if within(name, room)), key=len, default="")


def test_every_module_stands_in_a_room() -> None:
    assert [name for name in sources() if not room_of(name)] == ["app"]
    assert not [room for room in MAY_IMPORT if not any(within(name, room) for name in sources())]


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_imports_only_rooms_before_it(room: str) -> None:
    wrong = [
        f"{name} imports {target}"
        for name in sources()
        if room_of(name) == room
        for target in sorted(imports(name))
        if target in sources() and target != "app" and not within(target, room)
        if not any(within(target, other) for other in MAY_IMPORT[room])
    ]
    assert not wrong


@pytest.mark.parametrize("room", KEEPS_OFF)
def test_a_room_does_without_libraries_of_another(room: str) -> None:
    wrong = [
        f"{name} imports {target}"
        for name in sources()
        if within(name, room)
        for target in sorted(imports(name))
        if target.partition(".")[0] in KEEPS_OFF[room]
    ]
    assert not wrong


def test_benchmarks_and_tools_share_the_equipment_of_tests_and_nothing_else_of_them() -> None:
    def equipment(name: str) -> bool:
        return any(within(name, part) for part in EQUIPMENT)

    wrong = [
        f"{name} imports {target}"
        for name in sources(USERS)
        for target in sorted(imports(name))
        if (equipment(name) and not equipment(target) and target.partition(".")[0] in USERS)
        or (not within(name, "tests") and within(target, "tests") and not equipment(target))
    ]
    assert not wrong


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that can all reach one another."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        seen: set[str] = set()
        waiting = [start]
        while waiting:
            for target in graph[waiting.pop()] - seen:
                seen.add(target)
                waiting.append(target)
        reach[start] = seen
    groups = {tuple(sorted(other for other in reach[name] if name in reach[other])) for name in graph}
    return [list(group) for group in sorted(groups) if group]


def test_no_files_import_each_other_in_a_circle() -> None:
    graph = {name: {t for t in imports(name) if t in sources() and t != name} for name in sources()}
    assert not circles(graph)


def test_a_circle_is_seen() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set()}) == [["a", "b", "c"]]


def tracked_folders() -> dict[str, list[Path]]:
    """Python files in each folder of the project."""
    folders: dict[str, list[Path]] = {}
    for top in (*PACKAGES, "tests", "tools", "benchmarks", "examples"):
        for path in sorted((ROOT / top).rglob("*.py")):
            folders.setdefault(str(path.parent.relative_to(ROOT)), []).append(path)
    return folders


def test_rooms_are_small() -> None:
    counts = {f: sum(path.name != "__init__.py" for path in paths) for f, paths in tracked_folders().items()}
    assert not {folder: count for folder, count in counts.items() if count > FILES_OF_A_ROOM}


def test_files_are_short() -> None:
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for paths in tracked_folders().values()
        for path in paths
    }
    assert not {name: length for name, length in lengths.items() if length > LINES_OF_A_FILE}
