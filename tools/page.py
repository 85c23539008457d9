"""Takes the README's picture of an HTML page in a real browser: the watermelon of `make demo`."""

from __future__ import annotations

from pathlib import Path

import fruitninja
from tests.browser import SOFTWARE, opened

ROOT = Path(__file__).resolve().parents[1]
SOLID = ROOT / "out/watermelon/watermelon.ply"
PAGE = ROOT / "out/page/watermelon.html"
PICTURE = ROOT / "docs/pictures/page.png"
SIZE = (1200, 720)
PATIENCE = 300_000
"""Milliseconds to wait: a CPU takes some seconds for a frame of this size."""


def main() -> None:
    """Writes the page and takes its picture."""
    print(fruitninja.open(SOLID).cut((0.35, -0.2, 1, 0)).html(PAGE))
    with opened(PAGE, SIZE, *SOFTWARE) as (tab, _):
        tab.wait_for_selector("canvas[data-drawn=rest]", state="attached", timeout=PATIENCE)
        tab.screenshot(path=PICTURE, timeout=PATIENCE)
    print(PICTURE)


if __name__ == "__main__":
    main()
