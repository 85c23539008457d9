"""Cut faces found in photographs, beside hand-marked masks and axes.

    python -m benchmarks.photographs.faces [--quick] [-o FOLDER] [photographs]

The folder of photographs holds `masks/` and `list.csv` (by default ../shared/data/photos/fruit). Prints for each the
intersection over union with its mask, the distance of the core or core line from the marks in per cent of the width,
the guessed kind of cut, the seconds of processor time, and the note to the user; writes outlines and axes on the
photographs.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from benchmarks.photographs.listed import parse_options
from engine.errors import InputError
from engine.io.picture_file import read_pixels, save_png
from training.faces.axis import find_core, guess_cut
from training.faces.core_line import find_core_line
from training.priors.exemplar.pictures import find_face

__all__ = ["axis_error", "mask_iou"]

TILE = 320
"""Pixels of a photograph on the sheet."""


def mask_iou(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks (H, W). Range [0, 1]."""
    return float((found & truth).sum() / (found | truth).sum())


def axis_error(rgb: NDArray[np.float32], mask: NDArray[np.bool_], row: dict[str, str]) -> float:
    """Distance of the found core, or of the core line from its two marks, over the face's width; 0 for slices."""
    width = float(np.ptp(np.nonzero(mask)[1]) + 1)
    if row["family"] == "horizontal":
        x, y = find_core(mask)
        return float(np.hypot(x - float(row["core_x"]), y - float(row["core_y"]))) / width
    if row["family"] != "radial":
        return 0.0
    marks = np.array([[float(row[f"axis_{end}_{c}"]) for c in "xy"] for end in ("stem", "blossom")])
    first, last = find_core_line(rgb, mask).ends
    along = (last - first) / np.linalg.norm(last - first)
    return float(np.abs((marks - first) @ [along[1], -along[0]]).max()) / width


def drawn(pixels: NDArray[np.uint8], mask: NDArray[np.bool_], kind: str) -> Image.Image:
    """The photograph with the found outline in green and its core or core line in blue."""
    image = Image.fromarray(pixels)
    rim = Image.fromarray(mask ^ np.pad(mask, 1)[2:, 1:-1] | mask ^ np.pad(mask, 1)[1:-1, 2:])
    image.paste((0, 220, 0), mask=rim)
    pen = ImageDraw.Draw(image)
    if kind == "horizontal":
        x, y = find_core(mask)
        pen.ellipse((x - 6, y - 6, x + 6, y + 6), outline=(0, 0, 255), width=3)
    elif kind == "radial":
        line = find_core_line((pixels / 255).astype(np.float32), mask)
        pen.line([tuple(end) for end in line.ends], fill=(0, 0, 255), width=3)
    return image.resize((TILE, TILE), Image.Resampling.LANCZOS)


def main(arguments: list[str] | None = None) -> None:
    """Measures a folder of photographs."""
    options, rows = parse_options(__doc__, arguments)
    overlaps, tiles = [], []
    print(f"{'picture':20} {'IoU':>6} {'axis %':>6} {'seems':>10} {'sure':>5} {'s':>5}")
    for row in rows:
        path = options.photographs / row["path"]
        pixels, truth = read_pixels(path), read_pixels(options.photographs / "masks" / row["path"])[..., 0] > 127
        start = time.process_time()
        try:
            rgb, face = find_face(path)
        except InputError as error:
            print(f"{path.stem:20} {error}")
            overlaps.append(0.0)
            continue
        mask = face.mask
        seconds = time.process_time() - start
        guess = guess_cut(rgb, mask)
        overlaps.append(mask_iou(mask, truth))
        away = 100 * axis_error(rgb, mask, row)
        said = f"{guess.kind:>10} {guess.sureness:5.2f} {seconds:5.2f}"
        print(f"{path.stem:20} {overlaps[-1]:6.4f} {away:6.1f} {said} {face.note}".rstrip())
        tiles.append(np.asarray(drawn(pixels, mask, row["family"])))
    values = np.array(overlaps)
    print(
        f"median {np.median(values):.4f}, least {values.min():.4f}, {(values < 0.97).sum()} of {len(values)} under 0.97"
    )
    if options.out and tiles:
        options.out.mkdir(parents=True, exist_ok=True)
        tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % 6)
        sheet = np.concatenate([np.concatenate(tiles[i : i + 6], 1) for i in range(0, len(tiles), 6)])
        save_png(options.out / "faces.png", sheet, optimize=True)


if __name__ == "__main__":
    main()
