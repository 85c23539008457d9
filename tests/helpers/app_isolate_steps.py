"""Scripts for the real window: an object is isolated, and two objects are worked on; tests/app/test_window.py runs one
in its own process, with NAME and FOLDER."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from imgui_bundle import imgui

from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.camera_control import OrbitCamera
from app.model.document import Document, Training
from app.model.history import History
from app.model.pieces import PointSample
from app.model.project import Viewing, Work
from app.model.samples import sample_document
from app.model.settings import Settings
from app.session.session import Session
from engine.io.splats.ply import ply_data, read_ply
from engine.isolate.selection import Sphere, keep_only
from engine.scene.atoms import Atoms
from engine.scene.gaussians import Gaussians
from engine.scene.sh import rgb_to_sh
from tests.helpers.app_driver import Driver, drive
from tests.helpers.app_steps import ground
from tests.helpers.solids import ball, joined, unturned
from tests.helpers.workers.quick_scene_worker import use_quick_worker

Key = imgui.Key
MAT = 3000

LEFT, RIGHT, NOTHING = (0.3, 0.5), (0.7, 0.5), (0.5, 0.9)
"""Fractions of the viewport: on the first object, on the second, beside both."""


def melon_on_a_mat(folder: Path) -> Document:
    """The synthetic melon on a blue disc three times as wide, like a capture trained from all sides."""
    os.environ["FRUITNINJA_HOME"] = str(folder / "home")
    scene = sample_document("no such sample").scene
    assert scene is not None
    melon = read_ply(scene)[0][::4]  # the tests' software renderer draws every Gaussian in every frame
    rng = np.random.default_rng(4)
    angle, radius = rng.uniform(0, 2 * np.pi, MAT), 2.4 * np.sqrt(rng.uniform(0, 1, MAT))
    means = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(MAT, melon.means[:, 2].min() - 0.01)], 1)
    sh = np.zeros((MAT, *melon.sh.shape[1:]), np.float32)
    sh[:, 0] = rgb_to_sh(np.array((0.2, 0.3, 0.8), np.float32))
    mat = Gaussians(
        means.astype(np.float32),
        np.tile(np.array((0.055, 0.055, 0.004), np.float32), (MAT, 1)),
        unturned(MAT),
        np.full(MAT, 0.95, np.float32),
        sh,
    )
    both = joined(replace(melon, scales=2 * melon.scales), mat)
    path = folder / "on_mat.ply"
    ply_data(both, []).write(str(path))
    return Document(scene=path, up=(0.0, 0.0, 1.0), training=Training(detail="draft", out=folder / "result"))


def isolate(driver: Driver, folder: Path) -> None:
    """The mat is proposed and removed, undone, and cut away again with each tool; the solid follows."""
    session, shots = driver.session, folder / "shots"
    assert session.object is not None and session.object.capture is not None
    total = len(session.object.capture)

    def settled() -> None:
        driver.until(lambda: session.isolation.view is not None and not session.isolation.pending, 30, "the view")
        driver.still()

    def left() -> int:
        settled()
        assert session.isolation.view is not None
        return len(session.isolation.view.left)

    def selected() -> int:
        settled()
        assert session.isolation.view is not None
        return int(session.isolation.view.selected.sum())

    def solid_again() -> None:
        driver.until(lambda: session.atoms is not None and session.loader is None, 120, "the solid")

    driver.press(Key.i)
    assert session.tool == "isolate" and session.mode == "capture"
    driver.until(lambda: session.isolation.proposals is not None, 30, "proposals")
    driver.click("//Inspector/Floor/Floor")
    assert abs(selected() - MAT) < 0.05 * MAT
    driver.picture(shots / "isolate_1_proposal.png")

    # One click removes the mat; the solid is rebuilt without it; undo brings both back.
    driver.click("//Inspector/Remove")
    assert session.atoms is None
    assert abs(left() - (total - MAT)) < 0.05 * MAT
    solid_again()
    assert session.solid.radius < 1.5
    driver.picture(shots / "isolate_2_removed.png")
    driver.press(Key.mod_ctrl | Key.z)
    assert left() == total and selected() > 0
    driver.press(Key.mod_ctrl | Key.z)
    assert selected() == 0

    # A lasso around the melon, without what a box removes below it; then the selection grows back.
    driver.press(Key._1)
    driver.still()
    session.isolation.marker = "sphere"
    driver.drag((0.5, 0.5), (0.5, 0.3), hold=lambda: driver.picture(shots / "isolate_3_ball.png"))
    ball = selected()
    assert 0 < ball < total
    session.isolation.marker = "lasso"
    driver.context.key_down(Key.mod_shift)
    driver.drag((0.2, 0.2), (0.8, 0.4))  # a straight line encloses nothing
    driver.context.key_up(Key.mod_shift)
    assert selected() == ball
    session.isolation.marker = "box"
    driver.context.key_down(Key.mod_alt)
    driver.drag((0.5, 0.1), (0.95, 0.9))
    driver.context.key_up(Key.mod_alt)
    assert 0 < selected() < ball
    driver.picture(shots / "isolate_4_half.png")
    before = selected()
    driver.drag((0.3, 0.4), (0.3, 0.4))  # a click makes no shape
    assert selected() == before
    driver.click("//Inspector/Invert")
    assert selected() == total - before
    driver.click("//Inspector/Clear")
    assert selected() == 0

    # A face of the box is pulled, as one step of the history.
    driver.drag((0.4, 0.2), (0.6, 0.6))
    settled()
    box, few = session.isolation.last_box, selected()
    assert box is not None
    steps = len(session.history.entries)
    driver.drag((0.6, 0.4), (0.75, 0.4))
    pulled = session.isolation.last_box
    assert pulled is not None and pulled == replace(box, high=(pulled.high[0], *box.high[1:]))
    assert selected() > few and len(session.history.entries) == steps + 1
    driver.press(Key.mod_ctrl | Key.z)
    assert session.isolation.last_box == box and selected() == few

    # Only a box drawn from the side stays; the project stores it as a few numbers.
    driver.drag((0.3, 0.15), (0.7, 0.6))
    kept = selected()
    driver.click("//Inspector/Keep only this")
    assert left() == kept
    session.files.save(folder / "melon.fruitninja")
    assert (folder / "melon.fruitninja").stat().st_size < 10_000
    document = session.document
    session.files.open(folder / "melon.fruitninja")
    driver.until(lambda: session.object is not None and session.object.capture is not None, 60, "the capture again")
    assert session.document == document and left() == kept
    driver.picture(shots / "isolate_5_kept.png")
    driver.press(Key.i)
    driver.click("//Inspector/Bring everything back")
    assert left() == total


def two_balls(session: Session, scene: Path) -> None:
    """Puts two balls into the session as if they had just been opened and made solid."""
    captures, solids = [], []
    for x in (-0.7, 0.7):
        atoms = ball(1 / 12, degree=0)
        shift = np.array((x, 0, 0), np.float32)
        surface = replace(atoms.surface, means=atoms.surface.means + shift)
        solids.append(Atoms(surface, replace(atoms.interior, means=atoms.interior.means + shift), atoms.pitch))
        captures.append(surface)
    arrays = (np.concatenate([getattr(one, name) for one in captures]) for name in ("means", "scales", "quats", "sh"))
    means, scales, quats, sh = arrays
    capture = Gaussians(means, scales, quats, np.ones(len(means), np.float32), sh)
    balls = [keep_only(Sphere((x, 0.0, 0.0), 0.69)) for x in (-0.7, 0.7)]
    session.history = History(
        Work(tuple(Document(scene, isolation=(one,), number=n) for n, one in enumerate(balls, 1)))
    )
    for document, atoms in zip(session.documents, solids, strict=True):
        request = SceneRequest(scene, isolation=document.isolation)
        session.loaded[document.number] = LoadedObject(request, capture, atoms, PointSample.of_atoms(atoms))
        session.scene._isolations[document.number] = document.isolation
    session.geometry_version += 1
    session.viewing = Viewing(OrbitCamera(azimuth=-90.0, elevation=10.0, distance=4.0), "solid")


def several(driver: Driver, folder: Path) -> None:
    """Two objects are selected in the view and in the list, cut alone and together, named, hidden and shown again."""
    session, shots = driver.session, folder / "shots"

    def click(at: tuple[float, float], double: bool = False) -> None:
        driver.context.mouse_move_to_pos(driver.point(*at))
        driver.context.mouse_double_click() if double else driver.context.mouse_click()
        driver.frames(3)

    def cuts() -> list[int]:
        return [len(document.cuts) for document in session.documents]

    assert len(session.members) == 2 and not session.object_selected
    click(RIGHT)
    assert session.active == 1 and session.object_selected
    driver.picture(shots / "1_selected.png")
    driver.press(Key.k)
    driver.drag((0.02, 0.45), (0.98, 0.45), hold=lambda: driver.picture(shots / "2_stroke.png"))
    driver.still()
    assert cuts() == [0, 1], session.message
    driver.press(Key.mod_ctrl | Key.z)
    driver.press(Key.v)
    click(NOTHING)
    assert not session.object_selected and session.active == 1
    driver.press(Key.k)
    driver.drag((0.02, 0.45), (0.98, 0.45))
    driver.still()
    assert cuts() == [1, 1] and len(session.members) == 4 and session.message == "Cut 2 objects."
    driver.picture(shots / "3_both_cut.png")

    # A piece of one object is drawn in the same list as the pieces of the other.
    driver.press(Key.v)
    click((LEFT[0], 0.6))
    (key,) = session.selected
    assert session.active == 0 and key[0][0] == session.documents[0].cuts[0].id

    # The list: an object is named by a double click and hidden by its eye; the picture follows.
    driver.click("//Inspector/$$2/###object")
    assert session.active == 1 and session.object_selected
    driver.context.item_double_click(driver.item("//Inspector/$$2/###object"))
    driver.frames(3)
    driver.context.key_chars_replace_enter("Lemon")
    driver.frames(3)
    assert session.documents[1].title == "Lemon", session.documents[1]
    driver.context.mouse_move_to_pos(driver.point(*NOTHING))  # a row's tooltip would soon lie over the picture
    driver.still()
    before = ground(driver.view())
    driver.press(Key.h)
    driver.still()
    after = ground(driver.view())
    driver.picture(shots / "4_hidden.png")
    half = before.shape[1] // 2
    assert not session.documents[1].visible and after[:, half + 20 :].mean() > before[:, half + 20 :].mean() + 0.1
    assert np.array_equal(after[100:-60, 40 : half - 40], before[100:-60, 40 : half - 40])
    driver.picture(shots / "4_hidden.png")
    driver.press(Key.mod_ctrl | Key.z)
    driver.still()
    assert session.documents[1].visible and np.array_equal(ground(driver.view())[100:-60], before[100:-60])

    # The capture view shows both objects, whichever is selected.
    session.viewing = replace(session.viewing, mode="capture")
    driver.until(lambda: session.isolation.view is not None, 30, "the capture")
    driver.still()
    driver.picture(shots / "5_capture.png")
    assert session.shown_capture is not None and session.object is not None
    assert len(session.shown_capture) == len(session.object.capture)


def main() -> None:
    """Runs one script: `isolate` on the melon once it is solid, or `several` on two balls."""
    name, folder = sys.argv[1], Path(sys.argv[2])
    document = melon_on_a_mat(folder)
    use_quick_worker()

    def run(driver: Driver) -> None:
        driver.until(lambda: driver.session.atoms is not None and driver.session.loader is None, 120, "the solid")
        driver.still()
        (isolate if name == "isolate" else several)(driver, folder)
        assert not driver.session.error, driver.session.error
        assert driver.gl_error() == "GL_NO_ERROR"

    def start(session: Session) -> None:
        if name == "isolate":
            session.files.open_document(document, Viewing(mode="capture"))
        else:
            two_balls(session, folder / "two.ply")

    size = (800, 560) if name == "isolate" else (900, 560)
    drive(Session(settings=Settings(window=size)), run, start)
    print("well")


if __name__ == "__main__":
    main()
