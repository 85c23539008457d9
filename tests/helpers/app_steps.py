"""Scripts that drive the real window; tests/app/test_window.py runs each in its own process, with NAME and FOLDER."""

from __future__ import annotations

import ctypes
import math
import os
import random
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import glfw
import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray
from PIL import Image

from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.camera_control import AXIS_VIEWS, project_points
from app.model.document import Document, Training
from app.model.history import History
from app.model.knife import Stroke
from app.model.pieces import PointSample, pieces
from app.model.project import Project, Viewing, Work, load_project, save_project
from app.model.rigid_transform import Motion
from app.model.samples import sample_document
from app.model.settings import Settings
from app.session.session import Session
from app.session.workspace import TOOLS
from app.ui.dialogs.exporter import Options
from app.ui.theme import px
from app.ui.window import Window
from engine.io.splats.ply import read_ply
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from tests.helpers.app_driver import Driver, drive
from tests.helpers.workers.quick_scene_worker import use_quick_worker
from tests.paths import HELPERS

Key = imgui.Key
WARM = 500
"""Actions after which the GPU holds everything it will need."""

SLACK = 4
"""Objects that may still be added later: a buffer for a kind of cut that came late."""

STUB = HELPERS.joinpath("app_stub_trainer.py")


def tiny(folder: Path) -> Document:
    """The synthetic melon, coarse enough to be solid in a moment."""
    os.environ["FRUITNINJA_HOME"] = str(folder / "home")
    document = sample_document("no such sample")
    return replace(document, training=Training(detail="draft", out=folder / "result"))


def opened(folder: Path, script: Callable[[Driver], None], size: tuple[int, int] = (860, 560)) -> None:
    """Runs a script on the tiny melon once it is solid."""
    document = tiny(folder)

    def run(driver: Driver) -> None:
        # Until it is complete: the solid's size sets its gap, and the first solid is a little smaller.
        driver.until(lambda: driver.session.atoms is not None and driver.session.loader is None, 120, "the solid")
        driver.still()
        script(driver)
        assert not driver.session.error, driver.session.error
        assert driver.gl_error() == "GL_NO_ERROR"

    drive(
        Session(settings=Settings(window=size)),
        run,
        lambda session: session.files.open_document(document, Viewing()),
    )


def at_once(
    folder: Path,
    script: Callable[[Driver], None],
    size: tuple[int, int],
    prepare: Callable[[Window], None] = lambda window: None,
    settings: Settings | None = None,
) -> None:
    """Runs a script on the same melon made solid without the trainer's steps; for scripts that ignore its origin."""
    document = tiny(folder)
    scene = Path(document.scene or "")
    capture, _ = read_ply(scene)
    pitch = 0.06
    axis = np.arange(-1, 1, pitch) + pitch / 2
    inside = np.stack(np.meshgrid(axis, axis, axis), 3).reshape(-1, 3)
    inside = inside[np.linalg.norm(inside / (0.85, 0.85, 1.0), axis=1) < 0.97].astype(np.float32)
    plain = np.full((len(inside), 3), 0.8, np.float32)
    surface = SurfaceAtoms(capture.means, capture.scales, capture.quats, capture.sh)
    interior = InteriorAtoms(inside, np.full(len(inside), pitch / 2, np.float32), plain)
    atoms = Atoms(surface, interior, pitch)

    def start(session: Session) -> None:
        session.history = History(Work((document,)))
        session.object = LoadedObject(SceneRequest(scene), capture, atoms, PointSample.of_atoms(atoms))
        session.geometry_version += 1
        session.fit()

    def run(driver: Driver) -> None:
        driver.still()
        script(driver)
        assert not driver.session.error, driver.session.error
        assert driver.gl_error() == "GL_NO_ERROR"

    drive(Session(settings=replace(settings or Settings(), window=size)), run, start, prepare)


