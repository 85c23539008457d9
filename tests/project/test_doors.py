"""Every place where the program opens a file, starts a process, listens or runs code is one that somebody reviewed.

`docs/TRUST.md` lists them with their guards; a new one belongs there, and here if it is of a dangerous kind.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.paths import ROOT

PACKAGES = ("app", "engine", "fruitninja", "sample_scenes", "shaders", "tools", "training")

DANGEROUS = {
    "picture": r"(PIL\.)?Image\.open",
    "process": r"subprocess\.\w+|Popen|os\.(system|popen|exec\w+|spawn\w+|posix_spawn\w*|fork\w*|startfile)"
    r"|multiprocessing\.(get_context|Process|Pool)|ProcessPoolExecutor|LocalCluster|pty\.\w+",
    "network": r"(socket|socketserver|http|requests|httpx|urllib\.request|webbrowser|huggingface_hub)\..*"
    r"|(distributed\.)?Client|urlopen|hf_hub_download|snapshot_download",
    "code": r"eval|exec|compile|__import__|importlib\.import_module|runpy\..*|ctypes\..*|torch\.(hub|jit)\..*",
    "pickle": r"(_?pickle|cPickle|marshal|shelve|dill|joblib|cloudpickle|yaml)\..*|torch\.load"
    r"|(np|numpy)\.(load|fromfile|memmap)|pd\.read_\w+",
    "archive": r"(zipfile|tarfile)\..*|shutil\.unpack_archive|.+\.extractall",
    "bare file": r"open|(io|os|codecs)\.(open|fdopen)|.+\.(read_text|read_bytes|write_text|write_bytes|touch)",
    "weights": r".+\.from_pretrained|safe_open|load_file|onnxruntime\..*",
    "mesh": r"trimesh\.load\w*",
    "dialog": r"pfd\.\w+",
}
"""What a call or an import is named, in full, that opens a door."""
"""Full names of the calls and imports that open a door, by kind of door."""
GUARDS = r"(files\.)?(open_file|read_file|atomic|locked_folder|write_json)|save_png|save_file"
"""Calls that may be anywhere, as long as the document lists the file."""

MODE = re.compile(r"[rwax][bt+]*")
"""The argument that tells `path.open("rb")` from other methods called open."""

ALLOWED = {
    "picture": {"engine/io/picture_file.py"},
    "process": {
        "app/jobs/training_job.py",
        "app/jobs/export.py",
        "engine/processes.py",
        "tools/film.py",
        "tools/notebook.py",
        "tools/screenshots.py",
        "tools/sheet.py",
        "training/batch/cluster.py",
        "training/evaluate/grid.py",
    },
    "network": {"training/batch/cluster.py", "training/batch/grid.py"},
    "code": set(),
    "pickle": {"engine/compiler.py", "training/evaluate/features.py", "training/evaluate/scenes.py"},
    "archive": {"engine/export/volumes/files.py", "engine/io/splats/sog.py", "engine/io/writers/sog.py"},
    "bare file": {
        "app/jobs/training_job.py",
        "engine/command.py",
        "engine/compiler.py",  # its own sources, as locks
        "engine/export/page/page.py",  # its own sources, which are package data
        "engine/io/files.py",
        "engine/io/scratch.py",
        "shaders/__init__.py",
        "training/priors/diffusion/saving.py",
        "tools/figures.py",  # charts and pages of the project itself, for developers
        "tools/site_pages.py",  # pages of the project itself, for developers
    },
    "weights": {
        "app/jobs/live_colours.py",
        "training/checkpoint.py",
        "training/evaluate/cuts.py",
        "training/evaluate/features.py",
        "training/evaluate/measure.py",
        "training/priors/diffusion/loading.py",
        "training/priors/diffusion/saving.py",
    },
    "mesh": {"engine/io/meshes/mesh.py"},
    "dialog": {"app/ui/dialogs/file_dialogs.py"},
}
"""Files in which doors of a kind may be."""


def doors(path: Path) -> Iterator[tuple[str, int]]:
    """Kind and line of every door in a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    # What `atomic` yields is written by its caller.
    given = {
        name.id
        for node in ast.walk(tree)
        if isinstance(node, ast.With)
        for item in node.items
        if item.optional_vars is not None and ast.unparse(item.context_expr).startswith("atomic")
        for name in ast.walk(item.optional_vars)
        if isinstance(name, ast.Name)
    }
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [f"{alias.name}." for alias in node.names if alias.name != "subprocess"]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Call):
            names = [ast.unparse(node.func)]
            first = node.args[0] if node.args else None
            mode = first.value if isinstance(first, ast.Constant) else None
            if names[0].endswith(".open") and isinstance(mode, str) and MODE.fullmatch(mode):
                names = ["open"]
            if any(word.arg == "shell" for word in node.keywords):
                yield "shell", node.lineno
        for name in names:
            for kind, pattern in DANGEROUS.items():
                if re.fullmatch(pattern, name) and name.split(".")[0] not in given:
                    yield kind, getattr(node, "lineno", 0)
            if isinstance(node, ast.Call) and re.fullmatch(GUARDS, name):
                yield "guarded", node.lineno


@cache
def all_doors() -> list[tuple[str, str, int]]:
    """Kind, file and line of every door of the program."""
    files = [(path, path.relative_to(ROOT).as_posix()) for name in PACKAGES for path in (ROOT / name).rglob("*.py")]
    return sorted((kind, name, line) for path, name in files for kind, line in doors(path))


def test_every_dangerous_door_is_one_that_somebody_thought_of() -> None:
    new = [
        f"{name}:{line}: {kind}"
        for kind, name, line in all_doors()
        if kind != "guarded" and name not in ALLOWED.get(kind, set())
    ]
    assert not new, f"read docs/TRUST.md first, then use what guards this, or put it on the list: {new}"


def test_the_list_allows_nothing_that_is_not_there() -> None:
    found = {(kind, name) for kind, name, _ in all_doors()}
    gone = [f"{name}: {kind}" for kind, names in ALLOWED.items() for name in names if (kind, name) not in found]
    assert not gone, gone


def test_the_document_has_every_file_that_opens_something() -> None:
    text = (ROOT / "docs/TRUST.md").read_text(encoding="utf-8")
    missing = sorted({name for _, name, _ in all_doors() if name not in text})
    assert not missing, f"docs/TRUST.md says nothing of {missing}"


def test_what_opens_a_door_is_found(tmp_path: Path) -> None:
    lines = {
        "from PIL import Image\nImage.open(p)": "picture",
        "import pickle": "pickle",
        "from torch import load": "pickle",
        "np.load(p)": "pickle",
        "from subprocess import run": "process",
        "run(c, shell=True)": "shell",
        "os.system(c)": "process",
        "eval(t)": "code",
        "import socket": "network",
        "open(p, 'w')": "bare file",
        "p.open('rb')": "bare file",
        "p.write_text('x')": "bare file",
        "Kind.from_pretrained(p)": "weights",
    }
    for line, kind in lines.items():
        (tmp_path / "a.py").write_text(line)
        assert [found for found, _ in doors(tmp_path / "a.py")] == [kind], line
    for line in ("window.open('Cut')", "with atomic(p) as t:\n    t.write_text('x')", "files.open(path)"):
        (tmp_path / "a.py").write_text(line)
        assert not [found for found, _ in doors(tmp_path / "a.py") if found != "guarded"], line
