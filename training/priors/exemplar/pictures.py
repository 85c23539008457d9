"""Reads photographs of cut faces: takes the face alone and evens out the lighting."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from scipy import ndimage

from engine.errors import InputError
from engine.io.picture_file import in_srgb, open_picture
from engine.scene.image import to_8bit
from training.faces.axis import find_core
from training.faces.carrier import SeenFace, find_seen_face
from training.faces.completion import complete_face, is_cut_off
from training.faces.core_line import find_core_line, lean_of, line_ends
from training.faces.edges import largest_component
from training.faces.marks import UNMARKED, Marks, axis_beside, mask_beside, read_axis_file
from training.faces.polygon import polygon_mask
from training.families import Kind
from training.priors.exemplar.lighting import flatten_light

__all__ = ["Picture", "axis_of", "find_face", "make_picture", "read_photograph", "read_picture", "resolved_share"]

MAX_SIDE = 768
"""Longer side in pixels to which larger pictures are reduced: a solve on 256 voxels uses no more."""

MIN_SIDE = 24
"""Smallest width of a cut face in pixels; a smaller one holds no 7x7 patches worth copying."""

INVISIBLE_RMS = 1 / 255
"""RMS colour difference that an 8-bit screen cannot show."""

REGIONS = 16
"""Regions across a picture, small enough for a seed to count; the worst region decides."""

MIXED = 2
"""Pixels inside an outline that the lens mixes with the background."""

MIN_LEAN = 7.5
"""Least lean of a core line, in degrees, for the picture to be turned: people hold what they photograph upright, and in
12 photographs the search is wrong by up to 2.1 degrees, in one by 5.0, in solids of our own with a striped rind by
5."""

BESIDE = "its core lies beside the cut face; mark the core, or the outline"

CUT_OFF = (
    "the picture's border cuts the cut face off, and what is seen of it is taken for the whole; give a picture that "
    "shows all of it, or at least three quarters of a round one"
)
"""Note of a face that `complete_face` does not complete; one that is searched for is refused instead."""

MIN_TRANSPARENT = 0.005
"""Least transparent fraction of a picture for its alpha channel to be a cut-out: many opaque pictures have an alpha
channel, with a few stray pixels in it."""


@dataclass(frozen=True)
class Picture:
    """A photographed cut face and its mask."""

    path: Path
    rgb: NDArray[np.float32]
    """(H, W, 3). Range [0, 1]; outside the mask the nearest colour inside."""
    mask: NDArray[np.bool_]
    """(H, W). The cut face."""
    core: tuple[float, float] | None = None
    """(x, y) in pixels. The point that belongs on the body's axis: the core of a horizontal cut; in a radial cut, the
    point of the user's line that is level with the face's middle. None: the middle itself."""
    note: str = ""
    """What the user should check in the face that was found, in a line; empty if nothing."""

    @property
    def proportions(self) -> float:
        """Width over height of the cut face, by standard deviations, which bumps and stalks hardly change."""
        rows, columns = np.nonzero(self.mask)
        return float(columns.std() / rows.std())


def read_picture(path: str | Path, kind: Kind, marks: Marks = UNMARKED) -> Picture:
    """Reads a photograph of a cut face of one kind of family.

    The face is given by the outline in `marks`, or else by a mask file beside the photograph (`mask_beside`), or else
    by its alpha channel; without any it is searched for. So is the axis, unless it is in `marks` or in a file
    (`axis_beside`). A radial cut that leans is turned upright. Raises InputError if a file cannot be read or no cut
    face stands out.
    """
    path = Path(path)
    marks = _with_axis_file(marks, path)
    rgb, face = find_face(path, marks)
    picture = make_picture(path, rgb, face.mask, kind, marks)
    return replace(picture, note=face.note or picture.note)


def make_picture(path: Path, rgb: NDArray[np.float32], mask: NDArray[np.bool_], kind: Kind, marks: Marks) -> Picture:
    """The face (H, W, 3), (H, W) of a photograph cut out and turned, as `read_picture` does it, with the axis in
    `marks`. Raises InputError if it is too small."""
    core, size = None, mask.shape[::-1]
    rgb, mask, added = complete_face(rgb, mask, kind == "radial")
    note = CUT_OFF if kind in ("horizontal", "radial") and is_cut_off(mask) else ""
    if kind == "radial" and mask.any():
        if marks.line is not None:
            rgb, mask, core = _upright(rgb, mask, np.array(marks.line) * size + added)
        elif lean := _believed_lean(rgb, mask):
            rgb, mask = _turned(rgb, mask, lean)
    elif kind == "horizontal" and mask.any():
        core = find_core(mask)
        if marks.core is not None:
            core = marks.core[0] * size[0] + added[0], marks.core[1] * size[1] + added[1]
    rows, columns = np.nonzero(mask)
    if len(rows) == 0 or min(np.ptp(rows), np.ptp(columns)) + 1 < MIN_SIDE:
        raise InputError(
            f"{path}: the cut face is smaller than {MIN_SIDE} pixels; give a larger picture, or one where the "
            "cut face stands out from a plain background"
        )
    if core is not None and not _surrounds(mask, core):
        note = note or BESIDE
    margin = 2 + round(0.03 * max(np.ptp(rows), np.ptp(columns)))
    mask, rgb = (_crop(a, rows, columns, margin) for a in (mask, rgb))
    if core is not None:
        core = core[0] - float(columns.min()) + margin, core[1] - float(rows.min()) + margin
    return Picture(path, fill_outside(flatten_light(rgb, mask, kind), mask), mask, core, note)


def _surrounds(mask: NDArray[np.bool_], point: tuple[float, float]) -> bool:
    """Whether a point (x, y) in pixels lies in a mask or in one of its holes."""
    x, y = math.floor(point[0]), math.floor(point[1])
    height, width = mask.shape
    return 0 <= x < width and 0 <= y < height and bool(ndimage.binary_fill_holes(mask)[y, x])


def _with_axis_file(marks: Marks, path: Path) -> Marks:
    """The marks, with an axis that they lack taken from the file beside the photograph, if there is one."""
    beside = axis_beside(path)
    if beside is None:
        return marks
    found = read_axis_file(beside)
    return replace(marks, core=marks.core or found.core, line=marks.line or found.line)


def find_face(path: Path, marks: Marks = UNMARKED) -> tuple[NDArray[np.float32], SeenFace]:
    """(H, W, 3) a photograph's colours in [0, 1], at most MAX_SIDE pixels long, and its cut face.

    Raises InputError as `read_picture`.
    """
    rgb, cut_out = read_photograph(path)
    if marks.outline is not None:
        cut_out = polygon_mask(marks.outline, *rgb.shape[:2])
    return rgb, find_seen_face(rgb, path) if cut_out is None else SeenFace(largest_component(cut_out))


def axis_of(rgb: NDArray[np.float32], mask: NDArray[np.bool_], kind: Kind) -> Marks:
    """The axis by which the face (H, W, 3), (H, W) of a picture without marks is placed; a slice has none."""
    size = mask.shape[::-1]
    if not mask.any() or kind not in ("horizontal", "radial"):
        return UNMARKED
    rgb, mask, added = complete_face(rgb, mask, kind == "radial")
    found = np.array([find_core(mask)])
    if kind == "radial":
        lean = math.radians(_believed_lean(rgb, mask))
        found = line_ends(mask, found[0], np.array([-math.sin(lean), math.cos(lean)]))
    places = [(float(x), float(y)) for x, y in np.clip((found - added) / size, 0, 1)]
    return Marks(core=places[0]) if kind == "horizontal" else Marks(line=(places[0], places[1]))


def resolved_share(picture: Picture) -> float:
    """The smallest scale at which the cut face keeps its detail: below, some region changes by over INVISIBLE_RMS.

    1 for a sharp picture, less for one that was enlarged, is out of focus or shows little. Range (0, 1].
    """
    rows, columns = np.nonzero(picture.mask)
    longer = max(np.ptp(rows), np.ptp(columns)) + 1
    # Pixels at the edge mix with the background at any scale.
    core = ndimage.binary_erosion(picture.mask, iterations=2 * MIXED, border_value=0)
    share = 1.0
    while share * longer > MIN_SIDE:
        coarser = share / 2**0.25
        wrong = np.where(core, np.square(_resample(picture.rgb, coarser) - picture.rgb).mean(axis=-1), 0)
        if ndimage.uniform_filter(wrong, max(round(longer / REGIONS), 1)).max() > INVISIBLE_RMS**2:
            break
        share = coarser
    return share


def _resample(rgb: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """(H, W, 3). The picture reduced to this scale and enlarged again."""
    height, width = rgb.shape[:2]
    size = max(round(width * share), 1), max(round(height * share), 1)
    channels = (Image.fromarray(np.ascontiguousarray(rgb[..., c])) for c in range(3))
    sharp = Image.Resampling.LANCZOS  # other filters remove detail that the smaller picture could hold
    return np.stack([np.asarray(c.resize(size, sharp).resize((width, height), sharp)) for c in channels], axis=-1)


def fill_outside(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W, 3). The picture with every pixel outside the mask replaced by the nearest one inside.

    The outermost rings of the mask do not count as inside: they are up to half background.
    """
    core = ndimage.binary_erosion(mask, iterations=MIXED, border_value=0)
    core = core if core.any() else mask
    nearest = ndimage.distance_transform_edt(~core, return_distances=False, return_indices=True)
    return rgb[nearest[0], nearest[1]]


