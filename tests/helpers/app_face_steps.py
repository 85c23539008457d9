"""A script for the real window: the face in a picture is looked at and corrected; tests/app/test_window.py runs it in a
process, with its name and FOLDER."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.face_edit import Outline
from tests.helpers.app_driver import Driver
from tests.helpers.app_steps import at_once
from tests.paths import SAMPLES, SHARED
from training.faces.polygon import polygon_mask

PHOTOGRAPH = SHARED / "photos" / "fruit" / "apple_v1.png"
"""An apple halved; one of our own pictures where it is not at hand."""


def faces(driver: Driver, folder: Path) -> None:
    """A picture is added, looked at, its outline and axis are dragged, painted, undone and kept."""
    session, window = driver.session, driver.window
    editor, shots = window.face_editor, folder / "shots"
    path = folder / "half.png"
    shutil.copy(PHOTOGRAPH if PHOTOGRAPH.is_file() else SAMPLES / "orange" / "radial_1.png", path)
    session.add_pictures("radial", (path,))
    window.interior.open = "radial"
    driver.until(lambda: session.faces.hint is not None, 30, "what was found")
    hint = session.faces.hint
    assert hint is not None and "looks like a cut along the core" in hint.text, hint
    driver.picture(shots / "faces_1_hint.png")
    driver.click("//Object/Look at it")
    face = session.faces.open_face
    assert face is not None and session.faces.hint is None

    def settled() -> bool:
        return face.placed is not None and face.placed.rgba is not None and not session.faces.busy

    def preview() -> NDArray[np.int64]:
        driver.until(settled, 30, "the placement")
        driver.until(lambda: not window.painter.unfinished, 30)
        low, size = editor.placement.low, editor.placement.size
        picture = driver.picture().astype(int)
        return picture[int(low.y) : int(low.y + size.y), int(low.x) : int(low.x + size.x)]

    def drag(start: tuple[float, float], by: tuple[float, float]) -> None:
        at = editor.to_screen(start)
        driver.context.mouse_move_to_pos(at)
        driver.context.mouse_down(0)
        for part in (0.5, 1.0):
            driver.context.mouse_move_to_pos(ImVec2(at.x + part * by[0], at.y + part * by[1]))
            driver.frames(2)
        driver.context.mouse_up(0)
        driver.frames(3)

    first = preview()
    driver.picture(shots / "faces_2_found.png")
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 500  # a photograph, not a plain face
    # A point of the outline.
    outline = face.marks.outline
    assert outline is not None and face.found is not None
    right = max(range(len(outline)), key=lambda index: outline[index][0])
    drag(outline[right], (-60.0, 0.0))
    moved = face.given.outline
    assert moved is not None and max(x for x, _ in moved) < outline[right][0] - 0.005
    assert overlap(moved, outline) < 0.99
    second = preview()
    assert np.abs(second - first).mean() > 0.2
    # An end of the axis.
    line = face.marks.line
    assert line is not None
    drag(line[0], (70.0, 10.0))
    assert face.given.line is not None and face.given.line[0][0] > line[0][0] + 0.05
    third = preview()
    assert np.abs(third - second).mean() > 1.5
    driver.picture(shots / "faces_3_dragged.png")
    # The brush.
    driver.click("//Object/Take away##face tool")
    drag((0.5, 0.02), (0.0, 40.0))
    assert face.given.outline is not None and min(y for _, y in face.given.outline) > min(y for _, y in moved)
    driver.picture(shots / "faces_4_brush.png")
    # Undo, one step for each drag; the picture's kind; what is kept.
    for _ in range(2):
        driver.press(imgui.Key.mod_ctrl | imgui.Key.z)
    assert face.given.outline == moved and session.history.entries[session.history.cursor].name == "Outline"
    driver.click("//Object/Slice##kind")
    assert face.family is not None and face.family.kind == "parallel"
    driver.press(imgui.Key.mod_ctrl | imgui.Key.z)
    driver.press(imgui.Key.escape)
    assert session.faces.open_face is None
    family = session.document.family("radial")
    assert family is not None and family.marks_of(path).outline == moved
    driver.still()
    driver.picture(shots / "faces_5_closed.png")


def overlap(a: Outline, b: Outline) -> float:
    """Intersection over union of what two outlines enclose."""
    one, other = (polygon_mask(outline, 300, 300) for outline in (a, b))
    return float((one & other).sum() / (one | other).sum())


def main() -> None:
    """Runs it."""
    folder = Path(sys.argv[2])
    at_once(folder, lambda driver: faces(driver, folder), (1180, 700))
    print("well")


if __name__ == "__main__":
    main()
