"""Takes the README's six pictures, and one of the view's options, from the real window: `make screenshots`.

Runs the app under a virtual X server where there is no display, opens the watermelon, shows its families, trains it,
cuts it, and saves what the window shows into docs/pictures/. A finished training result in out/screenshots is
reused.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from imgui_bundle import icons_fontawesome_6 as icon
from imgui_bundle import imgui

from app.model.document import Part, Training
from app.model.project import Viewing
from app.model.rigid_transform import Motion
from app.model.samples import sample_document
from app.model.settings import Settings
from app.session.session import Session
from engine.scene.plane import Plane
from tests.helpers.app_driver import Driver, drive
from training.settings import DetailName

ROOT = Path(__file__).resolve().parents[1]
Key = imgui.Key
PICTURES = ROOT / "docs" / "pictures"
OUT = ROOT / "out" / "screenshots"
SIZE = (1440, 900)


def main() -> None:
    """Restarts itself under xvfb-run if it has to, then takes the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--detail", default="standard", choices=("draft", "standard", "high"))
    parser.add_argument("--fresh", action="store_true", help="train again even if there is a result")
    parser.add_argument("--only", default="1234567", help="numbers of the pictures to take: 145")
    parser.add_argument("--theme", default="dark", choices=("dark", "light"))
    options = parser.parse_args()
    if not os.environ.get("DISPLAY") and sys.platform.startswith("linux"):
        server = shutil.which("xvfb-run")
        if server is None:
            sys.exit("screenshots: no display; install xvfb")
        screen = f"-screen 0 {SIZE[0] + 160}x{SIZE[1] + 100}x24"
        os.execv(server, [server, "-a", "-s", screen, sys.executable, "-m", "tools.screenshots", *sys.argv[1:]])
    os.environ["FRUITNINJA_HOME"] = str(OUT / "home")
    shutil.rmtree(OUT / "home", ignore_errors=True)
    if options.fresh:
        shutil.rmtree(OUT / options.detail, ignore_errors=True)
    take(options.detail, options.theme, options.only)


