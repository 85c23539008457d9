"""Many scenes: the same bits as single runs, whatever dies on the way, and nothing done twice."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil
import pytest

from engine.errors import InputError
from tests.helpers.workers.batch_worker import SMALL
from tests.helpers.workers.plain_functions import double, fail, fail_at_first, wait_until_stopped
from tests.paths import HELPERS, SAMPLES, SLICE
from training.batch import Outcome, Task, run_grid, should_stop
from training.batch.cli import main
from training.batch.cluster import cluster_client, deferred_signals
from training.batch.manifest import read_manifest
from training.batch.scene import is_intact
from training.checkpoint import Checkpoint
from training.events import Reporter
from training.pipeline import run

SCENES = SAMPLES
WORKER = HELPERS.joinpath("workers", "batch_worker.py")

MANIFEST = f"""
[defaults]
detail = "draft"
up = "z"
family = ["parallel:4"]
exemplar = {{ parallel = ["{SLICE}"] }}

[[scene]]
name = "killed"
scene = "{SCENES}/orange/orange.ply"
detail = "standard"
iterations = 30

[[scene]]
scene = "broken.ply"

[[scene]]
scene = "{SCENES}/bread/bread.ply"
seed = 3
"""


def command(manifest: Path, out: Path, *more: str, preload: tuple[Path, ...] = (WORKER,)) -> subprocess.Popen[str]:
    environment = os.environ | {"DASK_DISTRIBUTED__WORKER__PRELOAD": json.dumps([str(path) for path in preload])}
    arguments = ["-m", "training.batch.cli", str(manifest), "-o", str(out), *more]
    return subprocess.Popen(
        [sys.executable, *arguments],
        env=environment,
        cwd=SCENES.parent,
        text=True,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # its workers share its process group, as in a terminal
    )


def wait_for(process: subprocess.Popen[str], events: Path, text: str) -> str:
    while process.poll() is None:
        if events.exists() and text in (found := events.read_text()):
            return found
        time.sleep(0.05)
    raise AssertionError(f"no {text} in {events}: {process.communicate()[1]}")


def outcomes(out: Path) -> dict[str, tuple[str, int]]:
    scenes = json.loads((out / "batch.json").read_text())["scenes"]
    return {scene["name"]: (scene["status"], scene["attempts"]) for scene in scenes}


@pytest.mark.slow
def test_a_killed_worker_a_stop_and_a_broken_scene_cost_no_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    manifest, out = tmp_path / "all.toml", tmp_path / "out"
    manifest.write_text(MANIFEST)
    (tmp_path / "broken.ply").write_bytes(b"ply\nnothing")

    process = command(manifest, out, "--workers", "2")
    try:
        message = wait_for(process, out / "killed/events.jsonl", '"iteration": 3')
        os.kill(json.loads(message.splitlines()[0])["pid"], signal.SIGKILL)
        wait_for(process, out / "killed/events.jsonl", '"iteration": 6')
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)  # Ctrl-C
    message = process.communicate()[1]
    assert "the same command goes on" in message
    assert "Traceback" not in message
    assert process.returncode == 130
    assert outcomes(out)["killed"] == ("stopped", 2)

    process = command(manifest, out, "--workers", "1")
    message = process.communicate()[1]
    assert process.returncode == 1
    assert f"fruitninja-batch: broken: {tmp_path / 'broken.ply'}: broken .ply header" in message
    assert "Traceback" not in message
    assert outcomes(out)["broken"] == ("failed", 2)
    assert {outcomes(out)[name][0] for name in ("killed", "bread")} <= {"done", "kept"}

    for name, value in SMALL.items():
        monkeypatch.setattr(name, value)
    single = tmp_path / "single"
    for scene in read_manifest(manifest):
        if scene.name != "broken":
            run(scene.request, single / scene.name, Reporter(), False, lambda: False)
    for file in ("killed/orange.ply", "killed/cuts.png", "bread/bread.ply", "bread/cuts.png"):
        assert (out / file).read_bytes() == (single / file).read_bytes(), file
    iterations = [json.loads(line).get("iteration") for line in (out / "killed/events.jsonl").open()]
    assert iterations.count(1) == 1, "it began anew instead of at its checkpoint"
    assert not list(out.glob("*/checkpoint/*.safetensors"))

    manifest.write_text(MANIFEST.replace('[[scene]]\nscene = "broken.ply"', ""))
    when = (out / "killed/orange.ply").stat().st_mtime_ns
    monkeypatch.setattr(sys, "argv", ["fruitninja-batch", str(manifest), "-o", str(out)])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 0
    assert outcomes(out) == {"killed": ("kept", 0), "bread": ("kept", 0)}
    assert (out / "killed/orange.ply").stat().st_mtime_ns == when


@pytest.mark.slow
def test_a_disk_that_was_full_costs_no_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    manifest, out = tmp_path / "all.toml", tmp_path / "out"
    scene = f'[[scene]]\nscene = "{SCENES}/orange/orange.ply"\niterations = 2\n'
    manifest.write_text(MANIFEST.partition("[[scene]]")[0] + scene)
    message = command(manifest, out, preload=(WORKER, WORKER.with_name("full_disk_worker.py"))).communicate()[1]
    lines = message.splitlines()
    assert len(lines) == 2 and "Traceback" not in message
    file = out / "orange/checkpoint/training.safetensors"
    assert lines[0].startswith(f"orange: {file}: cannot be written (I/O error: No space left")
    assert outcomes(out) == {"orange": ("done", 2)}
    for name, value in SMALL.items():
        monkeypatch.setattr(name, value)
    run(read_manifest(manifest)[0].request, tmp_path / "single", Reporter(), False, lambda: False)
    assert (out / "orange/orange.ply").read_bytes() == (tmp_path / "single/orange.ply").read_bytes()
    assert not list(out.rglob(".*")), "something temporary was left"


def test_what_a_killed_writer_left_breaks_no_checkpoint(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path, "run")
    checkpoint.save("training", {"rgb": np.zeros((2, 3), np.float32)}, {})
    (tmp_path / ".training.abcd1234.safetensors").write_bytes(b"half of")
    assert is_intact(checkpoint)
    (tmp_path / "labels.safetensors").write_bytes(b"half of")
    assert not is_intact(checkpoint)


# Any grid of plain functions, through the address of a running cluster.


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler and a worker started by somebody else, each in its own process."""
    folder = tmp_path_factory.mktemp("cluster")
    on_change = folder / "scheduler.json"
    scheduler = ["dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    worker = ["dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(WORKER.parent), str(SCENES.parent)])}
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{first}", *more, "--scheduler-file", str(on_change)],
            env=environment,
            cwd=folder,
            stderr=subprocess.DEVNULL,
        )
        for first, *more in (scheduler, worker)
    ]
    try:
        until = time.monotonic() + 60
        while not (on_change.exists() and on_change.read_text().endswith("}")):
            assert time.monotonic() < until and processes[0].poll() is None
            time.sleep(0.05)
        yield json.loads(on_change.read_text())["address"]
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(20)


