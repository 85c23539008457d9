"""Where the search for cut faces breaks: photographs with hand-marked masks, altered as other cameras would take them.

    python -m benchmarks.photographs.changed [--quick] [-o docs/charts] [photographs]

The folder of photographs holds `masks/` and `list.csv` (by default ../shared/data/photos/fruit). Each photograph is
changed in one way after another: light, colour, shadow, size, margin, tilt, blur, noise, what is behind it. Prints for
each change how many faces overlap with their mask by 0.97 and more, how many by less than 0.9 without a warning, how
many are refused, and how many kinds of cut are right. Writes changed_photographs.json and .png.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
import skimage.data
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from benchmarks.photographs.drawn import whole_fruit
from benchmarks.photographs.faces import mask_iou
from benchmarks.photographs.listed import parse_options
from benchmarks.support.charts import ACCENT, OTHER, plt, save_chart
from benchmarks.support.options import out_folder
from engine.errors import InputError
from engine.io.files import write_json
from engine.io.picture_file import open_picture, read_pixels
from engine.threads import side_by_side
from training.faces.axis import guess_cut
from training.faces.carrier import find_seen_face

Pixels: TypeAlias = NDArray[np.float32]
Mask: TypeAlias = NDArray[np.bool_]
Change: TypeAlias = Callable[[Pixels, Mask], tuple[Pixels, Mask]]

GOOD, WRONG = 0.97, 0.9
"""The overlap wanted, and the overlap below which the wrong face was found."""

GAMMA = 2.2


def lit(light: float | tuple[float, ...] | NDArray[np.floating]) -> Change:
    """Multiplies the light, as a camera sees it: channels that are full stay full."""

    def change(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
        return np.clip(rgb**GAMMA * light, 0, 1).astype(np.float32) ** np.float32(1 / GAMMA), mask

    return change


def from_a_side(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """Light that falls by 40 % across the picture."""
    return lit(np.linspace(0.6, 1, mask.shape[1])[:, None])(rgb, mask)


def dimmed_corners(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """A lens that loses a third of the light in the corners."""
    rows, columns = np.mgrid[-1 : 1 : mask.shape[0] * 1j, -1 : 1 : mask.shape[1] * 1j]
    return lit((1 - 0.35 * (rows**2 + columns**2) / 2)[..., None])(rgb, mask)


def shadowed(strength: float) -> Change:
    """Adds a soft shadow to the lower right that takes this fraction of the light away."""

    def change(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
        across = np.sqrt(mask.sum())
        shade = ndimage.gaussian_filter(ndimage.shift(mask.astype(float), (0.07 * across,) * 2), 0.03 * across)
        return lit((1 - strength * shade * ~mask)[..., None])(rgb, mask)

    return change


def sized(scale: float) -> Change:
    """Resamples by this factor."""

    def change(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
        size = tuple(round(scale * side) for side in mask.shape[::-1])
        way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        shown = cv2.resize(rgb, size, interpolation=way), cv2.resize(mask.astype(np.float32), size, interpolation=way)
        return np.clip(shown[0], 0, 1).astype(np.float32), shown[1] > 0.5

    return change


def tight(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """Crops to a margin of a fiftieth of the face."""
    rows, columns = np.nonzero(mask)
    margin = int(0.02 * max(np.ptp(rows), np.ptp(columns)))
    part = tuple(slice(max(at.min() - margin, 0), at.max() + margin + 1) for at in (rows, columns))
    return rgb[part].copy(), mask[part].copy()


def wide(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """Adds more than half of the picture's side all around, in the colour of its border."""
    margin = int(0.6 * max(mask.shape))
    shown = np.empty((*(side + 2 * margin for side in mask.shape), 3), np.float32)
    shown[:] = border_colour(rgb)
    shown[margin:-margin, margin:-margin] = rgb
    return shown, np.pad(mask, margin)


