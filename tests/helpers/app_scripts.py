"""Scripts for the real window: the object is stood on a face and turned; the face in a picture is corrected;
tests/app/test_window.py runs one in its own process, with NAME and FOLDER."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.camera_control import project_points
from app.model.faces.edit import Outline
from app.ui.view.gizmo import on_handles
from tests.helpers.app_driver import Driver
from tests.helpers.app_steps import at_once
from tests.paths import SAMPLES, SHARED
from training.faces.polygon import polygon_mask

Key = imgui.Key

PHOTOGRAPH = SHARED / "photos" / "fruit" / "apple_v1.png"
"""A halved apple; one of our own pictures where that file is missing."""


def upright(driver: Driver, folder: Path) -> None:
    """The melon is stood on a clicked face, turned by the rings, by the menu and by numbers; all of it is undone."""
    session, view = driver.session, driver.window.viewport

    def normal_at(x: float, y: float) -> NDArray[np.float64]:
        """The outward normal of the ellipsoid x^2/a^2 + y^2/a^2 + z^2 = 1 where the pointer meets it."""
        at = (x * view.size[0], y * view.size[1])
        _, point = driver.between_frames(lambda: driver.window.painter.pick(*at))
        assert point is not None
        normal = point / (0.85**2, 0.85**2, 1.0)
        return np.asarray(normal / np.linalg.norm(normal))

    def click(x: float, y: float, button: int = 0) -> None:
        driver.context.mouse_move_to_pos(driver.point(x, y))
        driver.context.mouse_click(button)
        driver.frames(3)

    driver.press(Key.u)
    assert session.tool == "upright"
    driver.still()
    driver.picture(folder / "shots" / "upright_1_rings.png")
    down = normal_at(0.6, 0.54)
    click(0.6, 0.54)
    assert np.dot(session.up, -down) > np.cos(np.radians(6)), (session.up, down)
    driver.still()
    driver.picture(folder / "shots" / "upright_2_stands.png")

    # In the capture, which has no depth buffer to read; a miss says so.
    driver.press(Key.mod_ctrl | Key.z)
    assert session.document.up is None
    driver.still()
    session.viewing = replace(session.viewing, mode="capture")
    driver.still()
    click(0.6, 0.54)
    assert np.dot(session.up, -down) > np.cos(np.radians(8)), (session.up, down)
    click(0.02, 0.9)
    assert "Click on the object" in session.message
    session.viewing = replace(session.viewing, mode="solid")

    # From the context menu, with any tool active.
    driver.press(Key.v)
    driver.still()
    before, down = session.up, normal_at(0.45, 0.6)
    click(0.45, 0.6, button=1)
    driver.click("//$FOCUSED/Stand on this face")
    driver.frames(3)
    assert session.up != before and np.dot(session.up, -down) > np.cos(np.radians(6))

    # The outermost ring turns the object in the picture plane; a drag is one step.
    session.jump(0)
    driver.press(Key.u)
    driver.still()
    forward = view.camera().forward
    drag_ring(driver, session.solid.centre)
    assert session.history.cursor == 1 and session.document.up is not None
    assert session.up[2] < np.cos(np.radians(10))
    driver.picture(folder / "shots" / "upright_3_turned.png")
    # Half way round the melon's top: the same side is still in front, turned about the line of sight.
    assert view.camera().forward @ forward > 0.99
    driver.press(Key.mod_ctrl | Key.z)
    assert session.document.up is None

    # Three numbers.
    driver.click("//Inspector/##up")
    driver.frames(2)
    driver.context.item_input("//$FOCUSED/##up numbers/$$0")
    for value in "30":
        driver.context.key_chars_replace(value)
        driver.press(Key.tab)
    driver.context.key_chars_replace("4")
    driver.picture(folder / "shots" / "upright_4_numbers.png")
    driver.press(Key.enter)
    driver.frames(2)
    assert np.dot(session.up, (0.6, 0.0, 0.8)) > 1 - 1e-6, session.up
    session.jump(0)

    # The handles of a piece, on the same ring.
    driver.press(Key.k)
    driver.drag((0.5, 0.13), (0.5, 0.97))
    driver.press(Key.t)
    piece = session.pieces[0]
    session.selected = frozenset([piece.key])
    driver.still()
    drag_ring(driver, piece.motion.apply(session.solid.points[piece.rows]).mean(0))
    assert session.pieces[0].motion != piece.motion and session.history.entries[-1].name == "Turn"
    session.jump(0)
    driver.press(Key.v)
    plane_through_three_points(driver)
    slices_of_one_thickness(driver, folder)
    slices_beside_it(driver, folder)


def slices_of_one_thickness(driver: Driver, folder: Path) -> None:
    """Slices the object from its window, which Esc closes; a single undo step."""
    session, window = driver.session, driver.window
    for count in (0, 6):
        window.menus.slices.open()
        driver.frames(3)
        window.menus.slices.count = count
        driver.picture(folder / "shots" / "upright_5_slices.png")
        if count:
            driver.click("//$FOCUSED/Slice")
        else:
            driver.press(Key.escape)
        driver.frames(3)
        assert not imgui.is_popup_open("", imgui.PopupFlags_.any_popup)
        assert len(session.pieces) == max(count, 1), session.message
    assert session.history.entries[-1].name == "Slice evenly"
    driver.still()
    driver.picture(folder / "shots" / "upright_6_sliced.png")
    session.undo()
    assert len(session.pieces) == 1


def plane_through_three_points(driver: Driver) -> None:
    """Adds a plane, clicks three points for it to pass through, and removes it; a menu that Esc closes."""
    session, window = driver.session, driver.window
    session.add_plane()
    driver.still()
    cut, view_ = session.document.cuts[-1], window.viewport
    driver.click(f"//Inspector/$${cut.id}/Three points")
    picked = []
    for at in ((0.3, 0.7), (0.7, 0.65), (0.4, 0.85)):
        driver.context.mouse_move_to_pos(driver.point(*at))
        pixel = at[0] * view_.size[0], at[1] * view_.size[1]
        member, place = driver.between_frames(partial(view_._pick, pixel))
        assert member is not None and place is not None
        picked.append(member.piece.motion.inverse().apply(place))
        driver.context.mouse_click(0)
        driver.frames(3)
    plane = session.document.cut(cut.id).parts[0].plane
    assert np.abs(plane.distance(np.stack(picked))).max() < 1e-5 and plane.distance(session.solid.centre) <= 0
    driver.context.mouse_click(1)
    driver.frames(3)
    assert imgui.is_popup_open("", imgui.PopupFlags_.any_popup)
    driver.press(Key.escape)
    assert not imgui.is_popup_open("", imgui.PopupFlags_.any_popup)
    session.remove_cut(cut.id)


def slices_beside_it(driver: Driver, folder: Path) -> None:
    """Three slices beside the object: a click moves the other two planes, the wheel the slice's own; a distance."""
    session, slices = driver.session, driver.window.slices
    driver.press(Key.s)
    driver.until(lambda: all(face and not face.coarse for face in slices.reader.faces), 60, "the faces")

    def at(index: int, x: float, y: float) -> ImVec2:
        origin, size = slices.boxes[index]
        return ImVec2(origin.x + x * size[0], origin.y + y * size[1])

    def click(index: int, x: float, y: float) -> None:
        driver.context.mouse_move_to_pos(at(index, x, y))
        driver.context.mouse_click(0)
        driver.frames(3)

    click(1, 0.6, 0.4)  # front view: right and up
    before = slices.slices()
    assert before.cross[0] > 0.1 and before.cross[2] > 0.1 and abs(before.cross[1] - session.solid.centre[1]) < 1e-9
    driver.context.mouse_wheel_y(2)
    driver.frames(2)
    assert np.isclose(slices.slices().cross[1], before.cross[1] - 0.02 * before.radius)
    driver.press(Key.d)
    click(0, 0.4, 0.5)
    click(0, 0.6, 0.5)
    length = slices.measured.length if slices.measured is not None else None
    assert length is not None
    assert np.isclose(length, 0.2 * slices.boxes[0][1][0] / before.camera(0, slices.boxes[0][1]).fx, rtol=0.02)
    measurer = driver.window.measures.measurer
    driver.until(lambda: not (slices.busy or measurer.busy), 60, "the faces and the volume")
    driver.context.item_input(driver.item("//Inspector/##distance"))
    driver.context.key_chars_replace_enter("85")
    driver.frames(2)
    assert session.viewing.unit.name == "mm" and np.isclose(session.viewing.unit.length, 85 / length)
    driver.picture(folder / "shots" / "slices.png")
    assert "slices" not in {entry.name for entry in session.history.entries}
    driver.press(Key.s)
    assert not session.viewing.slices and not slices.measuring