def test_a_grid_of_plain_functions(tmp_path: Path, address: str) -> None:
    def task(name: str, function, **arguments) -> Task:
        return Task(name, function, arguments, tmp_path / f"{name}.json", name)

    tasks = [
        task("double", double, value=4),
        task("again", fail_at_first, mark=tmp_path / "mark"),
        task("fail", fail),
        task("last", double, value=5),
    ]
    lines: list[dict[str, object]] = []
    outcomes = run_grid(tasks, lambda _, line: lines.append(line), lambda: False, scheduler=address)
    assert [(o.status, o.attempts) for o in outcomes] == [("done", 1), ("done", 2), ("failed", 2), ("done", 1)]
    assert outcomes[0].facts == {"twice": 8}
    assert outcomes[2].error.startswith("ZeroDivisionError: always so (plain_functions.py:")
    assert json.loads((tmp_path / "double.json").read_text())["facts"] == {"twice": 8}
    assert not (tmp_path / "fail.json").exists()
    # A second run does only what is not done: another fingerprint or a broken file counts as not done.
    (tmp_path / "last.json").write_text("{")
    tasks[0] = Task("double", double, {"value": 6}, tmp_path / "double.json", "other")
    outcomes = run_grid(tasks, lambda *_: None, lambda: False, scheduler=address)
    assert [o.status for o in outcomes] == ["done", "kept", "failed", "done"]
    assert outcomes[0].facts == {"twice": 12}
    # What other settings wrote over is done again, even if they did not come to their end.
    tasks[0] = Task("double", fail, {}, tmp_path / "double.json", "broken")
    assert run_grid(tasks[:1], lambda *_: None, lambda: False, scheduler=address)[0].status == "failed"
    assert not (tmp_path / "double.json").exists()
    assert should_stop() is False


def test_a_grid_stops_when_asked(tmp_path: Path, address: str) -> None:
    tasks = [Task(name, wait_until_stopped, {}, tmp_path / name, name) for name in ("running", "waiting")]
    running = []

    def on_change(outcome: Outcome, _: object) -> None:
        running.append(outcome.status == "running")

    outcomes = run_grid(tasks, on_change, lambda: any(running), scheduler=address)
    assert [(o.status, o.attempts) for o in outcomes] == [("stopped", 1), ("stopped", 0)]


def test_nobody_at_the_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("training.batch.cluster.WAIT_SECONDS", 0.2)
    task = Task("a", double, {"value": 1}, tmp_path / "a.json", "a")
    for wrong in ("tcp://127.0.0.1:1", "nonsense://x", "tcp://127.0.0.1:99999999"):
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            run_grid([task], lambda *_: None, lambda: False, scheduler=wrong)


def listening() -> set[tuple[str, int]]:
    """Addresses where this process and its children listen."""
    here = psutil.Process()
    found = [c for p in (here, *here.children(recursive=True)) for c in p.net_connections("inet")]
    return {tuple(c.laddr) for c in found if c.status == psutil.CONN_LISTEN}


def test_a_cluster_of_its_own_listens_to_this_machine_alone() -> None:
    """One port each for the scheduler, two workers and their two guards; no web pages, no word of a taken port."""
    with socket.socket() as dask, suppress(OSError):  # if it fails, somebody else has the port
        dask.bind(("127.0.0.1", 8787))
    before = listening()
    with cluster_client(None, 2, 2, 0.1) as client:
        client.submit(double, 1).result()
        ports = listening() - before
    assert {host for host, _ in ports} == {"127.0.0.1"}
    assert len(ports) == 5


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals to threads here")
def test_a_signal_waits_for_the_end_of_the_block_whichever_thread_takes_it() -> None:
    told: list[str] = []
    done = threading.Event()
    bystander = threading.Thread(target=done.wait)
    bystander.start()
    before = signal.signal(signal.SIGUSR1, lambda *_: told.append("signal"))
    try:
        for thread in (bystander, threading.main_thread()):
            with deferred_signals(signal.SIGUSR1):
                assert thread.ident is not None
                signal.pthread_kill(thread.ident, signal.SIGUSR1)
                time.sleep(0.1)
                told.append("block")
    finally:
        signal.signal(signal.SIGUSR1, before)
        done.set()
    assert told == ["block", "signal"] * 2
