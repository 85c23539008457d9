"""The wheel: its contents, and that it works away from the checkout, in a folder full of traps."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from engine.io.trained import Meta, save_trained
from tests.helpers.hostile import hostile_folder, marks
from tests.helpers.solids import ball
from tests.paths import ROOT

COMMANDS = (
    "fruitninja",
    "fruitninja-batch",
    "fruitninja-evaluate",
    "fruitninja-export",
    "fruitninja-render",
    "fruitninja-train",
)
PACKAGES = ("app", "engine", "fruitninja", "sample_scenes", "shaders", "training")

OPEN = f"""
COMMANDS = {COMMANDS}
"""
OPEN += """
import time
from importlib.metadata import entry_points
from pathlib import Path
import app, engine
from app.jobs.scene_loader import SceneLoader, SceneRequest
from app.model.samples import sample_document

document = sample_document()
scene = document.scene
assert scene.name == "watermelon.ply" and scene.is_relative_to(Path(engine.__file__).parents[1]), scene
assert [family.kind for family in document.families] == ["horizontal", "radial"]
loader = SceneLoader(SceneRequest(scene))
while loader.scene.capture is None and not loader.ended:
    loader.poll()
    time.sleep(0.02)
assert loader.scene.capture is not None, loader.error
loader.cancel()
for name in COMMANDS:
    assert callable(entry_points(group="console_scripts")[name].load())
print(app.__file__)
"""


EXTRAS = (
    "engine/export/meshes",
    "engine/export/volumes",
    "training/evaluate/charts.py",
    "training/priors/diffusion",
)
"""What says which extra it needs when that is missing."""


def test_what_is_imported_is_a_dependency() -> None:
    """Imports at the top of a module work with the plain installation, without the extras."""
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    plain = {re.split(r"[^\w-]", name, maxsplit=1)[0].lower() for name in needed}
    known = packages_distributions()
    missing = []
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        if any(path.is_relative_to(ROOT / room) for room in EXTRAS):
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            for top in {name.partition(".")[0] for name in names} - set(PACKAGES) - sys.stdlib_module_names:
                if not plain & {name.lower().replace("_", "-") for name in known.get(top, ())}:
                    missing.append(f"{path.relative_to(ROOT)}: {top}")
    assert not missing


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("setuptools", reason="no setuptools here to build a wheel with")
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"  # building leaves files, and picks up those of earlier builds
    for name in PACKAGES:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--wheel-dir", str(folder), str(source)], check=True)
    (path,) = folder.glob("fruitninja-*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_carries_what_runs_and_nothing_else(wheel: Path) -> None:
    carried = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    tracked = subprocess.run(["git", "ls-files", *PACKAGES], cwd=ROOT, capture_output=True, text=True, check=False)
    if tracked.returncode:
        pytest.skip("no checkout by git, so nobody knows what belongs to the project")
    assert carried == set(tracked.stdout.split())
    assert {"sample_scenes/watermelon/watermelon.ply", "shaders/cut.glsl"} <= carried


def give_kernels(packages: Path) -> None:
    """Copies kernels that the checkout compiled from the same sources, with the same file times: compiling all again
    would take twenty seconds and does not test the wheel. The rest is compiled beside the install, as for a user."""
    for compiled in (path for name in PACKAGES for path in (ROOT / name).rglob("__pycache__/*.nb[ic]")):
        source = compiled.parents[1] / (compiled.name.partition(".")[0] + ".py")
        installed = packages / source.relative_to(ROOT)
        if installed.exists() and installed.read_bytes() == source.read_bytes():
            shutil.copystat(source, installed)
            (installed.parent / "__pycache__").mkdir(exist_ok=True)
            shutil.copy(compiled, installed.parent / "__pycache__")


@pytest.mark.slow
def test_the_wheel_works_where_nothing_else_of_the_project_is(wheel: Path, tmp_path: Path) -> None:
    home = tmp_path / "venv"
    venv.create(home, with_pip=False, symlinks=os.name != "nt")
    binaries = home / ("Scripts" if os.name == "nt" else "bin")
    # With PYTHONPATH set, pip would find the checkout and install nothing.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment |= {"FRUITNINJA_HOME": str(tmp_path / "home")}
    pip = [sys.executable, "-m", "pip", "--python", str(binaries / "python"), "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-index", "--no-compile", str(wheel)], env=environment, check=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(home), "platbase": str(home)}))
    # The libraries of this environment. Python searches a folder named this way but reads none of its .pth files, so
    # the checkout's editable install, which is one of them, stays unknown.
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    give_kernels(packages)
    folder = hostile_folder(tmp_path / "downloads")

    def run(*command: str) -> str:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=200)
        assert marks(folder) == []
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    suffix = ".exe" if os.name == "nt" else ""
    assert all((binaries / f"{name}{suffix}").exists() for name in COMMANDS)
    save_trained(folder / "melon.ply", ball(1 / 6, degree=0), Meta())
    size = ("--size", "64x64", "--plane", "0,0,1,0")
    assert "cut.png (64x64" in run(str(binaries / "fruitninja-render"), "melon.ply", "-o", "cut.png", *size)
    (tmp_path / "open.py").write_text(OPEN)
    assert run(str(binaries / "python"), str(tmp_path / "open.py")).startswith(str(packages))
