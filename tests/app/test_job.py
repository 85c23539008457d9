"""Training jobs beside the window: started, found again, paused, stopped, and their messages."""

from __future__ import annotations

import gettext
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

from app import translation
from app.jobs.job_events import STAGE_WEIGHTS, Progress, read_line
from app.jobs.live_colours import LiveColours
from app.jobs.results import default_out
from app.jobs.training_job import Job, note_path, request_for, request_path
from app.model.autosave import Autosave
from app.model.document import Document, Training
from app.model.project import Viewing
from app.model.samples import sample_document
from app.session.recovered_jobs import describe_job, dismiss_job, recovered_jobs
from app.session.session import Session
from engine.errors import InputError
from engine.io.trained import load_trained
from engine.scene.atoms import Atoms
from tests.helpers.app_objects import atoms, full
from tests.paths import HELPERS
from tests.training.test_train_command import SMALL_COMMAND
from training.events import STAGES
from training.families import Family
from training.request import read_request

STUB = (sys.executable, str(HELPERS.joinpath("app_stub_trainer.py")))


def follow(job: Job, until: Callable[[Job], bool], seconds: float = 15.0) -> None:
    end = time.monotonic() + seconds
    while not until(job):
        job.poll()
        assert not job.ended or until(job), (job.phase, job.log_tail())
        assert time.monotonic() < end, (job.phase, job.progress, job.log_tail())
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
    assert job.progress.section == [1, 1 / 2, 1 / 3, 1 / 4, 1 / 5] and job.progress.fraction == 1
    assert job.progress.warnings == ["3 rows were dropped"] and job.scene == tmp_path / "melon.ply"


def test_a_job_is_found_again_paused_and_stopped_and_goes_on(tmp_path: Path) -> None:
    job = start(tmp_path, "--steps", "400")
    follow(job, lambda job: job.progress.iteration >= 3)
    found = Job.find(tmp_path)  # as in the next session
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
    found.unpause()
    follow(found, lambda job: job.progress.iteration > held)
    found.pause()
    follow(found, lambda job: job.phase == "paused")
    found.stop()
    assert found.phase == "stopping"  # at once; not "running" again until it has ended
    follow(job, lambda job: job.ended)
    follow(found, lambda job: job.ended)
    assert found.phase == "stopped" and "stopped" in found.log_tail()[-1]
    again = Job.find(tmp_path)
    assert again is not None and again.phase == "stopped"
    again.poll()
    before = again.progress.iteration
    resumed = again.resume((*STUB, "--steps", "400"))
    follow(resumed, lambda job: job.progress.iteration > before)
    assert resumed.child is not None
    resumed.child.kill()
    follow(resumed, lambda job: job.ended)
    assert len(resumed.progress.section) == resumed.progress.iteration
    assert not np.isnan(resumed.progress.section).any()


def test_a_job_that_dies_says_its_last_words_and_resumes(tmp_path: Path) -> None:
    job = start(tmp_path, "--die")
    follow(job, lambda job: job.ended)
    assert job.phase == "failed" and "no memory left" in job.log_tail()[-1]
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


@pytest.mark.slow
def test_a_real_training_speaks_as_the_window_listens(tmp_path: Path) -> None:
    y, x = np.mgrid[:64, :64] - 31.5
    disc = (x**2 + y**2 < 28**2)[..., None]
    picture = np.where(disc, np.random.default_rng(0).integers(150, 250, (64, 64, 1)) * (1, 0.2, 0.2), 255)
    Image.fromarray(picture.astype(np.uint8)).save(tmp_path / "cut.png")
    family = Family("horizontal", 2, (tmp_path / "cut.png",))
    training = Training("draft", iterations=2, out=tmp_path / "result")
    document = replace(sample_document("none"), families=(family,), training=training)
    out = tmp_path / "result"
    job = Job.start(document, (0.0, 0.0, 1.0), out, program=(sys.executable, "-c", SMALL_COMMAND))
    follow(job, lambda job: job.ended, 300)
    while job.poll():
        pass
    assert job.phase == "done", job.log_tail()
    assert len(job.progress.section) == 2 and job.progress.fraction == 1 and job.progress.previews
    assert job.progress.result is not None
    solid, _ = load_trained(job.progress.result)
    window = solid.interior  # what the app would show: the same atoms, so that the colours fit
    again = LiveColours(out).newer(Atoms(solid.surface, replace(window, rgb=np.zeros_like(window.rgb)), solid.pitch))
    assert again is not None and again.interior.rgb.max() > 0.5


