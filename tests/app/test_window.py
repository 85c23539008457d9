"""The real window under an X server, driven by ImGui's test engine; each script runs in its own process, on Linux in a
fork of one that has imported all."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec4

from app.ui.theme import DARK, LIGHT, Palette, _roles, rgb, rgba
from tests.paths import ROOT

TEN_MINUTES = 600.0

Run = Callable[..., None]
"""Runs a script, given its name, its folder, and its module if that is not `app_steps`; says why it failed."""


@pytest.fixture(scope="module")
def server() -> Iterator[subprocess.Popen[str] | None]:
    """A process that runs scripts in forks of itself, all under one X server."""
    if not sys.platform.startswith("linux"):
        yield None
        return
    process = subprocess.Popen(
        windowed("-m", "tests.helpers.workers.app_server"), cwd=ROOT, env=environment(), text=True, bufsize=1,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    yield process
    process.communicate(timeout=60)


@pytest.fixture
def run(server: subprocess.Popen[str] | None) -> Run:
    if server is None:
        return run_alone

    def run(name: str, folder: Path, script: str = "app_steps") -> None:
        assert server.stdin is not None and server.stdout is not None
        printed = folder / "printed.txt"
        server.stdin.write(json.dumps([script, name, str(folder), str(printed)]) + "\n")
        pid = server.stdout.readline()
        assert pid, server.communicate()[1]
        # With the window, which would keep a core busy.
        too_long = threading.Timer(TEN_MINUTES, os.killpg, (int(pid), signal.SIGKILL))
        too_long.start()
        status = int(server.stdout.readline())
        too_long.cancel()
        judge(status, printed.read_text(errors="replace"))

    return run


def run_alone(name: str, folder: Path, script: str = "app_steps") -> None:
    """Runs a script in a process that imports all by itself."""
    process = subprocess.Popen(
        windowed("-m", f"tests.helpers.{script}", name, str(folder)), cwd=ROOT, env=environment(), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
    )  # fmt: skip
    try:
        said, _ = process.communicate(timeout=TEN_MINUTES)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)  # and the window, which would keep a core busy
        said, _ = process.communicate()
    judge(process.returncode, said)


def windowed(*arguments: str) -> list[str]:
    """The command that runs Python where there is a display."""
    command = [sys.executable, *arguments]
    if not os.environ.get("DISPLAY") and sys.platform.startswith("linux"):
        server = shutil.which("xvfb-run")
        if server is None:
            pytest.skip("no display, and no xvfb-run to make one (install xvfb)")
        return [server, "-a", "-s", "-screen 0 1680x1200x24 -noreset", *command]
    return command


def environment() -> dict[str, str]:
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return os.environ | {"PYTHONPATH": path, "LIBGL_ALWAYS_SOFTWARE": "1"}


def judge(status: int, said: str) -> None:
    """Fails, or skips where no window can be opened, unless a script ended well."""
    if "cannot create context" in said or "Failed to create GLFW window" in said:
        pytest.skip("no OpenGL 3.3 on this display (install libgl1-mesa-dri)")
    assert status != -signal.SIGKILL, f"after ten minutes: {said[-3000:]}"
    assert status == 0 and "well" in said, said[-3000:]


@pytest.mark.slow
def test_a_user_cuts_trains_saves_and_exports(tmp_path: Path, run: Run) -> None:
    run("steps", tmp_path)
    assert len(list((tmp_path / "shots").glob("*.png"))) == 9


@pytest.mark.slow
def test_a_dense_screen_dropped_files_dialogs_and_leaving(tmp_path: Path, run: Run) -> None:
    run("habits", tmp_path)


@pytest.mark.slow
def test_the_object_is_stood_on_a_face_and_turned(tmp_path: Path, run: Run) -> None:
    run("upright", tmp_path, "app_scripts")
    assert len(list((tmp_path / "shots").glob("upright_*.png"))) == 6


@pytest.mark.slow
def test_a_user_isolates_the_object_and_takes_it_back(tmp_path: Path, run: Run) -> None:
    run("isolate", tmp_path, "app_isolate_steps")
    assert len(list((tmp_path / "shots").glob("*.png"))) == 5


def test_two_objects_are_selected_cut_named_and_hidden(tmp_path: Path, run: Run) -> None:
    run("several", tmp_path, "app_isolate_steps")
    assert len(list((tmp_path / "shots").glob("*.png"))) == 5


@pytest.mark.slow
def test_a_picture_is_looked_at_and_corrected_before_training(tmp_path: Path, run: Run) -> None:
    run("faces", tmp_path, "app_scripts")
    assert len(list((tmp_path / "shots").glob("faces_*.png"))) == 5


@pytest.mark.slow
def test_a_film_is_made_the_object_thrown_and_pieces_named(tmp_path: Path, run: Run) -> None:
    run("film", tmp_path, "app_film_steps")
    assert len(list((tmp_path / "shots").glob("*.png"))) == 10


def test_what_was_open_lately_is_shown_with_pictures(tmp_path: Path, run: Run) -> None:
    run("recent", tmp_path, "hard_use.steps")


def test_splats_lines_and_names_are_shown_as_the_view_says(tmp_path: Path, run: Run) -> None:
    run("options", tmp_path, "hard_use.steps")


def test_all_is_reached_by_keyboard_and_the_knife_cuts_by_it(tmp_path: Path, run: Run) -> None:
    run("keyboard", tmp_path, "hard_use.steps")


@pytest.mark.slow
def test_in_a_language_of_long_words_all_is_translated_and_fits(tmp_path: Path) -> None:
    run_alone("pseudo", tmp_path, "hard_use.steps")  # the language is chosen before anything is imported


@pytest.mark.slow
def test_two_thousand_random_actions_leave_nothing_behind(tmp_path: Path, run: Run) -> None:
    run("soak", tmp_path)


@pytest.mark.parametrize("p", [DARK, LIGHT])
def test_text_stands_out_from_every_ground_that_it_is_on(p: Palette) -> None:
    """By a contrast of 4.5 or more, as WCAG 2 asks for text (relative luminance of sRGB)."""

    grounds = (p.ground, p.panel, p.field, p.hover, p.view)
    pairs = [(text, ground) for text in (p.text, p.second) for ground in grounds]
    pairs += [(p.text, p.pressed), (p.on_accent, p.accent), (p.trouble, p.panel), (p.curve, p.view), (p.third, p.view)]
    pairs += [(mark, ground) for mark in p.marks for ground in (p.panel, p.view)]
    for text, ground in pairs:
        assert contrast(rgb(text), rgb(ground)) >= 4.5, (text, ground)


@pytest.mark.parametrize("p", [DARK, LIGHT])
def test_text_of_every_control_stands_out_in_every_state(p: Palette) -> None:
    """Colours as ImGui gets them, over what is behind them; pictures behind a label count as black and as white."""

    def over(front: ImVec4, behind: tuple[float, float, float]) -> tuple[float, float, float]:
        r, g, b = (front.w * a + (1 - front.w) * c for a, c in zip((front.x, front.y, front.z), behind, strict=True))
        return r, g, b

    roles, panel = _roles(p), rgb(p.panel)
    kinds = ("window", "popup", "title", "menu", "frame", "button", "header", "tab")
    grounds = [name for name in roles if name.startswith(kinds) and "overline" not in name]
    assert len(grounds) >= 20
    seen = {name: over(roles[name], panel) for name in grounds}
    seen["selected text"] = over(roles["text_selected_bg"], rgb(p.field))
    for behind in ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)):
        seen[f"label over {behind}"] = over(rgba(p.ground, 0.8), behind)
        seen[f"slice's title over {behind}"] = over(rgba(p.view, 0.72), behind)
        seen[f"name over {behind}"] = over(rgba(p.view, 0.9), behind)
    for name, ground in seen.items():
        assert contrast(rgb(p.text), ground) >= 4.5, name
        assert contrast(over(roles["nav_cursor"], ground), ground) >= 3.0, f"the ring of the keyboard on {name}"
    for accent in (p.accent, p.accent_hovered, p.accent_pressed):
        assert contrast(rgb(p.on_accent), rgb(accent)) >= 4.5, accent


def contrast(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    """WCAG 2 contrast of two colours with channels in [0, 1]."""

    def luminance(colour: tuple[float, float, float]) -> float:
        parts = np.array(colour)
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_without_a_display_or_a_file_one_line_says_so(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"PYTHONPATH": str(ROOT), "FRUITNINJA_HOME": str(tmp_path)}
    for words, said in ((["nowhere.ply"], "no such file"), ([], "no display")):
        if not words and not sys.platform.startswith("linux"):
            continue
        command = [sys.executable, "-m", "app.main", *words]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
        assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1, done.stderr
