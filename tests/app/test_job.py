"""Trainings beside the window: started, found again, paused, stopped, and what they say."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from PIL import Image
from safetensors.numpy import save_file

from app.jobs.job_events import Progress, read_line
from app.jobs.live_colours import Watch
from app.jobs.recovered_jobs import forget_job, left_jobs, words_of
from app.jobs.training_job import Job, command_for, default_out
from app.model.autosave import Autosave
from app.model.document import Document, Training
from app.model.project import Viewing
from app.model.samples import sample_document
from app.session.session import Session
from engine.errors import InputError
from engine.io.trained import load_trained
from engine.scene.atoms import Atoms
from tests.helpers.app_objects import atoms, full
from tests.paths import HELPERS
from training.cli import parse_axis, parse_families
from training.families import Family

STUB = (sys.executable, str(HELPERS.joinpath("app_stub_trainer.py")))


def follow(job: Job, until: Callable[[Job], bool], seconds: float = 15.0) -> None:
    end = time.monotonic() + seconds
    while not until(job):
        job.poll()
        assert not job.ended or until(job), (job.phase, job.last_words())
        assert time.monotonic() < end, (job.phase, job.progress, job.last_words())
        time.sleep(0.01)


@pytest.fixture(autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("FRUITNINJA_HOME", str(folder))
    return folder


def start(out: Path, *words: str) -> Job:
    (out / "cut.png").touch()
    document = Document(out / "melon.ply", families=(Family("horizontal", 2, (out / "cut.png",)),))
    return Job.start(document, (0.0, 0.0, 1.0), out, program=(*STUB, *words))


def test_a_job_runs_to_its_end(tmp_path: Path) -> None:
    job = start(tmp_path)
    follow(job, lambda job: job.ended)
    job.poll()
    assert job.phase == "done" and job.progress.result == tmp_path / "melon.ply"
    assert job.progress.section == [1, 1 / 2, 1 / 3, 1 / 4, 1 / 5] and job.progress.whole == 1
    assert job.progress.warnings == ["3 rows were dropped"] and job.scene == tmp_path / "melon.ply"


def test_a_job_is_found_again_paused_and_stopped_and_goes_on(tmp_path: Path) -> None:
    job = start(tmp_path, "--steps", "400")
    follow(job, lambda job: job.progress.iteration >= 3)
    found = Job.find(tmp_path)  # as the next session does
    assert found is not None and found.phase == "running"
    with pytest.raises(InputError, match="already works"):
        start(tmp_path)
    follow(found, lambda job: job.progress.iteration >= 3)
    found.pause()
    follow(found, lambda job: job.phase == "paused")
    while found.poll():
        pass
    held = found.progress.iteration
    time.sleep(0.2)
    found.poll()
    assert found.progress.iteration == held
    found.go_on()
    follow(found, lambda job: job.progress.iteration > held)
    found.stop()
    follow(job, lambda job: job.ended)
    follow(found, lambda job: job.ended)
    assert found.phase == "stopped" and "stopped" in found.last_words()[-1]
    again = Job.find(tmp_path)
    assert again is not None and again.phase == "stopped"
    again.poll()
    before = again.progress.iteration
    resumed = again.resume((*STUB, "--steps", "400"))
    follow(resumed, lambda job: job.progress.iteration > before)
    resumed.kill()
    follow(resumed, lambda job: job.ended)
    assert len(resumed.progress.section) == resumed.progress.iteration
    assert not np.isnan(resumed.progress.section).any()


def test_a_job_that_dies_says_its_last_words_and_resumes(tmp_path: Path) -> None:
    job = start(tmp_path, "--die")
    follow(job, lambda job: job.ended)
    assert job.phase == "failed" and "no memory left" in job.last_words()[-1]
    resumed = job.resume(STUB)
    follow(resumed, lambda job: job.ended)
    resumed.poll()
    assert resumed.phase == "done" and resumed.progress.section[2] == 1 / 3


def test_a_killed_job_is_a_failed_one(tmp_path: Path) -> None:
    job = start(tmp_path, "--steps", "400")
    follow(job, lambda job: job.progress.iteration >= 2)
    assert job.child is not None
    job.child.kill()
    follow(job, lambda job: job.ended)
    assert job.phase == "failed"


def test_a_real_training_speaks_as_the_window_listens(tmp_path: Path) -> None:
    y, x = np.mgrid[:64, :64] - 31.5
    disc = (x**2 + y**2 < 28**2)[..., None]
    picture = np.where(disc, np.random.default_rng(0).integers(150, 250, (64, 64, 1)) * (1, 0.2, 0.2), 255)
    Image.fromarray(picture.astype(np.uint8)).save(tmp_path / "cut.png")
    family = Family("horizontal", 2, (tmp_path / "cut.png",))
    training = Training("draft", iterations=2, out=tmp_path / "result")
    document = replace(sample_document("none"), families=(family,), training=training)
    out = tmp_path / "result"
    job = Job.start(document, (0.0, 0.0, 1.0), out)
    follow(job, lambda job: job.ended, 300)
    while job.poll():
        pass
    assert job.phase == "done", job.last_words()
    assert len(job.progress.section) == 2 and job.progress.whole == 1 and job.progress.previews
    assert job.progress.result is not None
    solid, _ = load_trained(job.progress.result)
    window = solid.interior  # what the app would be showing: the same atoms, so that colours fit
    again = Watch(out).newer(Atoms(solid.surface, replace(window, rgb=np.zeros_like(window.rgb)), solid.pitch))
    assert again is not None and again.interior.rgb.max() > 0.5


def test_the_window_takes_on_what_a_training_has_reached(tmp_path: Path) -> None:
    solid, watch = atoms(), Watch(tmp_path)
    (tmp_path / "checkpoint").mkdir()

    def reached(stage: str, facts: dict[str, int], **arrays: np.ndarray) -> None:
        path = tmp_path / "checkpoint" / f"{stage}.safetensors"
        save_file(arrays, path, metadata={"facts": json.dumps(facts)})
        os.utime(path, ns=(len(written), len(written)))
        written.append(stage)

    written: list[str] = []
    assert watch.newer(solid) is None
    red = np.tile(np.array([2, 0, 0], np.float32), (600, 1))
    reached("labels", {}, rgb=red)
    seen = watch.newer(solid)
    assert seen is not None and seen.interior.means is solid.interior.means and (seen.interior.rgb == [1, 0, 0]).all()
    assert watch.newer(solid) is None
    watch.forget()  # the window has made its atoms anew
    assert watch.newer(solid) is not None
    # An inside of the trainer's own making, then colours for it.
    means, sigmas = np.array([[0, 0, 0], [1, 2, 3]], np.float32), np.array([0.1, 0.2], np.float32)
    reached("labels", {"exposed": 1}, means=means, sigmas=sigmas, rgb=red[:2])
    seen = watch.newer(solid)
    assert seen is not None and len(seen.interior) == 2 and seen.interior.exposed == 1
    reached("training", {}, rgb=red[:2] / 4, sh=np.zeros((300, 4, 3), np.float32))
    again = watch.newer(seen)
    assert again is not None and again.interior.means is seen.interior.means and again.surface.sh_degree == 1
    assert np.allclose(again.interior.rgb, [0.5, 0, 0])
    reached("training", {}, rgb=red[:5])
    assert watch.newer(seen) is None


def test_half_a_line_is_read_when_it_is_whole(tmp_path: Path) -> None:
    job = Job(Document(tmp_path / "x.ply", training=Training(out=tmp_path)), pid=1 << 30, started=0.0)
    events = tmp_path / "events.jsonl"
    events.write_bytes(b'{"event": "stage", "stage": "train"')
    job.poll()
    assert job.progress.stage == ""
    with events.open("ab") as file:
        file.write(b', "title": "Training"}\nnonsense\n[]\n{"event": 3}\n')
    job.poll()
    assert job.progress.title == "Training" and job.progress.lines == 4 and job.phase == "failed"
    progress = Progress()
    for line in (b"\xff", b"1e999", b'{"event":"progress","stage":"x","part":"y"}', b"[" * 9999):
        read_line(progress, line)
    assert progress.part == 0


def test_the_command_is_the_documents(tmp_path: Path) -> None:
    project = full(tmp_path)
    with pytest.raises(InputError, match="no longer there"):
        command_for(project.document, (0.0, -1.0, 0.0), tmp_path)
    for name in "abc":
        (tmp_path / f"{name}.png").touch()
    words = command_for(project.document, (0.0, -1.0, 0.0), tmp_path / "out")

    def given(option: str) -> list[str]:
        return [words[i + 1] for i, word in enumerate(words) if word == option]

    families = parse_families(given("--exemplar"), given("--family"), given("--prompt"))
    assert {f.kind: (f.count, f.exemplars, f.prompt, f.span) for f in families} == {
        f.kind: (f.count, f.exemplars, f.prompt, f.span) for f in project.document.families
    }
    assert np.allclose(families[-1].custom[0].normal, project.document.families[-1].custom[0].normal)
    assert parse_axis(given("--up")[0], "--up") == (0.0, -1.0, 0.0)
    assert given("--model") == [str(tmp_path / "model")] and given("--object") == ["rye bread"]
    assert given("--iterations") == ["50"] and given("--seed") == ["7"] and given("--detail") == ["high"]
    with pytest.raises(InputError, match="picture"):
        command_for(replace(project.document, families=(), training=Training()), (0.0, 0.0, 1.0), tmp_path)
    assert default_out(tmp_path / "melon.ply") == tmp_path / "melon-inside"


def test_a_job_that_was_left_running_is_found_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = full(tmp_path)
    for name in ("a.png", "b.png", "c.png", "scenes/melon.ply"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    first = Session(autosave=Autosave(tmp_path))
    monkeypatch.setattr(first, "prepare", lambda trained=True: None)
    first.show(project.document, Viewing(), None)
    first.desk.program = (*STUB, "--steps", "2000")
    first.desk.start()
    assert first.desk.job is not None, first.error
    first.files.close()
    assert first.question is not None and "still running" in first.question.title
    first.answer(first.question.choices[0])
    assert first.closing and first.desk.job.phase == "running"

    second = Session(autosave=Autosave(tmp_path))
    monkeypatch.setattr(second, "prepare", lambda trained=True: None)
    try:
        (job,) = left_jobs(second)
        assert job.phase == "running"
        asked = project.document
        assert job.document == Document(asked.scene, asked.up, families=asked.families, training=asked.training)
        second.show(job.document, Viewing(), None)
        assert second.desk.job is not None and second.desk.busy and "went on" in second.message
        assert left_jobs(second) == []  # it is the one that is shown
    finally:
        first.desk.job.kill()
    follow(second.desk.job, lambda job: job.ended)
    third = Session(autosave=Autosave(tmp_path))
    (job,) = left_jobs(third)
    assert job.ended and words_of(job) == "Training of melon ended early."
    forget_job(third, job)
    assert left_jobs(Session()) == []


def test_what_lies_in_a_result_folder_starts_and_ends_no_process(tmp_path: Path) -> None:
    document = Document(tmp_path / "melon.ply", families=(Family("horizontal", 2, (tmp_path / "cut.png",)),))
    (tmp_path / "cut.png").touch()
    out = default_out(tmp_path / "melon.ply")
    out.mkdir()
    mark, secret = tmp_path / "mark", tmp_path / "secret"
    secret.write_text("kept")
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as other:
        started = psutil.Process(other.pid).create_time()
        run = [sys.executable, "-c", f"open({str(mark)!r}, 'w')", str(document.scene), "-o", str(out)]
        note = {"pid": other.pid, "started": started, "stopped": False, "command": run}
        (out / "job.json").write_text(json.dumps(note))
        for name in ("events.jsonl", "job.log"):
            (out / name).symlink_to(secret)
        assert Job.find(out) is None
        session = Session(autosave=Autosave(tmp_path))
        session.prepare = lambda trained=True: None
        session.show(document, Viewing(), None)
        assert session.desk.job is None
        session.desk.resume()
        session.desk.stop()
        job = Job.start(document, (0.0, 0.0, 1.0), out, program=STUB)
        follow(job, lambda job: job.ended)
        assert other.poll() is None and not mark.exists() and secret.read_text() == "kept"
        other.kill()


def test_a_note_that_names_another_process_is_a_job_that_has_ended(tmp_path: Path, home: Path) -> None:
    job = start(tmp_path)
    follow(job, lambda job: job.ended)
    (note,) = (home / "jobs").glob("*.json")
    me = psutil.Process()
    myself = {"pid": me.pid, "started": me.create_time()}
    for change in (myself, {"pid": -1}, {"pid": 10**30}, {"started": "x"}):
        note.write_text(json.dumps({"pid": 1, "started": 0.0, "stopped": False} | change))
        found = Job.find(tmp_path)
        assert found is None or found.ended
    note.with_suffix(".fruitninja").write_text("{}")
    assert Job.find(tmp_path) is None


def test_events_name_no_file_elsewhere_and_say_plain_words(tmp_path: Path) -> None:
    progress = Progress(tmp_path)
    for event in (
        {"event": "previews", "paths": ["/etc/passwd", "../x.png", 3, str(tmp_path / "a.png")]},
        {"event": "done", "scene": "/etc/passwd"},
        {"event": "warning", "message": "a\x1b[2Jb"},
    ):
        read_line(progress, json.dumps(event).encode())
    assert progress.previews == (tmp_path / "a.png",) and progress.result is None
    assert progress.warnings == ["a?[2Jb"]
    os.mkfifo(tmp_path / "events.jsonl")
    job = Job(Document(tmp_path / "x.ply", training=Training(out=tmp_path)), pid=1 << 30, started=0.0)
    job.poll()  # does not wait