def test_the_window_takes_on_what_a_training_has_reached(tmp_path: Path) -> None:
    solid, colours = atoms(), LiveColours(tmp_path)
    (tmp_path / "checkpoint").mkdir()

    def reached(stage: str, facts: dict[str, int], **arrays: np.ndarray) -> None:
        path = tmp_path / "checkpoint" / f"{stage}.safetensors"
        save_file(arrays, path, metadata={"facts": json.dumps(facts)})
        os.utime(path, ns=(len(written), len(written)))
        written.append(stage)

    written: list[str] = []
    assert colours.newer(solid) is None
    red = np.tile(np.array([2, 0, 0], np.float32), (600, 1))
    reached("labels", {}, rgb=red)
    seen = colours.newer(solid)
    assert seen is not None and seen.interior.means is solid.interior.means and (seen.interior.rgb == [1, 0, 0]).all()
    assert colours.newer(solid) is None
    colours.reset()  # the window has rebuilt its atoms
    assert colours.newer(solid) is not None
    # An inside that the trainer made itself, then colours for it.
    means, sigmas = np.array([[0, 0, 0], [1, 2, 3]], np.float32), np.array([0.1, 0.2], np.float32)
    reached("labels", {}, means=means, sigmas=sigmas, rgb=red[:2])
    seen = colours.newer(solid)
    assert seen is not None and len(seen.interior) == 2
    reached("training", {}, rgb=red[:2] / 4, sh=np.zeros((300, 4, 3), np.float32))
    again = colours.newer(seen)
    assert again is not None and again.interior.means is seen.interior.means and again.surface.sh_degree == 1
    assert np.allclose(again.interior.rgb, [0.5, 0, 0])
    reached("training", {}, rgb=red[:5])
    assert colours.newer(seen) is None


def test_half_a_line_is_read_when_it_is_whole(tmp_path: Path) -> None:
    job = Job(Document(tmp_path / "x.ply", training=Training(out=tmp_path)), pid=1 << 30, started=0.0)
    events = tmp_path / "events.jsonl"
    events.write_bytes(b'{"event": "stage", "stage": "train"')
    job.poll()
    assert job.progress.stage == ""
    with events.open("ab") as file:
        file.write(b', "title": "Training"}\nnonsense\n[]\n{"event": 3}\n')
    job.poll()
    assert job.progress.title == "Training" and job.phase == "failed"
    progress = Progress()
    for line in (b"\xff", b"1e999", b'{"event":"progress","stage":"x","part":"y"}', b"[" * 9999):
        read_line(progress, line)
    assert progress.stage_fraction == 0


def test_the_request_is_the_documents(tmp_path: Path) -> None:
    document, up = full(tmp_path).documents[0], (0.0, -1.0, 0.0)
    with pytest.raises(InputError, match="no longer there"):
        request_for(document, up)
    for name in "abc":
        (tmp_path / f"{name}.png").touch()
    request = request_for(document, up)
    assert (request.scene, request.up, request.families) == (document.scene, up, document.families)
    assert (request.model, request.thing) == (tmp_path / "model", "rye bread")
    assert request.isolation == document.isolation != ()
    assert (request.detail, request.prior, request.seed, request.iterations) == ("high", "stable-diffusion", 7, 50)
    # Settings of another prior or kind of family are left out, so that they do not prevent a resume.
    reordered = replace(
        document, families=document.families[::-1], training=replace(document.training, prior="exemplar")
    )
    plain = request_for(reordered, up)
    assert plain.families == request.families and (plain.model, plain.thing) == (None, None)
    assert request_for(replace(document, training=replace(document.training, thing="")), up).thing is None
    with pytest.raises(InputError, match="picture"):
        request_for(replace(document, families=(), training=Training()), up)
    assert default_out(tmp_path / "melon.ply") == tmp_path / "melon-inside"


def test_the_trainer_is_given_the_request_and_a_resume_writes_it_anew(tmp_path: Path) -> None:
    job = start(tmp_path)
    follow(job, lambda job: job.ended)
    path = request_path(tmp_path)
    assert not path.is_relative_to(tmp_path) and read_request(path) == request_for(job.document, (0.0, 0.0, 1.0))
    path.write_text("{}")
    resumed = job.resume(STUB)
    follow(resumed, lambda job: job.ended)
    assert read_request(path) == request_for(job.document, (0.0, 0.0, 1.0))


