"""The README's sheet of cuts: the last `make demo`, or a new one, scaled to the page."""

from __future__ import annotations

import subprocess
from pathlib import Path

from PIL import Image

from engine.picture_file import open_picture

ROOT = Path(__file__).parents[1]
WIDTH = 1440


def main() -> None:
    """Writes docs/pictures/watermelon_cuts.png."""
    sheet = ROOT / "out/watermelon/cuts.png"
    if not sheet.exists():
        subprocess.run(["make", "demo"], cwd=ROOT, check=True)
    with open_picture(sheet) as picture:
        size = (WIDTH, WIDTH * picture.height // picture.width)
        small = picture.resize(size, Image.Resampling.LANCZOS)
    small.save(ROOT / "docs/pictures/watermelon_cuts.png", optimize=True)


if __name__ == "__main__":
    main()