def _believed_lean(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """Lean of the core line that is found, in degrees; 0 below MIN_LEAN. Its shift from the middle of the face is not
    believed: moving an outline bends it, and with the line of an orange's picture the SSIM of its own plane fell from
    0.67 to 0.48."""
    lean = lean_of(find_core_line(rgb, mask).ends)
    return lean if abs(lean) >= MIN_LEAN else 0.0


def _upright(
    rgb: NDArray[np.float32], mask: NDArray[np.bool_], line: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_], tuple[float, float]]:
    """The picture turned so that a line (2, 2) in it is upright, its mask, and the point of the line level with the
    middle of the face."""
    lean = lean_of(line)
    turned, turned_mask = _turned(rgb, mask, lean)
    rows = np.nonzero(turned_mask)[0]
    middle = float(rows.mean()) + 0.5 if len(rows) else 0.0
    # A counter-clockwise turn, as seen, about the middle of the picture.
    x, y = line.mean(0) - np.array(mask.shape[::-1]) / 2
    across = x * math.cos(math.radians(lean)) + y * math.sin(math.radians(lean))
    return turned, turned_mask, (across + turned_mask.shape[1] / 2, middle)


def _turned(
    rgb: NDArray[np.float32], mask: NDArray[np.bool_], lean: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A picture and its mask turned counter-clockwise by an angle in degrees, enlarged to hold all of it."""
    filled = np.pad(fill_outside(rgb, mask), ((1, 1), (1, 1), (0, 0)), mode="edge")
    turned = ndimage.rotate(filled, lean, order=1, mode="nearest")
    return turned, ndimage.rotate(np.pad(mask, 1).astype(np.float32), lean, order=1) > 0.5


def _crop(a: NDArray, rows: NDArray, columns: NDArray, margin: int) -> NDArray:
    """The bounding box of the cut face with a margin of repeated edge pixels (False for a mask)."""
    box = a[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    around = [(margin, margin)] * 2 + [(0, 0)] * (a.ndim - 2)
    return np.pad(box, around, mode="constant" if a.dtype == bool else "edge")


def read_photograph(path: Path) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """(H, W, 3) colours in [0, 1], at most MAX_SIDE pixels long, and (H, W) the cut-out that comes with them, if any.

    Raises InputError if the file is no picture, or too small.
    """
    with open_picture(path) as opened:
        image = ImageOps.exif_transpose(opened)
        if image.mode[:1] in "IF":  # 16 and 32 bits of grey
            values = np.nan_to_num(np.asarray(image, np.float64), posinf=0, neginf=0)
            top = 65535.0 if values.max(initial=0) > 255 else max(1.0, float(values.max(initial=0)))
            image = Image.fromarray(to_8bit(values / top))
        if image.has_transparency_data and image.mode != "RGBA":
            image = image.convert("RGBA")
        if image.mode in ("1", "P"):  # in these, nothing is blended when a picture is made smaller
            image = image.convert("RGB")
        if min(image.size) < MIN_SIDE:
            raise InputError(f"{path}: only {image.width}x{image.height} pixels; give a larger picture")
        cut_out = _read_mask(path, image.size)
        if cut_out is None and image.mode == "RGBA":
            alpha = image.getchannel("A")
            cut_out = alpha if (np.asarray(alpha) < 128).mean() >= MIN_TRANSPARENT else None
        if max(image.size) > MAX_SIDE:
            image.thumbnail((MAX_SIDE, MAX_SIDE), Image.Resampling.LANCZOS)
            cut_out = cut_out and cut_out.resize(image.size, Image.Resampling.LANCZOS)
        if min(image.size) < MIN_SIDE:
            raise InputError(f"{path}: too narrow, {image.width}x{image.height} pixels when scaled down; crop it")
        mask = None if cut_out is None else np.asarray(cut_out) > 127
        return np.asarray(in_srgb(image).convert("RGB"), np.float32) / np.float32(255), mask


def _read_mask(path: Path, size: tuple[int, int]) -> Image.Image | None:
    """The mask file of a photograph as 8 bits of grey, None if there is none. Raises InputError for another size."""
    beside = mask_beside(path)
    if beside is None:
        return None
    with open_picture(beside) as opened:
        mask = ImageOps.exif_transpose(opened).convert("L")
    if mask.size != size:
        raise InputError(
            f"{beside}: {mask.width}x{mask.height} pixels, but {path.name} has {size[0]}x{size[1]}; "
            "make the mask as large as the photograph, white where the cut face is"
        )
    return mask
