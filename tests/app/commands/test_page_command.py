"""`fruitninja-render --html`: the page in a real browser against what Python draws, and bad input in one line."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import fruitninja
from engine.io.trained import Meta, save_trained
from tests.app.commands.test_render_command import run
from tests.browser import SOFTWARE, opened
from tests.helpers.solids import filled_ball

SIDE = 200
PANEL = 288
"""Pixels: the side of the picture, and the width of the panel beside it."""

SIZE = (SIDE + PANEL, SIDE)

FLESH, RIND = np.array([[0.85, 0.15, 0.2], [0.9, 0.95, 0.75]], np.float32)

REPEATED = """() => {
    const held = { key: "ArrowLeft", repeat: true, bubbles: true };
    for (let n = 0; n < 9; n++) document.body.dispatchEvent(new KeyboardEvent("keydown", held));
}"""
"""Nine more events of the same key before the next frame, each of which takes a second without a graphics card."""

PLANE = (0.3, -0.2, 1.0, 0.0)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("trained") / "melon <b>&amp; co.ply"
    atoms = filled_ball(1 / 24)
    deep = np.linalg.norm(atoms.interior.means, axis=1, keepdims=True) < 0.35
    rgb = np.where(deep, FLESH, RIND).astype(np.float32)
    save_trained(path, replace(atoms, interior=replace(atoms.interior, rgb=rgb)), Meta())
    return path


@pytest.fixture(scope="module")
def page(trained: Path) -> Path:
    """The page of half a ball over white, as written by the command."""
    out = trained.with_name("page.html")
    with pytest.MonkeyPatch.context() as patch:
        words = ("--plane", ",".join(map(str, PLANE)), "--background", "white")
        assert run(patch, trained, "--html", "-o", out, *words) == 0
    return out


def picture(tab: Any) -> NDArray[np.int64]:
    """(SIDE, SIDE, 3). What the page shows once nothing moves."""
    tab.wait_for_selector("canvas[data-drawn=rest]", state="attached")
    shown = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
    return np.asarray(shown).astype(int)[:, :SIDE]


def test_the_page_shows_what_python_draws(trained: Path, page: Path) -> None:
    solid = fruitninja.open(trained)
    half = solid.cut(PLANE)
    camera = half.camera(distance=1.05, size=(SIDE, SIDE))
    with opened(page, SIZE, *SOFTWARE) as (tab, said):
        assert tab.title() == tab.inner_text("h1") == trained.stem
        first = picture(tab)
        compare(first, half.render(camera))
        assert np.abs(first[SIDE // 2, SIDE // 2] - 255 * FLESH).max() < 8
        tab.keyboard.press("ArrowLeft")
        tab.evaluate(REPEATED)
        moved = picture(tab)
        low, high = solid.bounds
        normal = np.array(PLANE[:3]) / np.linalg.norm(PLANE[:3])
        distance = 10 / 50 * float(np.abs(normal) @ (high - low) / 2)
        compare(moved, solid.cut((*normal, distance - normal @ (low + high) / 2)).render(camera))
        tab.keyboard.press("c")
        compare(picture(tab), solid.render(camera))
        assert said == [page.as_uri()]


def compare(page: NDArray[np.int64], python: NDArray[np.uint8]) -> None:
    """Asserts the same silhouette to 3 % of its pixels, and the same colours except at the rim, which is a pixel or two
    wide: there a page shows the skin from a volume of cells."""
    seen = [shown.min(-1) < 250 for shown in (page, python)]
    assert (seen[0] & seen[1]).sum() > 0.97 * (seen[0] | seen[1]).sum()
    apart = np.abs(page - python).max(-1)[seen[0] & seen[1]]
    assert np.median(apart) <= 4
    assert np.percentile(apart, 95) <= 45


def test_a_browser_without_webgl_says_so(page: Path) -> None:
    with opened(page, SIZE, "--disable-webgl", "--disable-webgl2") as (tab, _):
        tab.get_by_text("This page needs WebGL 2").wait_for()


def test_the_page_is_one_file_and_always_the_same(
    trained: Path, page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"https?:|<link|@import|\bsrc=|url\(", text)
    assert "default-src 'none'" in text
    again = tmp_path / "again.html"
    fruitninja.open(trained).cut(PLANE).html(again, background=(1, 1, 1))
    assert again.read_bytes() == page.read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--html", "-o", "a.png"), "ends so"),
        (("-o", "a.html", "--film", "sweep"), "--film"),
        (("-o", "a.html", "--size", "100x100"), "--size"),
        (("-o", "a.html", "--background", "transparent"), "transparent"),
    ],
)
def test_what_does_not_fit_a_page_is_refused(
    words: tuple[str, ...],
    said: str,
    trained: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, trained, *words) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