def drag_ring(driver: Driver, centre: NDArray[np.float64]) -> None:
    """Drags the top of the outermost ring around a point (3,) to the right."""
    view = driver.window.viewport
    x, y = project_points(view.camera(), centre[None])[0][0] / view.size
    for distance in np.arange(0.3, 0.0, -0.01):
        driver.context.mouse_move_to_pos(driver.point(float(x), float(y - distance)))
        driver.frames(2)
        if on_handles():
            driver.drag((float(x), float(y - distance)), (float(x) + 0.1, float(y - distance)))
            driver.still()
            return
    raise AssertionError("no ring")


def faces(driver: Driver, folder: Path) -> None:
    """A picture is added and viewed; its outline and axis are dragged, painted, undone and kept."""
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
    # Drag a point of the outline.
    outline = face.marks.outline
    assert outline is not None and face.found is not None
    right = max(range(len(outline)), key=lambda index: outline[index][0])
    drag(outline[right], (-60.0, 0.0))
    moved = face.given.outline
    assert moved is not None and max(x for x, _ in moved) < outline[right][0] - 0.005
    assert overlap(moved, outline) < 0.99
    second = preview()
    assert np.abs(second - first).mean() > 0.2
    # Drag an end of the axis.
    line = face.marks.line
    assert line is not None
    drag(line[0], (70.0, 10.0))
    assert face.given.line is not None and face.given.line[0][0] > line[0][0] + 0.05
    third = preview()
    assert np.abs(third - second).mean() > 1.5
    driver.picture(shots / "faces_3_dragged.png")
    # Paint with the brush.
    driver.click("//Object/Take away##face tool")
    top = min(moved, key=lambda place: place[1])
    drag((top[0], top[1] - 0.02), (0.0, 30.0))
    painted = face.given.outline
    assert painted is not None and overlap(painted, moved) < 0.998
    assert polygon_mask(painted, 300, 300).sum() < polygon_mask(moved, 300, 300).sum() - 50
    driver.picture(shots / "faces_4_brush.png")
    # Undo, one step per drag; the picture's kind; what is kept.
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
    """Intersection over union of the areas inside two outlines."""
    one, other = (polygon_mask(outline, 300, 300) for outline in (a, b))
    return float((one & other).sum() / (one | other).sum())


def main() -> None:
    """Runs the script named on the command line."""
    name, folder = sys.argv[1], Path(sys.argv[2])
    script, size = {"upright": (upright, (860, 560)), "faces": (faces, (1180, 700))}[name]
    at_once(folder, lambda driver: script(driver, folder), size)
    print("well")


if __name__ == "__main__":
    main()
