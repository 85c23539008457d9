"""Scripts for the real window used hard: recent files, options of the view, the keyboard alone, other languages;
tests/app/test_window.py runs one in a process, with its name and FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

from imgui_bundle import icons_fontawesome_6 as icon
from imgui_bundle import imgui
from PIL import Image

from app.session.recent_pictures import picture_of
from tests.helpers.app_driver import Driver
from tests.helpers.app_steps import at_once

Key = imgui.Key


def recent(driver: Driver, folder: Path) -> None:
    """A saved project has a picture on the empty window; it is opened again from it, and taken off the list."""
    session, shots = driver.session, folder / "shots"
    path = folder / "melon.fruitninja"
    session.files.save(path)
    driver.until(picture_of(str(path)).exists, 10, "the picture")
    with Image.open(picture_of(str(path))) as image:
        assert image.size == (400, 250)
        colours = image.convert("RGB").getcolors(100_000)
        assert colours is not None and len(colours) > 500  # the melon, not an even ground
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


def main() -> None:
    """Runs one of them."""
    name, folder = sys.argv[1], Path(sys.argv[2])
    scripts = {"recent": recent}
    at_once(folder, lambda driver: scripts[name](driver, folder), (860, 560))
    print("well")


if __name__ == "__main__":
    main()
