"""How commands end: one line and a status, whatever stops them and wherever their output goes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from app import main
from engine import command
from tests.paths import ROOT

SCENE = ROOT / "sample_scenes/bread"

# Each command, stopped in the middle of a write or of a long computation, where a test can reach it.
BEGIN = """
import os, sys, time
from pathlib import Path
from engine.io.files import atomic
from engine.io.scratch import atomic_folder

def work(path, *_, folder=False, **__):
    with (atomic_folder if folder else atomic)(Path(path)) as temporary:
        working()
        time.sleep(60)

def working():
    print("working", os.getpid(), sep="\\n", flush=True)
"""
COMMANDS = {
    "fruitninja-render": """
import app.render_cli as cli
cli.load_trained = lambda path: work("out/a.png")
sys.argv[1:] = ["a.ply", "-o", "out/a.png"]
""",
    "fruitninja-export": """
import app.export_cli as cli
cli.open_solid = lambda path: work("out/a.glb")
sys.argv[1:] = ["a.ply", "-o", "out/a.ply"]
""",
    "fruitninja-train": """
import training.cli as cli
cli.parse_families = lambda *_, **__: work("out/a.png")
sys.argv[1:] = [SCENE + "/bread.ply", "-o", "out"]
""",
    "fruitninja-train finetune": """
import types
import training, training.cli as cli
training.priors.diffusion = sys.modules["training.priors.diffusion"] = types.SimpleNamespace(
    STEPS=1, finetune=lambda *_, **__: work("out/model", folder=True))
sys.argv[1:] = ["finetune", "--model", "x", "-o", "out/model", "--exemplar", f"parallel={SCENE}/parallel_1.png"]
""",
    "fruitninja-batch": """
import training.batch.cli as cli
from training.batch.grid import Outcome
def run_grid(tasks, told, stop, **_):
    working()
    while not stop():
        time.sleep(0.01)
    return [Outcome(task, "stopped") for task in tasks]
cli.run_grid = run_grid
Path("all.toml").write_text(f'''[[scene]]
scene = "{SCENE}/bread.ply"
exemplar = {{ parallel = "{SCENE}/parallel_1.png" }}
''')
sys.argv[1:] = ["all.toml", "-o", "out"]
""",
    "fruitninja-evaluate": """
import training.evaluate.cli as cli
cli.write_report = lambda *_: work("out/report.html")
cli.run_locally = lambda *_: {}
sys.argv[1:] = ["-o", "out"]
""",
}

# The commands take seconds to load: one process loads them all, and each run is a fork of it.
SERVER = """
import gc, json, os, sys
import app.export_cli, app.render_cli, training.batch.cli, training.cli, training.evaluate.cli

gc.freeze()  # a fork that ends need not look through all that was imported, which takes a second
for line in sys.stdin:
    folder, code = json.loads(line)
    if not (child := os.fork()):
        os.chdir(folder)
        exec(code, {"__name__": "command"})
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.fixture(scope="module")
def server() -> Iterator[subprocess.Popen[str]]:
    """A process that runs code in forks of itself and reports how each fork ended."""
    process = subprocess.Popen(
        [sys.executable, "-c", SERVER], env=os.environ | {"PYTHONPATH": str(ROOT)}, text=True, bufsize=1,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    yield process
    _, said = process.communicate(timeout=60)
    assert not said


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_ends_as_it_was_told_to(name: str, server: subprocess.Popen[str], tmp_path: Path) -> None:
    assert server.stdin is not None and server.stdout is not None and server.stderr is not None
    code = f"{BEGIN}\nSCENE = {str(SCENE)!r}\n{COMMANDS[name]}\ncli.main()\n"
    for number in (signal.SIGINT, signal.SIGTERM):
        server.stdin.write(json.dumps([str(tmp_path), code]) + "\n")
        assert server.stdout.readline() == "working\n", server.communicate()[1]
        at_work = int(server.stdout.readline())
        os.kill(at_work, number)
        ended_by = [server.stdout.readline() for _ in range(1 + (name == "fruitninja-batch"))]  # it names its summary
        assert ended_by[-1] == f"{128 + number}\n"
        assert server.stderr.readline().startswith(f"{name}: stopped")
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert left <= {"all.toml", "out/batch.json"}


def test_an_evaluation_takes_its_worker_with_it(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "training.evaluate.cli", "--scenes", "bread", "--methods", "ours", "-o", str(tmp_path)],
        cwd=ROOT,
        text=True,
        stderr=subprocess.PIPE,
    )
    assert process.stderr is not None
    assert process.stderr.readline() == "bread/ours: begins\n"
    while not (children := psutil.Process(process.pid).children()):
        assert process.poll() is None
    process.terminate()
    _, said = process.communicate(timeout=60)
    assert process.returncode == 143 and said.count("\n") == 1 and "goes on from here" in said, said
    assert not psutil.wait_procs(children, 20)[1]


ENDS = """
from engine.command import print_result, run_command
def command() -> None:
    {}
run_command("fruitninja-test", command, [])
"""


def ended(body: str, **more: Any) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-c", ENDS.format(body)], cwd=ROOT, stderr=subprocess.PIPE, text=True, check=False, **more
    )
    return done.returncode, done.stderr


def test_what_slips_through_is_one_line() -> None:
    assert ended("raise MemoryError") == (
        1, "fruitninja-test: not enough memory; close other programs, or ask for less detail\n"
    )  # fmt: skip
    assert ended("open('nowhere/a')") == (1, "fruitninja-test: nowhere/a: No such file or directory\n")
    assert ended("raise __import__('engine.errors').errors.InputError('a.ply: bad')") == (
        2, "fruitninja-test: a.ply: bad\n"
    )  # fmt: skip


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
def test_output_that_cannot_be_written_is_said() -> None:
    full = "fruitninja-test: standard output: cannot be written (No space left on device)\n"
    with open("/dev/full", "w") as stdout:
        assert ended("print_result('result.ply')", stdout=stdout) == (2, full)
        events = "from training.events import Reporter; Reporter.open('-').emit('first')"
        assert ended(events, stdout=stdout) == (2, full)
    read, write = os.pipe()
    os.close(read)
    assert ended("print_result('result.ply')", stdout=write) == (
        2,
        full.replace("No space left on device", "Broken pipe"),
    )
    os.close(write)


def test_the_window_refuses_with_the_same_status() -> None:
    assert main.REFUSED == command.REFUSED
