"""Projects, autosaves, settings, jobs and exports, without a window."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from safetensors.numpy import save_file

from app.autosave import Autosave, rescued
from app.camera_control import Eye
from app.colours import Watch
from app.document import WHOLE, Document, Part, Training
from app.export import ffmpeg, piece_gaussians, save_animation, save_pieces, save_still, sweep, turned_sh, turntable
from app.job import Job, command_for, default_out
from app.job_events import Progress, read_line
from app.motion import Motion
from app.pieces import Lying, Solid, pieces
from app.project import Outside, Project, Viewing, load_project, save_project
from app.returning import document_of, forget_job, left_jobs, words_of
from app.samples import sample_document
from app.session import Session
from app.settings import Settings, load_settings, save_settings
from app.ui.dialogs import Dialogs
from engine.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.errors import InputError
from engine.plane import Plane
from engine.ply import read_ply
from engine.sh import colours
from engine.trained import load_trained
from training.families import Family

STUB = (sys.executable, str(Path(__file__).with_name("app_stub_trainer.py")))


def full(folder: Path) -> Project:
    """A project in which nothing has its default."""
    document = Document(scene=folder / "scenes" / "melon.ply", up=(0.0, -1.0, 0.0), gap=0.3, explode=0.1 + 0.2)
    document = document.with_cut((Part(Plane.of((1, 2, 3), 0.1)),))
    document = document.with_cut((Part(Plane.of((-1, 1 / 3, 0), 0.7), ((1, -1),)), Part(Plane.of((0, 1, 0), 0.2))))
    document = document.with_cut((Part(Plane.of((0, 0, 1), 0.0)),), "Plane", "section")
    document = document.changed_cut(2, lambda cut: replace(cut, shift=1e-17, on=False, name="Käse"))
    motion = Motion.about((0.1, 0.2, 0.3), (1, 1, 1), 33.3)
    document = document.placed(((1, 1),), lambda p: replace(p, motion=motion, visible=False, removed=True, name="lid"))
    document = document.with_exemplars("horizontal", (folder / "a.png", folder / "b.png"))
    document = document.with_family(
        Family("parallel", 12, (folder / "c.png",), "rye bread", (0.0, 1.0, 0.0), (), (0.1, 2 / 3))
    )
    document = document.with_family(Family("custom", 1, custom=(Plane.of((3, 1, 2), 0.4),)))
    document = replace(
        document, training=Training("high", "stable-diffusion", 7, 50, folder / "out", folder / "model", "rye bread")
    )
    eye = Eye((0.1, 1e9, -3.0), 12.5, -90.0, 1 / 3, 50.0, True)
    return Project(document, Viewing(eye, "capture", (0.1, 0.2, 0.3)))


def test_a_project_comes_back_as_it_was(tmp_path: Path) -> None:
    project = full(tmp_path)
    save_project(tmp_path / "melon.fruitninja", project)
    assert load_project(tmp_path / "melon.fruitninja") == project
    assert str(tmp_path) not in (tmp_path / "melon.fruitninja").read_text()  # paths are relative
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    (tmp_path / "melon.fruitninja").rename(moved / "melon.fruitninja")
    assert load_project(moved / "melon.fruitninja").document.scene == moved / "scenes" / "melon.ply"


def test_a_project_does_not_reach_out_of_its_folder_unasked(tmp_path: Path) -> None:
    inside, path = tmp_path / "in", tmp_path / "in" / "p.fruitninja"
    inside.mkdir()
    project = Project(Document(scene=tmp_path / "secret.ply"), Viewing())
    save_project(path, project)
    with pytest.raises(Outside, match="secret") as caught:
        load_project(path)
    assert caught.value.paths == (tmp_path / "secret.ply",)
    assert load_project(path, outside=True) == project
    (inside / "link").symlink_to(tmp_path)
    for name in ("/etc/passwd", "../../x.ply", "link/secret.ply", "a/../../b.ply"):
        raw = json.loads(path.read_text()) | {"scene": name}
        path.write_text(json.dumps(raw))
        with pytest.raises(Outside):
            load_project(path)


BREAK: dict[str, Callable[[dict], object]] = {
    "version": lambda r: r.update(fruitninja=2),
    "no version": lambda r: r.pop("fruitninja"),
    "no cuts": lambda r: r.pop("cuts"),
    "cuts are text": lambda r: r.update(cuts="abc"),
    "twice": lambda r: r["cuts"].append(r["cuts"][0]),
    "normal": lambda r: r["cuts"][0]["parts"][0].update(plane=[2, 0, 0, 0]),
    "big": lambda r: r["cuts"][0].update(shift=1e300),
    "bool for a number": lambda r: r.update(gap=True),
    "kind": lambda r: r["cuts"][0].update(kind="os.system"),
    "unknown cut": lambda r: r["pieces"][0].update(key=[[99, 1]]),
    "side": lambda r: r["pieces"][0].update(key=[[1, 2]]),
    "turn": lambda r: r["pieces"][0].update(turn=[0, 0, 0, 0]),
    "family": lambda r: r["families"][0].update(count=0),
    "range": lambda r: r["families"][0].update(range=[0.5, 0.1]),
    "range of one": lambda r: r["families"][0].update(range=[0.5]),
    "family twice": lambda r: r["families"].append(r["families"][0]),
    "picture": lambda r: r["families"][0].update(exemplars=[3]),
    "nul": lambda r: r.update(scene="a\0b"),
    "elevation": lambda r: r["view"].update(elevation=91),
    "distance": lambda r: r["view"].update(distance=0),
    "mode": lambda r: r["view"].update(mode="x-ray"),
    "prior": lambda r: r["training"].update(prior="magic"),
    "seed": lambda r: r["training"].update(seed=-1),
    "view": lambda r: r.update(view=None),
}


@pytest.mark.parametrize("name", BREAK)
def test_a_broken_project_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / "p.fruitninja"
    save_project(path, full(tmp_path))
    raw = json.loads(path.read_text())
    BREAK[name](raw)
    path.write_text(json.dumps(raw))
    with pytest.raises(InputError) as caught:
        load_project(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", '{"fruitninja": NaN}', "[" * 100_000, "\xff", '{"fruitninja": 1}']
)
def test_what_is_no_project_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "p.fruitninja"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match="not a project"):
        load_project(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_project(tmp_path / "none.fruitninja")


def test_unsaved_work_survives_a_crash(tmp_path: Path) -> None:
    project = full(tmp_path)
    autosave = Autosave(tmp_path)
    assert not autosave.keep(project, changed=False, target=None, now=0)
    assert autosave.keep(project, changed=True, target=tmp_path / "p.fruitninja", now=0)
    assert not autosave.keep(replace(project, viewing=Viewing()), changed=True, target=None, now=1)  # not yet due
    assert rescued(tmp_path) == []  # this session is alive
    note = autosave.file.with_suffix(".json")
    note.write_text(json.dumps(json.loads(note.read_text()) | {"started": 1.0}))  # the number belongs to another now
    found = rescued(tmp_path)
    assert len(found) == 1 and found[0].load() == project and found[0].project == tmp_path / "p.fruitninja"
    found[0].discard()
    assert rescued(tmp_path) == [] and not list(tmp_path.iterdir())


def test_settings_survive_and_a_broken_file_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    settings = Settings("light", face_light=False, seen_hint=True).with_recent(tmp_path / "a").with_job(tmp_path / "b")
    save_settings(settings, path)
    assert load_settings(path) == settings
    for text in ("", "[]", '{"theme": 3, "recent": [1], "window": [1, 2, 3], "seen_hint": "x"}'):
        path.write_text(text)
        assert load_settings(path) == Settings()
    many = settings
    for index in range(20):
        many = many.with_recent(tmp_path / str(index % 12))
    assert len(many.recent) == 10 and many.recent[0] == str(tmp_path / "7")


# Jobs


def follow(job: Job, until: Callable[[Job], bool], seconds: float = 15.0) -> None:
    end = time.monotonic() + seconds
    while not until(job):
        job.poll()
        assert not job.ended or until(job), (job.phase, job.last_words())
        assert time.monotonic() < end, (job.phase, job.progress, job.last_words())
        time.sleep(0.01)


def start(out: Path, *words: str) -> Job:
    return Job.start(
        [str(out / "melon.ply"), "-o", str(out), "--events", str(out / "events.jsonl"), *words], out, program=STUB
    )


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
    resumed = again.resume()
    follow(resumed, lambda job: job.progress.iteration > before)
    resumed.kill()
    follow(resumed, lambda job: job.ended)
    assert len(resumed.progress.section) == resumed.progress.iteration
    assert not np.isnan(resumed.progress.section).any()


def test_a_job_that_dies_says_its_last_words_and_resumes(tmp_path: Path) -> None:
    job = start(tmp_path, "--die")
    follow(job, lambda job: job.ended)
    assert job.phase == "failed" and "no memory left" in job.last_words()[-1]
    resumed = job.resume()
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


def test_a_real_training_speaks_as_the_window_listens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))
    y, x = np.mgrid[:64, :64] - 31.5
    disc = (x**2 + y**2 < 28**2)[..., None]
    picture = np.where(disc, np.random.default_rng(0).integers(150, 250, (64, 64, 1)) * (1, 0.2, 0.2), 255)
    Image.fromarray(picture.astype(np.uint8)).save(tmp_path / "cut.png")
    family = Family("horizontal", 2, (tmp_path / "cut.png",))
    training = Training("draft", iterations=2, out=tmp_path / "result")
    document = replace(sample_document("none"), families=(family,), training=training)
    out = tmp_path / "result"
    job = Job.start(command_for(document, (0.0, 0.0, 1.0), out), out)
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
    red = np.tile(np.float32([2, 0, 0]), (600, 1))
    reached("labels", {}, rgb=red)
    seen = watch.newer(solid)
    assert seen is not None and seen.interior.means is solid.interior.means and (seen.interior.rgb == [1, 0, 0]).all()
    assert watch.newer(solid) is None
    watch.forget()  # the window has made its atoms anew
    assert watch.newer(solid) is not None
    # An inside of the trainer's own making, then colours for it.
    means, sigmas = np.float32([[0, 0, 0], [1, 2, 3]]), np.float32([0.1, 0.2])
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
    job = Job(tmp_path, ("train", "x.ply", "-o", str(tmp_path)), pid=1 << 30, started=0.0)
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
    from training.cli import parse_axis, parse_families

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


# Export


def atoms(degree: int = 0) -> Atoms:
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (900, 3)).astype(np.float32)
    quats = rng.normal(size=(300, 4)).astype(np.float32)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = rng.normal(size=(300, (degree + 1) ** 2, 3)).astype(np.float32)
    surface = SurfaceAtoms(points[:300], rng.uniform(0.01, 0.05, (300, 3)).astype(np.float32), quats, sh)
    inside = InteriorAtoms(points[300:], np.full(600, 0.03, np.float32), rng.uniform(0, 1, (600, 3)).astype(np.float32))
    return Atoms(surface, inside, 0.05)


def test_exported_pieces_add_up_to_the_object_and_open_again(tmp_path: Path) -> None:
    solid = atoms()
    document = replace(Document().with_cut((Part(Plane.of((1, 1, 0), 0.1)),)), gap=0.0)
    parts = pieces(document, Solid.of_atoms(solid))
    assert sum(len(piece_gaussians(solid, part)) for part in parts) == len(solid)
    count = save_pieces(tmp_path / "all.ply", solid, parts)
    again, _ = read_ply(tmp_path / "all.ply")
    assert len(again) == count == len(solid) and (again.opacities > 0.99).all()
    with pytest.raises(InputError, match="nothing to save"):
        save_pieces(tmp_path / "none.ply", solid, [])


def test_a_turned_piece_is_seen_as_before_from_the_turned_side() -> None:
    solid = atoms(3)
    motion = Motion.about((0, 0, 0), (1, 2, 3), 77)
    directions = np.random.default_rng(2).normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turned = turned_sh(solid.surface.sh, motion)
    before, after = colours(solid.surface.sh, directions), colours(turned, directions @ motion.rotation.T)
    assert np.abs(before - after).max() < 1e-4
    lying = Lying(WHOLE, "", (), motion, True, np.arange(0))
    exported = piece_gaussians(solid, lying)
    own = Motion(tuple(solid.surface.quats[0].astype(np.float64).tolist())).rotation
    assert np.allclose(Motion(tuple(exported.quats[0].tolist())).rotation, motion.rotation @ own, atol=1e-5)


def test_stills_and_animations_open_again(tmp_path: Path) -> None:
    frames = [np.full((20, 31, 4), (index * 20, 100, 200, 255), np.uint8) for index in range(6)]
    frames[0][:5, :, 3] = 0
    save_still(tmp_path / "a.png", frames[0])
    assert np.array_equal(np.asarray(Image.open(tmp_path / "a.png")), frames[0])
    for name in ("a.webp", "a.gif"):
        assert save_animation(tmp_path / name, iter(frames)) == 6
        with Image.open(tmp_path / name) as image:
            assert image.size == (31, 20) and image.n_frames == 6
    with pytest.raises(InputError, match="ffmpeg" if ffmpeg() is None else "nothing"):
        save_animation(tmp_path / "a.mp4", iter(()))
    for path, call in ((tmp_path / "a.bmp", save_still), (tmp_path / "a.avi", save_animation)):
        with pytest.raises(InputError, match="saved as"):
            call(path, frames[0])
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


STAND_IN = """#!{python}
import sys
from pathlib import Path
words = sys.argv[1:]
if "7x" in words[words.index("-s") + 1] or "6x" in words[words.index("-s") + 1]:
    sys.exit("width not liked")