def seen_at(degrees: float, turn: float = 0) -> Change:
    """Seen from two widths away, leaning back by some degrees, and turned in the picture."""

    def change(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
        height, width = mask.shape
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
        x, y = ((corners - [width / 2, height / 2]) / width).T
        lean, spin = np.radians(degrees), np.radians(turn)
        x, y = x * np.cos(spin) - y * np.sin(spin), x * np.sin(spin) + y * np.cos(spin)
        depth = 2 - y * np.sin(lean)
        seen = np.stack([2 * x / depth, 2 * y * np.cos(lean) / depth], -1) * width + [width / 2, height / 2]
        way = cv2.getPerspectiveTransform(corners, seen.astype(np.float32))
        around = tuple(float(c) for c in border_colour(rgb))
        shown = cv2.warpPerspective(rgb, way, (width, height), borderMode=cv2.BORDER_CONSTANT, borderValue=around)
        return shown.astype(np.float32), cv2.warpPerspective(mask.astype(np.float32), way, (width, height)) > 0.5

    return change


def blurred(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """Out of focus."""
    return np.asarray(ndimage.gaussian_filter(rgb, (2, 2, 0)), np.float32), mask


def compressed(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """JPEG of quality 25."""
    bgr = np.round(255 * rgb[..., ::-1]).astype(np.uint8)
    file = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 25])[1]
    decoded = np.asarray(cv2.imdecode(file, cv2.IMREAD_COLOR))
    return (decoded[..., ::-1] / 255).astype(np.float32), mask


def noisy(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """Noise with a standard deviation of ten 8-bit steps."""
    noise = np.random.default_rng(0).normal(0, 0.04, rgb.shape)
    return np.clip(rgb + noise, 0, 1).astype(np.float32), mask


def laid(on: Pixels, face: Pixels, mask: Mask) -> Pixels:
    """A picture (H, W, 3) on which a face (H, W, 3) lies that casts a shadow of 40 %."""
    nearest = ndimage.distance_transform_edt(
        ~ndimage.binary_erosion(mask, iterations=2), return_distances=False, return_indices=True
    )
    share = ndimage.gaussian_filter(mask.astype(np.float32), 0.8)[..., None]
    return shadowed(0.4)(on, mask)[0] * (1 - share) + face[tuple(nearest)] * share


def before(name: str) -> Change:
    """Cut out and laid on a photograph that comes with scikit-image."""

    def change(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
        margin = int(0.3 * max(mask.shape))
        rgb = np.pad(rgb, ((margin, margin), (margin, margin), (0, 0))).astype(np.float32)
        mask = np.pad(mask, margin)
        pixels = read_pixels(Path(skimage.data.__file__).with_name(name))[..., :3]
        scale = 1.01 * max(there / side for there, side in zip(mask.shape, pixels.shape[:2], strict=True))
        behind = np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale), np.float32) / np.float32(255)
        return laid(behind[: mask.shape[0], : mask.shape[1]], rgb, mask), mask

    return change


def overlapping(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """Over its mirror image, by a fifth of its width, on the colour of the picture's border."""
    around = border_colour(rgb)
    rgb, mask = tight(rgb, mask)
    margin, width = int(0.2 * max(mask.shape)), mask.shape[1]
    rest = margin + width * 4 // 5
    left, right = ((margin, margin), (margin, rest)), ((margin, margin), (rest, margin))
    shown = np.broadcast_to(around, (*np.pad(mask, left).shape, 3)).astype(np.float32)
    for side, face, there in ((right, rgb[:, ::-1], mask[:, ::-1]), (left, rgb, mask)):
        shown = laid(shown, np.pad(face, (*side, (0, 0))), np.pad(there, side))
    return shown, np.pad(mask, left)


def among_others(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
    """Between eight smaller copies of it, turned and of other light and ripeness, that nearly touch it and cover all
    corners of the picture."""
    around = border_colour(rgb)
    rgb, mask = tight(rgb, mask)
    size = max(mask.shape)
    margins = [((size - side) // 2 + size // 20, (size - side + 1) // 2 + size // 20) for side in mask.shape]
    rgb, truth = np.pad(rgb, (*margins, (0, 0))), np.pad(mask, margins)
    shown = np.broadcast_to(around, rgb.shape).astype(np.float32)
    middle = np.array(truth.shape[::-1]) / 2
    for n in range(8):
        turn = cv2.getRotationMatrix2D(middle.tolist(), 50 * n, 0.62)
        turn[:, 2] += 0.84 * size * np.array([np.cos(n * np.pi / 4), np.sin(n * np.pi / 4)])
        both = (cv2.warpAffine(a, turn, truth.shape[::-1]) for a in (rgb, truth.astype(np.float32)))
        face, there = (np.asarray(a, np.float32) for a in both)
        shown = laid(shown, lit((1, 1 - 0.06 * n, 1 - 0.03 * n))(face, truth)[0], there > 0.5)
    return laid(shown, rgb, truth), truth


def with_whole(right: float, down: float) -> Change:
    """Before or beside a whole fruit, as shops show them: a ball as large as the face, in the colour of its skin, with
    its middle by fractions of the width `right` of the face's and `down`."""

    def change(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
        around = border_colour(rgb)
        rgb, mask = tight(rgb, mask)
        size = max(mask.shape)
        margins = [
            (round(0.2 * size + max(-shift, 0) * size), round(0.2 * size + max(shift, 0) * size))
            for shift in (down, right)
        ]
        skin = skin_colour(rgb, mask)
        face, truth = np.pad(rgb, (*margins, (0, 0))), np.pad(mask, margins)
        rows, columns = (
            axis - middle.mean() for axis, middle in zip(np.indices(truth.shape), np.nonzero(truth), strict=True)
        )
        x, y = 2 * columns / size - 2 * right, 2 * rows / size - 2 * down
        ball, there = whole_fruit(x, y, skin)
        shown = np.broadcast_to(around, face.shape).astype(np.float32)
        return laid(laid(shown, ball.astype(np.float32), there), face, truth), truth

    return change


def as_half(angle: float) -> Change:
    """On half a ball as wide as the face, in the colour of its skin, seen at this angle in degrees from above."""

    def change(rgb: Pixels, mask: Mask) -> tuple[Pixels, Mask]:
        around = border_colour(rgb)
        rgb, mask = tight(rgb, mask)
        skin, wide = skin_colour(rgb, mask), mask.shape[1]
        size = wide, max(round(mask.shape[0] * np.cos(np.radians(angle))), 2)
        face, there = (
            np.asarray(cv2.resize(a, size, interpolation=cv2.INTER_AREA), np.float32)
            for a in (rgb, mask.astype(np.float32))
        )
        margins = (wide // 5, wide), (wide // 5, wide // 5)
        face, truth = np.pad(face, (*margins, (0, 0))), np.pad(there, margins) > 0.5
        rows, columns = (
            axis - middle.mean() for axis, middle in zip(np.indices(truth.shape), np.nonzero(truth), strict=True)
        )
        ball, seen = whole_fruit(2 * columns / wide, 2 * rows / wide, skin)
        shown = np.broadcast_to(around, face.shape).astype(np.float32)
        return laid(laid(shown, ball.astype(np.float32), seen & (rows > 0)), face, truth), truth

    return change


def skin_colour(rgb: Pixels, mask: Mask) -> NDArray[np.float32]:
    """(3,). The median along the outline of a face."""
    rim = mask & ~ndimage.binary_erosion(mask, iterations=max(2, max(mask.shape) // 60))
    return np.asarray(np.median(rgb[rim], axis=0))


def border_colour(rgb: Pixels) -> NDArray[np.float32]:
    """(3,). The median of the outermost pixels."""
    return np.asarray(np.median(np.concatenate([rgb[0], rgb[-1], rgb[:, 0], rgb[:, -1]]), axis=0))


CHANGES: dict[str, Change] = {
    "as it is": lambda rgb, mask: (rgb, mask),
    "mirrored": lambda rgb, mask: (rgb[:, ::-1].copy(), mask[:, ::-1].copy()),
    "one stop darker": lit(0.5),
    "a third of a stop brighter": lit(1.26),
    "one stop brighter": lit(2.0),
    "20 % warmer": lit((1.1, 1.0, 0.8)),
    "20 % cooler": lit((0.8, 1.0, 1.1)),
    "light from a side": from_a_side,
    "dark corners": dimmed_corners,
    "shadow of 25 %": shadowed(0.25),
    "shadow of 50 %": shadowed(0.5),
    "shadow of 75 %": shadowed(0.75),
    "tight": tight,
    "wide": wide,
    "half as large": sized(0.5),
    "twice as large": sized(2),
    "leaning by 20 degrees": seen_at(20),
    "turned by 20 degrees": seen_at(0, 20),
    "out of focus": blurred,
    "JPEG of quality 25": compressed,
    "noise": noisy,
    "before bricks": before("brick.png"),
    "in a workshop": before("motorcycle_left.png"),
    "over another": overlapping,
    "among others": among_others,
    "before a whole one": with_whole(0.35, -0.4),
    "beside a whole one": with_whole(-1.15, -0.05),
    "on half a ball at 35 degrees": as_half(35),
    "on half a ball at 55 degrees": as_half(55),
}


def measured(rgb: Pixels, truth: Mask, family: str, change: Change) -> dict[str, Any]:
    """What was found in one changed photograph, beside its true mask and family."""
    rgb, truth = change(rgb, truth)
    try:
        face = find_seen_face(np.ascontiguousarray(rgb), "")
    except InputError:
        return {"refused": True}
    kind = guess_cut(rgb, face.mask).kind
    return {"overlap": round(mask_iou(face.mask, truth), 4), "told": bool(face.note), "kind_right": kind == family}


def main(arguments: list[str] | None = None) -> None:
    """Changes and measures a folder of photographs."""
    options, rows = parse_options(__doc__, arguments)

    def of_one(row: dict[str, str]) -> dict[str, dict[str, Any]]:
        with open_picture(options.photographs / row["path"]) as picture:
            white = Image.new("RGBA", picture.size, "white")
            white.alpha_composite(picture.convert("RGBA"))
        rgb = np.asarray(white.convert("RGB"), np.float32) / np.float32(255)
        truth = read_pixels(options.photographs / "masks" / row["path"])[..., 0] > 127
        return {name: measured(rgb, truth, row["family"], change) for name, change in CHANGES.items()}

    found = dict(zip([Path(row["path"]).stem for row in rows], side_by_side(of_one, rows), strict=True))
    print(f"{'change':28} {'good':>5} {'wrong':>6} {'refused':>8} {'kinds':>6} {'least':>6}")
    for name in CHANGES:
        faces = [photograph[name] for photograph in found.values()]
        kept = [face for face in faces if "overlap" in face]
        good = sum(face["overlap"] >= GOOD for face in kept)
        wrong = sum(face["overlap"] < WRONG and not face["told"] for face in kept)
        kinds, least = sum(face["kind_right"] for face in kept), min((face["overlap"] for face in kept), default=0)
        print(f"{name:28} {good:5} {wrong:6} {len(faces) - len(kept):8} {kinds:6} {least:6.3f}")
    out = out_folder(options)
    if out is not None:
        write_json(out / "changed_photographs.json", found)
        draw(found, out / "changed_photographs.png")


def draw(found: dict[str, dict[str, dict[str, Any]]], path: Path) -> None:
    """A row for each change, a point for each photograph."""
    figure, axes = plt.subplots(figsize=(9, 6), layout="constrained")
    names = list(CHANGES)
    for row, name in enumerate(names):
        faces = [photograph[name] for photograph in found.values()]
        for told, colour in ((False, ACCENT), (True, OTHER)):
            lacks = [1 - face["overlap"] for face in faces if face.get("told") == told]
            axes.scatter(np.maximum(lacks, 5e-4), np.full(len(lacks), row), s=14, color=colour, alpha=0.7, zorder=2)
        refused = sum("refused" in face for face in faces)
        if refused:
            axes.text(1.05, row, f"{refused} refused", va="center", fontsize=8)
    axes.axvline(1 - GOOD, color="#888", lw=0.8, zorder=1)
    axes.set(xscale="log", xlim=(4e-4, 1), xlabel="1 - overlap with the mask by hand")
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_title("Cut faces found in changed photographs; grey-blue: the user is told to look", fontsize=10)
    save_chart(figure, path)


if __name__ == "__main__":
    main()
