"""Scripts for hard use of the real window: recent files, options of the view, the keyboard alone, other languages;
tests/app/test_window.py runs one in its own process, with NAME and FOLDER."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import glfw
import numpy as np
from imgui_bundle import icons_fontawesome_6 as icon
from imgui_bundle import imgui
from PIL import Image

from app import translation
from tests.helpers.hard_use.pseudo import Pseudo, Watch

if "pseudo" in sys.argv:
    translation.install(Pseudo())  # before importing anything that has words

from app.model.knife import PlaneAngles
from app.session.keyboard_controller import ANGLE, STEP
from app.session.recent_pictures import picture_of
from app.ui.theme import px
from engine.render.culling.draw_options import SplatLook
from tests.helpers.app_driver import Driver
from tests.helpers.app_steps import at_once, ground

Key = imgui.Key


def recent(driver: Driver, folder: Path) -> None:
    """A saved project has a picture in the empty window; it is opened again from there, and removed from the list."""
    session, shots = driver.session, folder / "shots"
    path = folder / "melon.fruitninja"
    session.files.save(path)
    driver.until(picture_of(str(path)).exists, 10, "the picture")
    with Image.open(picture_of(str(path))) as image:
        assert image.size == (400, 250)
        colours = image.convert("RGB").getcolors(100_000)
        assert colours is not None and len(colours) > 500  # the melon, not an even background
    for name in ("gone.ply", "damaged.ply"):
        session.change_settings(session.settings.with_recent(folder / name))
    (folder / "damaged.ply").write_bytes(b"ply")
    picture_of(str(folder / "damaged.ply")).write_bytes(b"no picture")
    driver.press(Key.mod_ctrl | Key.w)
    assert session.document.scene is None and session.loader is None
    recent = driver.window.recent
    driver.until(lambda: recent.missing == {str(folder / "gone.ply")}, 10, "the look for files")
    driver.picture(shots / "recent_1_empty.png")
    inside = driver.context.window_info("//Object/##empty").id_
    driver.context.set_ref(imgui.test_engine.TestRef(inside))
    driver.click(f"{icon.ICON_FA_XMARK}##gone 1")
    assert [Path(name).name for name in session.settings.recent] == ["damaged.ply", "melon.fruitninja"]
    driver.click("##file 1")
    driver.frames(2)
    assert session.path == path and session.document.scene is not None
    session.scene.cancel()


def options(driver: Driver, folder: Path) -> None:
    """Splat sizes, the body as wires and names of families: each changes the picture, and only while it is on."""
    session, window, shots = driver.session, driver.window, folder / "shots"
    cut = Image.new("RGB", (64, 64), (200, 40, 40))
    cut.save(folder / "a kiwi.png")
    session.add_pictures("horizontal", (folder / "a kiwi.png",))
    driver.until(lambda: not session.faces.busy, 30, "the face")
    session.faces.dismiss_hint()
    driver.still()

    def whole() -> tuple[int, int]:
        """Pixels of the object, and how many of them are nearly as light as text."""
        view = driver.view()
        inner = view[60:-20, 20:-120].astype(int)
        return int((~ground(view)[60:-20, 20:-120]).sum()), int((inner.min(2) > 150).sum())

    plain, as_it_is = whole(), driver.view().astype(int)

    # A window in which nothing happens must sleep; setting a title is an event under X11, which wakes it.
    driver.until(lambda: window.params.fps_idling.enable_idling, 10, "rest")
    titles, set_title = [], glfw.set_window_title
    glfw.set_window_title = lambda *title: titles.append(title)
    driver.frames(5)
    glfw.set_window_title = set_title
    assert not titles

    session.change_settings(replace(session.settings, wires=True))
    driver.still()
    wired = whole()
    assert wired[1] > plain[1] + 500
    driver.picture(shots / "options_1_lines.png")
    session.change_settings(replace(session.settings, wires=False))
    window.viewport.show_families = frozenset(["horizontal"])
    driver.still()
    named = driver.view()
    driver.picture(shots / "options_2_families.png")
    window.viewport.show_families = frozenset()
    driver.still()
    right = named[:, int(0.8 * named.shape[1]) :].astype(int)
    assert (right[100:-100].min(2) > 200).sum() > 40  # the name stands beside the melon
    assert whole() == plain, (whole(), plain)

    # The smallest interface, with distances of fractional pixels, and a family open.
    window.menus._resize(-1)
    window.interior.open = "horizontal"
    driver.frames(4)
    assert px(46) == 34.5 and not session.error
    window.interior.open = None
    window.menus._resize(1)
    driver.frames(4)

    driver.click(f"//Object/{icon.ICON_FA_SLIDERS}##options")
    driver.frames(3)
    driver.picture(shots / "options_3_popup.png")
    driver.click("//$FOCUSED/Statistics")
    assert session.settings.statistics
    driver.press(Key.escape)
    session.change_settings(replace(session.settings, statistics=False))
    session.viewing = replace(session.viewing, splats=SplatLook(0.3))
    driver.still()
    assert (np.abs(driver.view().astype(int) - as_it_is) > 30).any(2).mean() > 0.02
    driver.picture(shots / "options_4_small.png")
    driver.click(f"//Object/{icon.ICON_FA_SLIDERS}##options")
    driver.frames(2)
    driver.click("//$FOCUSED/As they are")
    driver.press(Key.escape)
    driver.still()
    assert session.viewing.splats == SplatLook() and whole() == plain


def keyboard(driver: Driver, folder: Path) -> None:
    """The knife and every control without the pointer, which stays in a corner."""
    session, shots, io = driver.session, folder / "shots", imgui.get_io()

    def angles() -> PlaneAngles:
        (cut,) = session.document.cuts
        return PlaneAngles.of(cut.plane(cut.parts[0]), np.asarray(session.up), session.solid.centre)

    def focus() -> int:
        return int(imgui.get_current_context().nav_id)

    # The knife: a plane is placed, moved, tilted, turned and used to cut; another one is removed again.
    eye = session.viewing.eye
    driver.press(Key.right_arrow)
    driver.press(Key.equal)
    assert session.viewing.eye.azimuth != eye.azimuth and session.viewing.eye.distance < eye.distance
    driver.press(Key.k)
    driver.press(Key.enter)
    assert session.tool == "plane" and len(session.pieces) == 1
    assert abs(angles().tilt - 90) < 1e-6 and abs(angles().distance) < 1e-6
    turn = angles().turn
    for _ in range(3):
        driver.press(Key.right_arrow)
    assert abs(angles().distance - 3 * STEP * session.solid.radius) < 1e-6
    driver.press(Key.mod_shift | Key.right_arrow)
    assert abs(abs(angles().turn - turn) - ANGLE) < 1e-6
    for _ in range(30):  # past level and on, until it is upside down where it began
        driver.press(Key.up_arrow)
    assert abs(angles().tilt - 60) < 1e-6, angles()
    driver.press(Key.mod_ctrl | Key.up_arrow)
    assert abs(abs(angles().tilt - 60) - ANGLE / 10) < 1e-6, angles()
    driver.still()
    driver.picture(shots / "keyboard_1_plane.png")
    driver.press(Key.enter)
    driver.still()
    assert len(session.pieces) == 2 and session.document.cuts[0].kind == "slice"
    driver.press(Key.enter)
    assert len(session.document.cuts) == 2
    driver.press(Key.escape)
    assert len(session.document.cuts) == 1 and session.message == "Not cut."
    driver.press(Key.mod_ctrl | Key.a)
    driver.press(Key.m)
    before = session.pieces[0].motion
    driver.press(Key.up_arrow)
    assert session.pieces[0].motion != before
    session.jump(0)

    # Every control of the inspector is reached and pressed.
    driver.press(Key.f6)
    assert driver.window.parts.current == "inspector"
    add = driver.context.item_info(driver.item(f"//Inspector/{icon.ICON_FA_PLUS}  Add plane")).id_
    met = [focus()]
    while len(met) < 24:  # two rounds
        driver.press(Key.tab)
        met.append(focus())
        if met[-1] == add and not session.document.cuts:
            driver.picture(shots / "keyboard_2_ring.png")
            driver.press(Key.space)
    assert add in met and io.nav_visible
    assert [cut.kind for cut in session.document.cuts] == ["section"]
    assert len(set(met)) >= 8, met

    # The tools, by arrows; the menus, by F10.
    driver.press(Key.f6)
    assert driver.window.parts.current == "tools"
    session.select_tool("select")
    driver.press(Key.down_arrow)
    driver.press(Key.enter)
    assert session.tool == "knife"
    driver.picture(shots / "keyboard_3_tools.png")
    driver.press(Key.f10)
    for _ in range(2):
        driver.press(Key.right_arrow)
    driver.press(Key.down_arrow)
    driver.picture(shots / "keyboard_4_menu.png")
    driver.press(Key.enter)
    assert len(session.document.cuts) == 2  # "Add plane" is the first of Cut
    driver.press(Key.f6)
    assert driver.window.parts.current == "view"
    assert not driver.window.viewport.moving


def pseudo(driver: Driver, folder: Path) -> None:
    """Every part of the window in a language of long words: everything is translated, and everything fits."""
    session, window, shots, watch = driver.session, driver.window, folder / "shots", Watch()

    def look(name: str) -> None:
        driver.frames(4)
        driver.picture(shots / f"pseudo_{name}.png")

    Image.new("RGB", (64, 64), (200, 40, 40)).save(folder / "cut.png")
    session.add_pictures("horizontal", (folder / "cut.png",))
    session.add_pictures("radial", (folder / "cut.png",))
    driver.until(lambda: not session.faces.busy, 30, "the face")
    session.add_plane()
    window.interior.open = "horizontal"
    driver.still()
    look("1_plane")
    session.keyboard.enter(window.viewport.camera())
    session.select_tool("plane")
    session.active_cut = session.document.cuts[0].id
    session.keyboard.enter(window.viewport.camera())
    session.selected = frozenset([session.pieces[0].key])
    session.viewing = replace(session.viewing, slices=True, timeline=True)
    driver.still()
    look("2_slices")
    session.viewing = replace(session.viewing, slices=False, timeline=False)
    session.select_tool("isolate")
    look("3_isolate")
    session.select_tool("select")
    session.faces.edit("horizontal", folder / "cut.png")
    look("4_face")
    session.faces.close()
    for kind in ("picture", "section", "pieces", "meshes"):
        window.export.open(kind)
        look(f"5_{kind}")
        driver.press(Key.escape)
    window.menus.slices.open()
    look("6_even")
    driver.press(Key.escape)
    window.menus.shortcuts_shown = True
    look("7_shortcuts")
    listed = driver.context.window_info("//##shortcuts").window
    assert listed is not None and listed.scroll_max.x == 0  # fewer columns where words are long
    window.menus.shortcuts_shown = False
    driver.press(Key.f10)
    for _ in range(6):
        driver.press(Key.right_arrow)
        driver.frames(2)
    look("8_menu")
    driver.press(Key.escape)
    session.history.saved = session.history.state
    session.files.close_scene()
    look("9_empty")
    assert not watch.bare, watch.bare
    assert not watch.cramped, watch.cramped


def main() -> None:
    """Runs the script named on the command line."""
    name, folder = sys.argv[1], Path(sys.argv[2])
    scripts = {"recent": recent, "options": options, "keyboard": keyboard, "pseudo": pseudo}
    size = (1440, 900) if name == "pseudo" else (860, 560)
    at_once(folder, lambda driver: scripts[name](driver, folder), size)
    print("well")


if __name__ == "__main__":
    main()
