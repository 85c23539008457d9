"""Script for the real window: a film is made on the timeline, played and saved; the object is thrown and cut in flight;
tests/app/test_window.py runs it in its own process, with NAME and FOLDER."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from imgui_bundle import ImVec2, imgui

from app.model.document import Part
from app.model.film.throw import SECONDS
from app.model.film.timeline import FilmLook
from app.ui.theme import px
from engine.scene.plane import Plane
from tests.helpers.app_driver import Driver
from tests.helpers.app_steps import at_once

Key = imgui.Key


def film(driver: Driver, folder: Path) -> None:
    """Two keyframes, one dragged, scrubbing, playing, looking around, presets; the film is saved as frames."""
    session, window, shots = driver.session, driver.window, folder / "shots"
    control, context = session.film, driver.context
    session.add_plane()
    session.active_cut = None
    cut = session.document.cuts[0].id
    driver.press(Key.l)
    driver.picture(shots / "film_1_empty.png")
    driver.press(Key.n)
    assert len(session.timeline.keyframes) == 1 and session.viewing.timeline
    driver.drag((0.4, 0.5), (0.7, 0.55), button=1)
    session.change_cut("Move", cut, lambda c: replace(c, shift=-0.5))
    driver.press(Key.n)
    assert [one.time for one in session.timeline.keyframes] == [0.0, 2.0]
    driver.picture(shots / "film_2_two.png")
    first, last = (one.eye.azimuth for one in session.timeline.keyframes)
    assert first != last

    # The second keyframe is dragged to the right: a longer film, in one step.
    steps = len(session.history.entries)
    info = context.item_info(inside("##key1"))
    at = ImVec2((info.rect_full.min.x + info.rect_full.max.x) / 2, (info.rect_full.min.y + info.rect_full.max.y) / 2)
    context.mouse_move_to_pos(at)
    context.mouse_down(0)
    for by in (20.0, 60.0):
        context.mouse_move_to_pos(ImVec2(at.x + by, at.y))
        driver.frames(2)
    context.mouse_up(0)
    driver.frames(2)
    assert session.timeline.seconds > 2.2 and len(session.history.entries) == steps + 1 and control.selected == 1

    # Scrubbing shows the film between keyframes and changes nothing; Esc returns to the object as it is.
    ruler = context.item_info(inside("##ruler")).rect_full
    documents = session.documents
    key0 = context.item_info(inside("##key0")).rect_full
    key1 = context.item_info(inside("##key1")).rect_full
    middle = (key0.min.x + key0.max.x + key1.min.x + key1.max.x) / 4
    context.mouse_move_to_pos(ImVec2(middle, ruler.min.y + 8))
    context.mouse_down(0)
    driver.frames(3)
    context.mouse_up(0)
    assert control.shown and abs(control.time - session.timeline.seconds / 2) < 0.1
    (moved,) = session.drawn_documents[0].cuts
    shift = -moved.parts[0].plane.offset + documents[0].cuts[0].parts[0].plane.offset
    assert -0.4 < shift < -0.1 and session.documents is documents
    driver.picture(shots / "film_3_between.png")
    driver.press(Key.escape)
    assert not control.shown
    now = 0.0
    control.clock = lambda: now
    driver.press(Key.space)
    assert control.playing and control.shown
    now = 60.0
    driver.frames(2)
    assert not control.playing and np.isclose(np.cos(np.radians(session.viewing.eye.azimuth - last)), 1)
    driver.press(Key.comma)
    assert control.selected == 0 and np.isclose(session.viewing.eye.azimuth, first)
    driver.press(Key.delete)
    assert len(session.timeline.keyframes) == 1
    driver.press(Key.mod_ctrl | Key.z)
    assert len(session.timeline.keyframes) == 2

    # A preset from its menu; then the window for saving.
    driver.click(inside("###Make"))
    driver.frames(2)
    driver.click("//$FOCUSED/Explosion")
    driver.frames(2)
    assert control.playing and len(session.timeline.keyframes) == 3
    driver.press(Key.space)
    driver.press(Key.mod_ctrl | Key.mod_shift | Key.e)
    driver.frames(2)
    driver.picture(shots / "film_4_save.png")
    session.viewing = replace(session.viewing, film=FilmLook((64, 48), 1.0, "transparent"))
    window.film_window.form = ""
    window.dialogs.native = False
    driver.frames(2)
    driver.click("//$FOCUSED/Choose where...")
    driver.frames(2)
    context.key_chars_replace_enter(str(folder / "frames"))
    driver.frames(2)
    assert control.busy
    driver.picture(shots / "film_5_saving.png")
    driver.until(lambda: not control.busy, 120, "the frames")
    assert len(list((folder / "frames").glob("*.png"))) == 6, session.message
    driver.press(Key.l)
    assert not session.viewing.timeline and len(session.timeline.keyframes) == 3


def throw_and_slice(driver: Driver, folder: Path) -> None:
    """The object is thrown and cut in flight, and the cut is kept. Pieces part slowly, or at once."""
    session, throw = driver.session, driver.session.throw
    driver.press(Key.v)
    documents, now = session.documents, 0.0
    throw.clock = lambda: now
    driver.press(Key.y)
    assert throw.active
    now += SECONDS / 2
    driver.frames(2)
    driver.drag((0.1, 0.42), (0.9, 0.42))
    now += 0.5
    assert throw.pieces == 2 and session.documents is documents
    driver.picture(folder / "shots" / "film_6_thrown.png")
    driver.press(Key.enter)
    assert not throw.active and len(session.pieces) == 2, session.message
    driver.press(Key.mod_ctrl | Key.z)
    assert session.documents == documents
    (animation,) = driver.window.viewport.piece_animations.values()
    for moves in (True, False):
        session.settings = replace(session.settings, motion=moves)
        driver.still()
        begun = animation.begin
        session.change("Cut", session.document.with_cut((Part(Plane.of((0, 0, 1), 0.0)),)))
        driver.frames(2)
        assert (animation.begin > begun) == moves
        session.undo()


def names(driver: Driver, folder: Path) -> None:
    """A piece is named, two are marked and grouped, and the group is hidden; the interface in other sizes."""
    session, window, context = driver.session, driver.window, driver.context
    shots = folder / "shots"
    session.jump(0)
    session.change("Cut", session.document.with_cut((Part(Plane.of((0, 0, 1), 0.0)),)))
    session.change("Cut", session.document.with_cut((Part(Plane.of((1, 0, 0), 0.1)),)))
    driver.still()
    first, second, *_ = (piece.key for piece in session.pieces)
    session.selected = frozenset([first])
    driver.press(Key.f2)
    context.key_chars("Lid")
    driver.press(Key.enter)
    assert session.pieces[0].name == "Lid" and session.history.entries[-1].name == "Name"
    session.selected = frozenset([first, second])
    driver.frames(2)
    driver.click(f"//Inspector/{first}/###mark")
    driver.frames(2)
    driver.click("//$FOCUSED/###star")
    context.item_input("//$FOCUSED/##group")
    context.key_chars_replace("Left")
    driver.picture(shots / "names_1_popup.png")
    driver.press(Key.enter)
    driver.frames(2)
    marked = [piece for piece in session.pieces if piece.mark == "star" and piece.group == "Left"]
    assert {piece.key for piece in marked} == {first, second} and not session.error
    driver.picture(shots / "names_2_marked.png")
    driver.click("//Inspector/group Left/###seen")
    driver.frames(2)
    assert [piece.visible for piece in session.pieces if piece.group] == [False, False]
    for _ in range(2):
        driver.press(Key.mod_ctrl | Key.z)
    assert all(piece.visible and not piece.group for piece in session.pieces)
    width = imgui.calc_text_size("Interior").x
    for way, before, scale in ((Key.equal, 1.75, 2.0), (Key.minus, 1.0, 0.75)):
        session.settings = replace(session.settings, scale=before)
        driver.press(Key.mod_ctrl | way)
        assert session.settings.scale == scale and np.isclose(px(1), scale)
        assert np.isclose(imgui.get_style().font_scale_main, scale) and width > 0
        driver.picture(shots / f"names_3_scale_{scale:g}.png")
    assert window.viewport.size[0] > 200


def replaced(driver: Driver, folder: Path) -> None:
    """A file that is there is replaced once the user agrees."""
    session, window = driver.session, driver.window
    there = folder / "there.png"
    there.write_bytes(b"mine")
    window.dialogs.native = False

    def choose(path: Path) -> None:
        window.export.open("picture")
        driver.frames(2)
        driver.click("//$FOCUSED/Choose where...")
        driver.frames(2)
        driver.context.key_chars_replace_enter(str(path))
        driver.frames(2)

    choose(there)
    assert session.question is not None and "there.png" in session.question.text and there.read_bytes() == b"mine"
    driver.press(Key.escape)
    assert session.question is None and there.read_bytes() == b"mine"
    choose(there)
    driver.click("//$FOCUSED/Replace")
    driver.frames(2)
    assert there.read_bytes()[:4] == b"\x89PNG", session.error


def fail(driver: Driver, folder: Path) -> None:
    """Background work that fails is told of, and does not end the window."""
    session = driver.session
    with patch.object(session.files, "tick", side_effect=[ValueError("of the disk"), *[None] * 99]):
        driver.frames(3)
    assert "Something went wrong (ValueError: of the disk)" in session.error
    session.error = ""


def inside(name: str) -> str:
    """The path of an item in the timeline."""
    return f"//Object/**/{name}"


def run_all(driver: Driver, folder: Path) -> None:
    """Runs all scripts in one window."""
    for script in (film, throw_and_slice, names, replaced, fail):
        script(driver, folder)


def main() -> None:
    """Runs the script named on the command line."""
    folder = Path(sys.argv[2])
    at_once(folder, lambda driver: run_all(driver, folder), (800, 440))
    print("well")


if __name__ == "__main__":
    main()