Path(words[-1]).write_bytes(words[words.index("-s") + 1].encode() + b" " + sys.stdin.buffer.read())
"""


def test_mp4_is_written_by_ffmpeg_and_refused_in_words_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [np.full((21, 31, 4), (index * 20, 100, 200, 255), np.uint8) for index in range(6)]
    if ffmpeg() is not None:
        assert save_animation(tmp_path / "real.mp4", iter(frames)) == 6
        assert (tmp_path / "real.mp4").read_bytes()[4:8] == b"ftyp"
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    with pytest.raises(InputError, match=r"MP4 needs ffmpeg.*choose \.webp or \.gif"):
        save_animation(tmp_path / "a.mp4", iter(frames))
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(STAND_IN.format(python=sys.executable))
    program.chmod(0o755)
    assert save_animation(tmp_path / "a.mp4", iter(frames)) == 6
    said, pixels = (tmp_path / "a.mp4").read_bytes().split(b" ", 1)
    assert said == b"30x20" and len(pixels) == 6 * 30 * 20 * 3 and pixels[-3:] == bytes([100, 100, 200])
    with pytest.raises(InputError, match="width not liked"):
        save_animation(tmp_path / "b.mp4", iter([frame[:, :7] for frame in frames]))

    def stopped() -> Iterator[np.ndarray]:
        yield frames[0]
        raise InputError("cancelled")

    with pytest.raises(InputError, match="cancelled"):
        save_animation(tmp_path / "c.mp4", stopped())
    left = [path.name for path in tmp_path.iterdir() if path.is_file() and path.name != "real.mp4"]
    assert left == ["a.mp4"]  # nothing of the failed ones


def test_dialogs_of_the_system_open_and_are_cancelled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers: list[object] = [[], ["a.spz"], "", "b.png", [], ["c.png", "d.png"]]
    asked: list[tuple[object, ...]] = []

    class Fake:
        def __init__(self, *words: object) -> None:
            asked.append(words)

        def ready(self, _: int) -> bool:
            return True

        def result(self) -> object:
            return answers.pop(0)

    for kind in ("open_file", "save_file", "select_folder"):
        monkeypatch.setattr(f"app.ui.dialogs.pfd.{kind}", Fake)
    dialogs, got = Dialogs(), []
    dialogs.native = True
    for _ in range(2):
        dialogs.open_scene(got.append)
        dialogs.show()
    assert got == [Path("a.spz")] and dialogs.asked is None
    assert all(f"*{suffix}" in str(asked[0][2]) for suffix in (".ply", ".splat", ".spz", ".obj", ".fruitninja"))
    for _ in range(2):
        dialogs.save("Save", tmp_path / "x.png", ["PNG", "*.png"], got.append)
        dialogs.show()
    for _ in range(2):
        dialogs.open_pictures(got.append)
        dialogs.show()
    assert got == [Path("a.spz"), Path("b.png"), (Path("c.png"), Path("d.png"))]


def test_a_job_that_was_left_running_is_found_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path / "home"))
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
        document = document_of(job)
        asked, true = document.training, project.document.training
        assert (document.scene, document.up, asked) == (project.document.scene, project.document.up, true)
        assert [f.kind for f in document.families] == [f.kind for f in project.document.families]
        assert all(
            a.exemplars == b.exemplars for a, b in zip(document.families, project.document.families, strict=True)
        )
        second.show(document, Viewing(), None)
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


def test_a_turntable_closes_and_a_sweep_passes_through_everything() -> None:
    eyes = [camera.position for camera in turntable(Eye(), (0.0, 0.0, 1.0), (32, 32), 8)]
    assert np.allclose(np.mean(eyes, axis=0)[:2], 0, atol=1e-9) and np.ptp([e[2] for e in eyes]) < 1e-9
    solid = Solid.of(np.random.default_rng(0).uniform(-1, 1, (500, 3)))
    kept = [(plane.distance(solid.points) <= 0).mean() for plane in sweep(Plane.of((0, 1, 1), 0), solid, 12)]
    assert max(kept) > 0.97 and min(kept) < 0.03 and max(abs(np.diff([*kept, kept[0]]))) < 0.4
