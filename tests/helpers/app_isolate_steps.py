"""A script that isolates an object in the real window; tests/app/test_window.py runs it in a process, with FOLDER."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from imgui_bundle import imgui

from app.model.document import Document, Training
from app.model.project import Viewing
from app.model.samples import sample_document
from app.model.settings import Settings
from app.session.session import Session
from engine.io.splats.ply import ply_data, read_ply
from engine.scene.gaussians import Gaussians
from engine.scene.sh import rgb_to_sh
from tests.helpers.app_driver import Driver, drive
from tests.quick_scene_worker import use_quick_worker

Key = imgui.Key
MAT = 6000


def melon_on_a_mat(folder: Path) -> Document:
    """The generated melon on a blue disc three times as wide, as a capture that was trained from all sides."""
    os.environ["FRUITNINJA_HOME"] = str(folder / "home")
    scene = sample_document("no such sample").scene
    assert scene is not None
    melon, _ = read_ply(scene)
    rng = np.random.default_rng(4)
    angle, radius = rng.uniform(0, 2 * np.pi, MAT), 2.4 * np.sqrt(rng.uniform(0, 1, MAT))
    means = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(MAT, melon.means[:, 2].min() - 0.01)], 1)
    sh = np.zeros((MAT, *melon.sh.shape[1:]), np.float32)
    sh[:, 0] = rgb_to_sh(np.array((0.2, 0.3, 0.8), np.float32))
    mat = Gaussians(
        means.astype(np.float32),
        np.tile(np.array((0.04, 0.04, 0.004), np.float32), (MAT, 1)),
        np.tile(np.array((1, 0, 0, 0), np.float32), (MAT, 1)),
        np.full(MAT, 0.95, np.float32),
        sh,
    )
    both = Gaussians(
        np.concatenate([melon.means, mat.means]),
        np.concatenate([melon.scales, mat.scales]),
        np.concatenate([melon.quats, mat.quats]),
        np.concatenate([melon.opacities, mat.opacities]),
        np.concatenate([melon.sh, mat.sh]),
    )
    path = folder / "on_mat.ply"
    ply_data(both, []).write(str(path))
    return Document(scene=path, up=(0.0, 0.0, 1.0), training=Training(detail="draft", out=folder / "result"))


def isolate(driver: Driver, folder: Path) -> None:
    """The mat is proposed and removed, undone, and cut away again with each tool; the solid follows."""
    session, shots = driver.session, folder / "shots"
    total = len(session.object.capture)  # type: ignore[union-attr,arg-type]

    def settled() -> None:
        driver.until(lambda: session.isolation.view is not None and not session.isolation.pending, 30, "the view")
        driver.still()

    def left() -> int:
        settled()
        assert session.isolation.view is not None
        return len(session.isolation.view.left)

    def marked() -> int:
        settled()
        assert session.isolation.view is not None
        return int(session.isolation.view.marked.sum())

    def solid_again() -> None:
        driver.until(lambda: session.atoms is not None and session.loader is None, 120, "the solid")

    driver.press(Key.i)
    assert session.tool == "isolate" and session.mode == "capture"
    driver.until(lambda: session.isolation.proposals is not None, 30, "proposals")
    driver.click("//Inspector/Floor/Floor")
    assert abs(marked() - MAT) < 0.05 * MAT
    driver.picture(shots / "isolate_1_proposal.png")

    # One click removes it; the solid is made anew without it; undo brings both back.
    driver.click("//Inspector/Remove")
    assert session.atoms is None
    assert abs(left() - (total - MAT)) < 0.05 * MAT
    solid_again()
    assert session.solid.radius < 1.5
    driver.picture(shots / "isolate_2_removed.png")
    driver.press(Key.mod_ctrl | Key.z)
    assert left() == total and marked() > 0
    driver.press(Key.mod_ctrl | Key.z)
    assert marked() == 0

    # A lasso around the melon, without what a box takes away from it below; then it grows back.
    driver.press(Key._1)
    driver.still()
    session.isolation.marker = "sphere"
    driver.drag((0.5, 0.5), (0.5, 0.3), hold=lambda: driver.picture(shots / "isolate_3_ball.png"))
    ball = marked()
    assert 0 < ball < total
    session.isolation.marker = "lasso"
    driver.context.key_down(Key.mod_shift)
    driver.drag((0.2, 0.2), (0.8, 0.4))  # a line encloses nothing
    driver.context.key_up(Key.mod_shift)
    assert marked() == ball
    session.isolation.marker = "box"
    driver.context.key_down(Key.mod_alt)
    driver.drag((0.5, 0.1), (0.95, 0.9))
    driver.context.key_up(Key.mod_alt)
    assert 0 < marked() < ball
    driver.picture(shots / "isolate_4_half.png")
    before = marked()
    driver.drag((0.3, 0.4), (0.3, 0.4))  # a click is no shape
    assert marked() == before
    driver.click("//Inspector/Invert")
    assert marked() == total - before
    driver.click("//Inspector/Clear")
    assert marked() == 0

    # The face of a box is pulled, as one step of the history.
    driver.drag((0.4, 0.2), (0.6, 0.6))
    settled()
    box, few = session.isolation.last_box, marked()
    assert box is not None
    steps = len(session.history.entries)
    driver.drag((0.6, 0.4), (0.75, 0.4))
    assert session.isolation.last_box == replace(box, high=(session.isolation.last_box.high[0], *box.high[1:]))  # type: ignore[union-attr]
    assert marked() > few and len(session.history.entries) == steps + 1
    driver.press(Key.mod_ctrl | Key.z)
    assert session.isolation.last_box == box and marked() == few

    # Only a box from the side stays; the project remembers it as a few numbers.
    driver.drag((0.3, 0.15), (0.7, 0.6))
    kept = marked()
    driver.click("//Inspector/Keep only this")
    assert left() == kept
    session.files.save(folder / "melon.fruitninja")
    assert (folder / "melon.fruitninja").stat().st_size < 10_000
    document = session.document
    session.files.open(folder / "melon.fruitninja")
    driver.until(lambda: session.object is not None and session.object.capture is not None, 60, "the capture again")
    assert session.document == document and left() == kept
    solid_again()
    driver.picture(shots / "isolate_5_kept.png")
    driver.press(Key.i)
    driver.click("//Inspector/Bring everything back")
    assert left() == total


def main() -> None:
    """Runs it on the melon, once that is solid."""
    folder = Path(sys.argv[2])
    document = melon_on_a_mat(folder)
    use_quick_worker()

    def run(driver: Driver) -> None:
        driver.until(lambda: driver.session.atoms is not None and driver.session.loader is None, 120, "the solid")
        driver.still()
        isolate(driver, folder)
        assert not driver.session.error, driver.session.error
        assert driver.window.ctx.error == "GL_NO_ERROR"

    session = Session(settings=Settings(window=(1000, 680)))
    drive(session, run, lambda session: session.files.open_document(document, Viewing(mode="capture"), None))
    print("well")


if __name__ == "__main__":
    main()