def test_a_job_that_was_left_running_is_found_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = full(tmp_path)
    for name in ("a.png", "b.png", "c.png", "scenes/melon.ply"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    first = Session(autosave=Autosave(tmp_path))
    monkeypatch.setattr(first.scene, "load", lambda *_, **__: None)
    first.files.open_document(project.documents[0], Viewing())
    first.training.program = (*STUB, "--steps", "2000")
    first.training.start()
    assert first.training.job is not None, first.error
    first.files.close()
    assert first.question is not None and "still running" in first.question.title
    first.answer(first.question.choices[0])
    assert first.closing and first.training.job.phase == "running"

    second = Session(autosave=Autosave(tmp_path))
    monkeypatch.setattr(second.scene, "load", lambda *_, **__: None)
    try:
        (job,) = recovered_jobs(second)
        assert job.phase == "running"
        document = project.documents[0]
        assert job.document == Document(
            document.scene,
            document.up,
            document.isolation,
            families=document.families,
            training=document.training,
            number=document.number,
            name=document.name,
        )
        second.files.open_document(job.document, Viewing())
        assert second.training.job is not None and second.training.busy and "went on" in second.message
        assert recovered_jobs(second) == []  # it is the one being shown
    finally:
        assert first.training.job.child is not None
        first.training.job.child.kill()
    follow(second.training.job, lambda job: job.ended)
    third = Session(autosave=Autosave(tmp_path))
    (job,) = recovered_jobs(third)
    assert job.ended and describe_job(job) == "Training of melon ended early."
    dismiss_job(third, job)
    assert recovered_jobs(Session()) == []


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
        session.scene.load = lambda result=None, document=None, opened=False: None
        session.files.open_document(document, Viewing())
        assert session.training.job is None
        session.training.resume()
        session.training.stop()
        job = Job.start(document, (0.0, 0.0, 1.0), out, program=STUB)
        follow(job, lambda job: job.ended)
        assert other.poll() is None and not mark.exists() and secret.read_text() == "kept"
        other.kill()


def test_a_note_that_names_another_process_is_a_job_that_has_ended(tmp_path: Path, home: Path) -> None:
    job = start(tmp_path)
    follow(job, lambda job: job.ended)
    note = note_path(tmp_path)
    assert note.is_relative_to(home) and note.is_file()
    me = psutil.Process()
    myself = {"pid": me.pid, "started": me.create_time()}
    for change in (myself, {"pid": -1}, {"pid": 10**30}, {"started": "x"}):
        note.write_text(json.dumps({"pid": 1, "started": 0.0, "stopped": False} | change))
        found = Job.find(tmp_path)
        assert found is None or found.ended
    note.with_suffix(".fruitninja").write_text("{}")
    assert Job.find(tmp_path) is None


def test_stages_are_named_in_the_language_of_the_window(monkeypatch: pytest.MonkeyPatch) -> None:
    class Shouted(gettext.NullTranslations):
        def gettext(self, message: str) -> str:
            return message.upper() or "the head of the catalogue"

    monkeypatch.setattr(translation, "_catalogue", Shouted())
    progress = Progress()
    assert progress.title == "STARTING"
    for name, title in STAGES.items():
        read_line(progress, json.dumps({"event": "stage", "stage": name, "title": title}).encode())
        assert progress.title == title.upper() != title
    read_line(progress, b'{"event": "stage", "stage": ""}')
    assert progress.title == ""


def test_the_time_left_is_that_of_what_is_left(tmp_path: Path) -> None:
    """Each stage takes twice its share of a hundred seconds; some tell nothing but that they have begun."""

    def tell(progress: Progress, seconds: float, stage: str, part: float | None = None) -> None:
        event = {"event": "stage"} if part is None else {"event": "progress", "part": part}
        read_line(progress, json.dumps(event | {"seconds": seconds, "stage": stage}).encode())

    progress, gone = Progress(tmp_path), 0.0
    for stage, share in STAGE_WEIGHTS.items():
        tell(progress, gone, stage)
        if gone >= 10:
            assert progress.remaining == pytest.approx(200 - gone)
        if stage in ("labels", "train"):
            tell(progress, gone + 100 * share, stage, 0.5)
            assert progress.remaining == pytest.approx(200 - gone - 100 * share)
        gone += 200 * share
    # The same file goes on with the events of a process that was started anew.
    tell(progress, 4, "measure")
    assert progress.remaining is None
    # What goes on with an earlier run tells nothing until it has come as far, and a pause is no work.
    again = progress.resumed()
    again.fraction = again.begun = 0.5
    tell(again, 3, "labels")
    assert again.remaining is None
    again.paused = 500
    tell(again, 510, "train")
    assert again.remaining == pytest.approx(10 * (1 - again.fraction) / (again.fraction - 0.5))


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
    job.poll()  # does not block
