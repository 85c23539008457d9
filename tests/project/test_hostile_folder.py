"""The commands and the window in a folder full of traps: everything works, and nothing in the folder is run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.hostile import hostile_folder, marks
from tests.paths import HELPERS, ROOT, SLICE
from tests.training.test_train_command import ARGUMENTS, SCENE, SMALL_COMMAND

WINDOW = """
import os, sys, time
from pathlib import Path

sys.argv = ["fruitninja", "../melon.ply"]
home = Path(os.environ["FRUITNINJA_HOME"])
import app.main as program
from tests.helpers.workers.quick_scene_worker import use_quick_worker

use_quick_worker()

def run(window):
    from app.model.document import Document
    from app.jobs.training_job import Job
    from engine.isolate.selection import Sphere, keep_only
    from training.families import Family

    session = window.session
    window.start(session)
    while session.loader is not None:
        session.tick()
        time.sleep(0.02)
    assert not session.error, session.error
    assert session.atoms is not None
    assert session.document.scene.samefile(home / "melon.ply") and session.folder == home / "downloads"

    (home / "cut.png").write_bytes(b"no picture")
    nothing = (keep_only(Sphere((9.0, 9.0, 9.0), 1.0)),)  # what a whole training imports, the test of the commands does
    document = Document(home / "melon.ply", isolation=nothing, families=(Family("horizontal", 2, (home / "cut.png",)),))
    job = Job.start(document, (0.0, 0.0, 1.0), home / "out")
    while not job.ended:
        job.poll()
        time.sleep(0.02)
    assert "fruitninja-train: " in job.log_tail()[-1] and "nothing is left" in job.log_tail()[-1], job.log_tail()
    print("well")

def can_show():
    import app.ui.window
    app.ui.window.Window.run = run
    return True

program.can_show = can_show
program.main()
"""


def run(folder: Path, tmp_path: Path, code: str, *arguments: str) -> str:
    """Runs a command as its console script would: with the script's folder, not the current one, on the import path."""
    script = tmp_path / "bin" / "command.py"
    script.parent.mkdir(exist_ok=True)
    script.write_text(code)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    environment |= {"PYTHONPATH": str(ROOT), "FRUITNINJA_HOME": str(tmp_path), "HOME": str(tmp_path)}
    environment |= {"DASK_DISTRIBUTED__WORKER__PRELOAD": json.dumps([str(HELPERS / "workers/batch_worker.py")])}
    command = [sys.executable, str(script), *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert marks(folder) == []
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return hostile_folder(tmp_path / "downloads")


def test_the_traps_work(folder: Path) -> None:
    subprocess.run([sys.executable, "-c", "import numba"], cwd=folder, check=False, capture_output=True)
    assert marks(folder)


@pytest.mark.slow
def test_the_window_opens_and_trains(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "melon.ply").write_bytes((SCENE / "watermelon.ply").read_bytes())
    assert "well" in run(folder, tmp_path, WINDOW)


@pytest.mark.slow
def test_the_commands_train_and_draw(folder: Path, tmp_path: Path) -> None:
    run(folder, tmp_path, SMALL_COMMAND, *ARGUMENTS, "-o", "out", "--iterations", "1")
    drawn = "from app.render_cli import main\nmain()\n"
    run(folder, tmp_path, drawn, "out/watermelon.ply", "-o", "cut.png", "--plane", "0,0,1,0", "--size", "64x64")
    assert (folder / "cut.png").is_file()


@pytest.mark.slow
def test_a_batch_on_this_machine(folder: Path, tmp_path: Path) -> None:
    (folder / "all.toml").write_text(
        f"""
        [[scene]]
        scene = "{SCENE}/watermelon.ply"
        detail = "draft"
        up = "z"
        family = ["parallel:2"]
        exemplar = {{ parallel = "{SLICE}" }}
        """
    )
    code = "from training.batch.cli import main\nif __name__ == '__main__':\n    main()\n"
    run(folder, tmp_path, code, "all.toml", "-o", "results", "--workers", "1")
    assert (folder / "results/watermelon/watermelon.ply").is_file()