def take(detail: DetailName, theme: Literal["dark", "light"], only: str) -> None:
    """Opens the window and goes through the scenes."""
    document = sample_document("watermelon")
    document = replace(document, training=Training(detail=detail, out=OUT / detail))
    result = OUT / detail / "watermelon.ply"
    kept = result.with_suffix(".kept")
    if result.exists():  # hide it, so that the first pictures show the hollow capture
        result.rename(kept)

    def script(driver: Driver) -> None:
        session, window = driver.session, driver.window
        view = window.viewport

        def shot(name: str) -> None:
            if name[0] in only:
                driver.context.mouse_move_to_pos(driver.point(0.97, 0.97))
                hold(name)

        def hold(name: str) -> None:
            """Takes a picture without moving the pointer."""
            driver.still()
            if name[0] in only and name[0] != "2":  # frame time is measured on frames in motion: move a little
                eye = session.viewing.eye
                for step in range(16):
                    session.viewing = replace(session.viewing, eye=replace(eye, azimuth=eye.azimuth + 0.2 * (step % 4)))
                    driver.frames(1)
                session.viewing = replace(session.viewing, eye=eye)
                driver.still()
            if name[0] in only:
                driver.picture(PICTURES / f"{name}.png")
                print(f"{name}.png", flush=True)

        # The hollow input.
        driver.until(lambda: session.atoms is not None and session.loader is None, 600, "the solid")
        view.fit()
        shot("1_capture")

        # The families, with their planes on the object.
        session.viewing = replace(session.viewing, mode="solid", eye=replace(session.viewing.eye, elevation=26.0))
        view.show_families = frozenset(["horizontal", "radial"])
        window.interior.open = "horizontal"
        shot("5_families")
        view.show_families, window.interior.open = frozenset(), None

        # The view's options, with the body as wires.
        session.change_settings(replace(session.settings, wires=True))
        driver.click(f"//Object/{icon.ICON_FA_SLIDERS}##options")
        driver.frames(3)
        shot("7_options")
        driver.press(Key.escape)
        session.change_settings(replace(session.settings, wires=False))

        # A picture, before anything is trained.
        radial = session.document.family("radial")
        if "6" in only and radial is not None:
            window.interior.open = "radial"
            session.faces.edit("radial", radial.exemplars[0])
            face = session.faces.open_face
            driver.until(lambda: face is not None and face.placed is not None and not session.faces.busy, 60, "a face")
            shot("6_picture")
            session.faces.close()
            window.interior.open = None

        if not set(only) & set("234"):
            return

        # Training, seen through an opened object.
        if kept.exists():
            kept.rename(result)
            session.scene.load(session.training.result_for(session.document))
            driver.until(lambda: session.object is not None and session.object.trained, 120, "the result")
        else:
            session.add_plane()
            cut = session.document.cuts[0]
            tilt(session, cut.id)
            session.training.start()
            driver.until(lambda: busy_training(session), 3600, "training with pictures")
            session.active_cut = None  # its numbers would push the training's pictures out of the panel
            shot("4_training")
            driver.until(lambda: session.object is not None and session.object.trained, 3600, "the end of training")
            session.remove_cut(cut.id)

        # The knife cuts.
        session.viewing = replace(session.viewing, mode="solid")
        view.fit()
        driver.still()
        driver.press(Key.k)
        driver.drag((0.30, 0.20), (0.72, 0.82), hold=lambda: hold("2_knife"))

        # The halves are laid open.
        driver.still()
        assert len(session.pieces) == 2, session.message
        driver.press(Key.v)
        lay_open(session)
        view.fit()
        eye = session.viewing.eye  # the halves together are wide, not tall: the sphere around them leaves much room
        session.viewing = replace(session.viewing, eye=replace(eye, distance=0.8 * eye.distance))
        shot("3_halves")

    drive(
        Session(settings=Settings(theme=theme, window=SIZE, seen_hint=True)),
        script,
        lambda session: session.files.open_document(document, Viewing(mode="capture")),
    )


def busy_training(session: Session) -> bool:
    """Whether the training has something to show: label pictures, colours."""
    job = session.training.job
    assert job is not None and job.phase in ("running", "done"), session.error
    return bool(job.progress.previews) and session.colour_version > 0


def tilt(session: Session, cut_id: int) -> None:
    """Slants a section plane towards the eye, so that its face fills the view."""
    camera = session.viewing.eye.camera(640, 480, session.up)
    plane = Plane.through(session.solid.centre, -0.75 * camera.forward + 0.55 * np.asarray(session.up))
    session.change_cut("Tilt", cut_id, lambda cut: replace(cut, parts=(Part(plane),), shift=0.0))


def lay_open(session: Session) -> None:
    """Turns both halves so that their faces look at the eye, side by side."""
    camera = session.viewing.eye.camera(640, 480, session.up)
    right, down = camera.viewmat[0, :3], camera.viewmat[1, :3]
    radius = session.solid.radius
    for piece, side in zip(session.pieces, (-1.0, 1.0), strict=True):
        normal = piece.motion.rotation @ np.asarray(piece.cells[0].faces[-1].normal)  # out of the face
        towards = -camera.forward + 0.25 * side * -right - 0.18 * down
        towards /= np.linalg.norm(towards)
        axis = np.cross(normal, towards)
        angle = float(np.degrees(np.arctan2(np.linalg.norm(axis), normal @ towards)))
        middle = piece.motion.apply(session.solid.points[piece.rows]).mean(0)
        turn = Motion.about(middle, axis, angle)
        place = session.solid.centre + side * radius * right - middle
        session.place("Lay open", frozenset([piece.key]), Motion.by(place).after(turn))


if __name__ == "__main__":
    main()
