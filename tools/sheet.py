"""The README's sheet of cuts, scaled to the page: from the last `make demo`, or from a new one."""

from __future__ import annotations

import subprocess
from pathlib import Path

from PIL import Image

from engine.io.files import atomic
from engine.io.picture_file import open_picture

ROOT = Path(__file__).parents[1]
WIDTH = 1440


def main() -> None:
    """Writes docs/pictures/watermelon_cuts.png."""
    sheet = ROOT / "out/watermelon/cuts.png"
    if not sheet.exists():
        subprocess.run(["make", "demo"], cwd=ROOT, check=True)
    with open_picture(sheet) as picture:
        size = (WIDTH, WIDTH * picture.height // picture.width)
        smaller = picture.resize(size, Image.Resampling.LANCZOS)
    with atomic(ROOT / "docs/pictures/watermelon_cuts.png") as temporary:
        smaller.save(temporary, optimize=True)


if __name__ == "__main__":
    main()