def ground(view: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(H, W). Pixels where the viewport shows its own background."""
    return (np.abs(view.astype(int) - view[-40, 60].astype(int)) < 6).all(2)


def steps(driver: Driver, folder: Path) -> None:
    """Cutting, undo, families, training, saving, opening again, exporting, as a user does it."""
    session, window = driver.session, driver.window
    shots = folder / "shots"
    driver.picture(shots / "1_solid.png")
    whole = ground(driver.view())
    middle = (0.5, 0.5)

    # The knife: two pieces, both in the model and in the picture.
    driver.press(Key.k)
    assert session.tool == "knife"
    driver.drag((0.5, 0.13), (0.5, 0.97), hold=lambda: driver.picture(shots / "2_stroke.png"))
    driver.still()
    assert len(session.pieces) == 2 and len(session.document.cuts) == 1, session.message
    halves = ground(driver.view())
    column = halves.shape[1] // 2
    assert not whole[halves.shape[0] // 2, column] and halves[halves.shape[0] // 2, column]
    driver.picture(shots / "3_halves.png")

    # A miss changes nothing and says so; Esc cancels.
    driver.drag((0.03, 0.3), (0.04, 0.8))
    assert len(session.document.cuts) == 1 and "missed" in session.message
    driver.drag((0.2, 0.5), (0.8, 0.5), hold=lambda: driver.press(Key.escape))
    assert len(session.document.cuts) == 1

    # The blade: a closed line punches its shape out of the half under it; a line that turns back is refused.
    driver.press(Key.b)
    around = [(0.38 + 0.05 * math.cos(a), 0.45 + 0.08 * math.sin(a)) for a in np.linspace(0, 6.2, 13)]
    driver.draw(around)
    driver.still()
    assert len(session.pieces) == 3 and session.document.cuts[-1].curved, session.message
    driver.picture(shots / "3_punched.png")
    driver.press(Key.mod_ctrl | Key.z)
    driver.draw([(0.2, 0.4), (0.8, 0.5), (0.3, 0.6)])
    assert len(session.pieces) == 2 and "turned back" in session.message

    # Grab a piece; look around; undo.
    driver.press(Key.m)
    before = session.pieces[0].motion, session.pieces[1].motion
    driver.drag((0.35, 0.5), (0.25, 0.45))
    assert (session.pieces[0].motion, session.pieces[1].motion) != before and len(session.history.entries) == 3
    eye = session.viewing.eye
    driver.drag(middle, (0.6, 0.6), button=1)
    assert session.viewing.eye.azimuth != eye.azimuth and len(session.history.entries) == 3
    driver.press(Key.mod_ctrl | Key.z)
    assert (session.pieces[0].motion, session.pieces[1].motion) == before
    driver.press(Key.mod_ctrl | Key.z)
    assert len(session.pieces) == 1
    driver.press(Key.mod_ctrl | Key.mod_shift | Key.z)
    assert len(session.pieces) == 2

    # A family with a picture dropped on the window; its planes appear in the viewport.
    Image.new("RGB", (64, 64), (200, 40, 40)).save(folder / "cut.png")
    driver.press(Key.v)
    window.dropped.append(folder / "cut.png")
    driver.frames(3)
    family = session.document.family("horizontal")
    assert family is not None and family.exemplars == (folder / "cut.png",)
    window.viewport.show_families = frozenset(["horizontal"])
    driver.press(Key._1)
    driver.still()
    driver.picture(shots / "4_families.png")
    window.viewport.show_families = frozenset()

    # Training: colours change while it runs; it is paused and stopped.
    assert session.atoms is not None
    session.training.program = (
        sys.executable, str(STUB), "--steps", "2000", "--paint", str(len(session.atoms.interior))
    )  # fmt: skip
    driver.press(Key._3)
    driver.still()
    plain = driver.view().astype(int)
    session.training.start()
    driver.until(lambda: session.colour_version > 0, 20, "new colours")
    driver.until(
        lambda: session.training.job is not None and session.training.job.progress.iteration > 5, 20, "a curve"
    )
    window.viewport.go(session.viewing.eye.from_side("top"))
    driver.still()
    session.viewing = replace(session.viewing, mode="interior")
    driver.frames(3)
    red = driver.view().astype(int)
    assert (
        ((red[..., 0] > 150) & (red[..., 1] < 90)).mean() > 0.05 > ((plain[..., 0] > 150) & (plain[..., 1] < 90)).mean()
    )
    driver.picture(shots / "5_training.png")
    job = session.training.job
    assert job is not None
    session.training.toggle_pause()
    driver.until(lambda: job.phase == "paused", 10, "the pause")
    session.training.toggle_pause()
    session.training.stop()
    driver.until(lambda: job.phase == "stopped", 20, "the stop")
    session.viewing = replace(session.viewing, mode="solid")

    # Save, open again, export.
    session.files.save(folder / "melon.fruitninja")
    assert not session.history.changed
    document, viewing = session.document, session.viewing
    session.files.open(folder / "melon.fruitninja")
    driver.until(lambda: session.atoms is not None, 60, "the solid again")
    assert (session.document, session.viewing) == (document, viewing)
    driver.still()
    driver.between_frames(lambda: window.exporter.run(Options("picture", 200, 150), folder / "picture.png"))
    picture = np.asarray(Image.open(folder / "picture.png"))
    assert picture.shape == (150, 200, 4) and picture[0, 0, 3] == 0 and picture[..., 3].max() == 255
    driver.between_frames(lambda: window.exporter.run(Options("pieces"), folder / "pieces.ply"))
    assert len(read_ply(folder / "pieces.ply")[0]) == len(session.atoms)
    driver.between_frames(lambda: window.exporter.run(Options("meshes"), folder / "pieces.glb"))
    driver.until(lambda: (folder / "pieces.glb").exists() and not window.exporter.busy, 60, "the meshes")
    driver.between_frames(lambda: window.exporter.run(Options("section", 120), folder / "face.png"))
    assert (folder / "face.png").stat().st_size > 500
    driver.picture(shots / "6_again.png")

    # Closing asks about unsaved work and can be cancelled.
    session.reassemble()
    driver.between_frames(lambda: glfw.set_window_should_close(window.window, True))
    driver.until(lambda: session.question is not None, 5, "the question")
    assert session.question is not None and "Unsaved" in session.question.title
    driver.picture(shots / "7_question.png")
    driver.press(Key.escape)
    assert session.question is None and not session.closing
    session.undo()

    # An error is shown in words.
    session.files.open(folder / "cut.txt")
    driver.frames(2)
    assert "no such file" in session.error
    driver.picture(shots / "8_error.png")
    session.error = ""


def twice_as_dense(window: Window) -> None:
    """A screen of 192 DPI, with four pixels for one of an ordinary screen."""
    window.params.dpi_aware_params.dpi_window_size_factor = 2.0


def habits(driver: Driver, folder: Path) -> None:
    """On a dense screen: the pointer meets its target; files are dropped and asked for; leaving is asked about."""
    session, window = driver.session, driver.window
    assert px(1) == 2.0
    style = imgui.get_style()
    assert (style.frame_padding.x, style.item_spacing.x, style.indent_spacing) == (18, 16, 32)
    assert style.font_size_base * style.font_scale_main * style.font_scale_dpi > 30  # drawn at size, not upscaled
    driver.press(Key.k)
    driver.drag((0.5, 0.13), (0.5, 0.97), hold=lambda: driver.picture(folder / "shots" / "9_dense_stroke.png"))
    driver.still()
    assert len(session.pieces) == 2, session.message
    view = driver.view()
    assert ground(view)[view.shape[0] // 2, view.shape[1] // 2]  # the gap is where the stroke went
    driver.press(Key.v)
    camera = window.viewport.camera()
    for piece in session.pieces:
        points = piece.motion.apply(session.solid.points[piece.rows])
        ((x, _),) = project_points(camera, points.mean(0)[None])[0]
        driver.context.mouse_move_to_pos(driver.point(float(x) / camera.width, 0.5))
        driver.context.mouse_click(0)
        driver.frames(3)
        assert session.selected == {piece.key}
    driver.picture(folder / "shots" / "9_dense.png")

    # A file dropped on the window, as GLFW reports it: a picture, then a scene, which would lose work.
    Image.new("RGB", (64, 64), (200, 40, 40)).save(folder / "cut.png")
    told: Any = glfw.set_drop_callback(window.window, cast(Any, None))  # the function that GLFW calls, with C types

    def drop(*paths: Path) -> None:
        told(window.window, len(paths), (ctypes.c_char_p * len(paths))(*(str(path).encode() for path in paths)))

    drop(folder / "cut.png")
    driver.frames(3)
    family = session.document.family("horizontal")
    assert family is not None and family.exemplars == (folder / "cut.png",)
    scene = session.document.scene
    drop(folder / "other.splat")
    driver.frames(3)
    assert session.question is not None and "Unsaved" in session.question.title
    driver.press(Key.escape)
    assert session.question is None and session.document.scene == scene and session.loader is None

    # The window's own dialog, where the system has none: opened and cancelled, opened and answered.
    dialogs = window.dialogs
    dialogs.native = False
    driver.press(Key.mod_ctrl | Key.o)
    assert dialogs.prompt is not None
    driver.press(Key.escape)
    assert dialogs.prompt is None and session.document.scene == scene
    Image.new("RGB", (64, 64), (40, 200, 40)).save(folder / "second.png")
    driver.press(Key.mod_ctrl | Key.o)
    assert dialogs.prompt is not None
    driver.frames(2)
    driver.context.key_chars_replace_enter(str(folder / "second.png"))
    driver.frames(2)
    family = session.document.family("horizontal")
    assert dialogs.prompt is None and family is not None and len(family.exemplars) == 2

    # Leaving while a job runs.
    session.history.saved = session.history.state
    session.training.program = (sys.executable, str(STUB), "--steps", "4000")
    session.training.start()
    job = session.training.job
    assert job is not None
    driver.between_frames(lambda: glfw.set_window_should_close(window.window, True))
    driver.until(lambda: session.question is not None, 5, "the question")
    assert session.question is not None and "still running" in session.question.title
    driver.press(Key.escape)
    assert not session.closing and job.phase == "running"
    job.stop()
    driver.until(lambda: not session.training.busy, 20, "the stop")


def soak(driver: Driver, actions: int = 2000) -> None:
    """Any actions in any order: no error, nothing left on the GPU, nothing lost."""
    session, window, chance = driver.session, driver.window, random.Random(7)
    start = session.documents
    held: list[dict[str, int]] = []

    def afresh() -> None:
        """Restores the object as first drawn, with nothing kept from other cuts, and counts GL objects."""
        session.jump(0)
        session.viewing = replace(session.viewing, mode="solid")
        session.geometry_version += 1
        driver.still()
        held.append(gl_objects(driver))

    keys = [
        Key.k, Key.p, Key.m, Key.t, Key.v, Key.f, Key.h, Key._1, Key._2, Key._3, Key._6, Key.o, Key.delete, Key.escape,
    ]  # fmt: skip
    keys += [Key.mod_ctrl | Key.z, Key.mod_ctrl | Key.mod_shift | Key.z, Key.mod_ctrl | Key.a, Key.mod_ctrl | Key.g]

    def place() -> tuple[float, float]:
        return chance.uniform(0.02, 0.98), chance.uniform(0.1, 0.98)

    def stroke() -> None:
        if len(session.document.cuts) < 3:
            (a, b), (c, d) = place(), place()
            w, h = window.viewport.size
            path = chance.choice([(), tuple((x * w, y * h) for x, y in (place(), place(), place(), place()))])
            session.slice(window.viewport.camera(), Stroke((a * w, b * h), (c * w, d * h), chance.random() < 0.3, path))

    def cut() -> None:
        if session.document.cuts:
            one = chance.choice(session.document.cuts)
            what = chance.random()
            if what < 0.4:
                session.change_cut("Move", one.id, lambda c: replace(c, shift=chance.uniform(-1, 1)), merge="slide")
            elif what < 0.7:
                session.change_cut("Toggle", one.id, lambda c: replace(c, on=not c.on))
            else:
                session.remove_cut(one.id)

    def piece() -> None:
        if session.pieces:
            keys_ = frozenset([chance.choice(session.pieces).key])
            session.selected = keys_
            motion = Motion.by([chance.uniform(-0.2, 0.2) for _ in range(3)])
            chance.choice([session.hide, session.delete, lambda: session.place("Move", keys_, motion)])()

    def view_as() -> None:
        session.viewing = replace(session.viewing, mode=chance.choice(["solid", "solid", "interior"]))

    acts: list[Callable[[], object]] = [
        stroke, cut, piece, session.undo, session.undo, session.redo, session.reassemble, session.add_plane,
        lambda: session.select_tool(chance.choice(TOOLS)),
        lambda: session.jump(chance.randrange(len(session.history.entries))),
        view_as,
        lambda: window.viewport.go(session.viewing.eye.from_side(chance.choice(list(AXIS_VIEWS)))),
        lambda: session.change("Gap", replace(session.document, gap=chance.uniform(0, 1)), merge="gap"),
    ]  # fmt: skip
    for index in range(actions):
        if index == WARM:  # by now buffers have grown to the sizes needed
            afresh()
        if index % 100 == 0:
            driver.drag(place(), place(), button=chance.choice([0, 0, 1]))
        elif index % 25 == 0:
            driver.context.key_press(chance.choice(keys))
        else:
            chance.choice(acts)()
        if session.question is not None:
            session.answer(session.question.choices[-1])
        window.export.requested = window.menus.shortcuts_shown = False
        assert not session.error, session.error
        rows = sum(len(p.rows) for p in session.pieces)
        assert rows <= len(session.solid.points)
    # The document goes all the way back, all the way forward, and through a file.
    end = session.documents
    while session.history.undo():
        pass
    assert session.documents == start
    while session.history.redo():
        pass
    session.jump(next(i for i, e in enumerate(session.history.entries) if e.state.documents == end))
    path = Path(os.environ["FRUITNINJA_HOME"]) / "soak.fruitninja"
    save_project(path, Project(session.documents, session.viewing))
    again = load_project(path, outside=True)
    assert again == Project(session.documents, session.viewing)
    assert [p.key for p in pieces(again.documents[0], session.solid)] == [p.key for p in session.pieces]
    afresh()
    before, after = held
    assert all(after[kind] <= before[kind] + SLACK for kind in ("Buffer", "Texture", "Framebuffer")), held
    assert after["Program"] < 100 and after["VertexArray"] < 8 * after["Program"], held  # one for each kind of cut


def gl_objects(driver: Driver) -> dict[str, int]:
    """Number of objects of each kind in this GL context, whoever made them."""
    kinds = ("Buffer", "Texture", "Framebuffer", "VertexArray", "Program", "Shader")

    def look() -> dict[str, int]:
        counts = {}
        for kind in kinds:
            address: Any = glfw.get_proc_address(f"glIs{kind}")
            asks = ctypes.CFUNCTYPE(ctypes.c_ubyte, ctypes.c_uint)(address)
            counts[kind] = sum(bool(asks(name)) for name in range(1, 5000))
        return counts

    return driver.between_frames(look)


def main() -> None:
    """Runs the script named on the command line."""
    name, folder = sys.argv[1], Path(sys.argv[2])
    use_quick_worker()
    if name == "steps":
        opened(folder, lambda driver: steps(driver, folder))
    elif name == "habits":
        at_once(folder, lambda driver: habits(driver, folder), (800, 560), twice_as_dense)
    else:
        at_once(folder, soak, (640, 300))  # the CPU draws most frames: a small view is quick
    print("well")


if __name__ == "__main__":
    main()
