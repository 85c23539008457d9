"""Exports for other programs: pictures, animations and pieces. A function that is passed in draws the pictures."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from app.model.measure.units import Unit, round_length
from app.model.pieces import PlacedPiece, PointSample
from app.model.rigid_transform import Vec3
from engine.errors import InputError
from engine.export.body import body_of
from engine.export.colours import Colours
from engine.export.kinds import IN_METRES
from engine.io.files import atomic
from engine.io.writers.provenance import Provenance
from engine.io.writers.solid_gaussians import joined, piece_gaussians
from engine.io.writers.splats import write_splats
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, section
from engine.scene.moved import moved
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = [
    "ANIMATIONS",
    "FASTEST_GIF",
    "RATE",
    "STILLS",
    "Draw",
    "ffmpeg",
    "save_animation",
    "save_meshes",
    "save_pieces",
    "save_still",
    "scale_bar",
    "section_picture",
]

Draw = Callable[[Camera, Sequence[Piece]], NDArray[np.uint8]]
"""Draws pieces as an RGBA picture (H, W, 4) with straight alpha."""

STILLS = (".png", ".webp", ".jpg", ".jpeg")
ANIMATIONS = (".webp", ".gif", ".mp4")

COARSE = 256
"""Pixels along a side of the small picture in which a cut face is located before it is drawn large."""

SLICE_RADII = 0.02
"""Thickness of the slice that is drawn to show a cut face, in radii of the object."""

SCALE_RGB = (128, 128, 128)
"""Colour of the scale bar: readable on white, and on black behind a transparent picture."""

RATE = 25
"""Default frames a second: as smooth as cinema film, in half the file size of a higher rate."""

FASTEST_GIF = 50.0
"""Most frames a second of a GIF, which counts in 1/100 s; browsers show a frame of 1/100 s for 1/10 s."""

MOST_BYTES = 3 << 30
"""Most bytes of the frames of a WebP or GIF, all of which are in memory: what a machine with 8 GB can spare."""

PALETTE_FRAMES = 8
"""Frames that the palette of a GIF is made from: a sweep begins with skin alone and shows the flesh later."""

Frames = Iterable[NDArray[np.uint8]]


def save_still(path: Path, rgba: NDArray[np.uint8], transparent: bool = True) -> None:
    """Saves a picture (H, W, 4) as PNG, WebP or JPEG, by the path's suffix. Raises InputError for any other."""
    suffix = path.suffix.lower()
    if suffix not in STILLS:
        raise InputError(f"{path}: pictures are saved as .png, .webp or .jpg")
    image = Image.fromarray(rgba, "RGBA")
    if not transparent or suffix in (".jpg", ".jpeg"):
        image = image.convert("RGB")
    with atomic(path) as temporary:
        image.save(temporary)


def section_picture(
    draw: Draw, plane: Plane, uncut: Piece, up: Vec3, solid: PointSample, size: int, unit: Unit
) -> NDArray[np.uint8]:
    """(H, W, 4). The cut face of the object `uncut`, seen straight on, with a scale bar in the user's `unit` below and
    nothing else around.

    The face fills the picture: its longer side is `size` pixels less a margin. Raises InputError if the plane misses
    the object.
    """
    bounds = np.stack([solid.points.min(0), solid.points.max(0)]) if len(solid.points) else np.zeros((2, 3))
    # A thin slice, since parts of the object that bulge out behind the face would be seen around it.
    behind = Plane(plane.flipped().normal, -plane.offset - SLICE_RADII * solid.radius)
    slice_ = [replace(uncut, planes=(plane, behind))]
    camera = section(plane, np.asarray(up), bounds, COARSE)
    rows, columns = (np.flatnonzero((draw(camera, slice_)[..., 3] > 127).any(axis)) for axis in (1, 0))
    if not len(rows):
        raise InputError("This plane does not meet the object, so that there is no face to save.")
    ends = np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]], float)
    margin = max(4, round(0.02 * size))
    zoom = (size - 2 * margin) / float(np.ptp(ends, axis=0).max())
    width, height = (round(zoom * side) + 2 * margin for side in np.ptp(ends, axis=0))
    cx, cy = (np.array([camera.cx, camera.cy]) - ends.mean(0)) * zoom + (width / 2, height / 2)
    scale = camera.fx * zoom
    close = replace(camera, fx=scale, fy=scale, cx=float(cx), cy=float(cy), width=width, height=height)
    return np.concatenate([draw(close, slice_), scale_bar(width, scale, unit)])


def scale_bar(width: int, scale: float, unit: Unit) -> NDArray[np.uint8]:
    """(H, width, 4). A bar of a length that is round in the user's `unit`. `scale`: pixels per unit of the file."""
    scale /= unit.length
    length = round_length(0.4 * width / scale)
    line = max(2, width // 300)
    text = max(11, width // 40)
    image = Image.new("RGBA", (width, 2 * text + 2 * line))
    pen, left, bottom = ImageDraw.Draw(image), max(4, round(0.02 * width)), text // 2 + 2 * line
    right = left + round(length * scale)
    pen.rectangle((left, bottom - line, right, bottom - 1), fill=SCALE_RGB)
    for x in (left, right - line):
        pen.rectangle((x, bottom - 3 * line, x + line, bottom - 1), fill=SCALE_RGB)
    place = (right + text // 2, bottom)
    pen.text(place, f"{length:g} {unit.name}", fill=SCALE_RGB, font=ImageFont.load_default(text), anchor="ls")
    return np.asarray(image)


def ffmpeg() -> str | None:
    """Path of ffmpeg, which writes MP4; None if it is not installed."""
    return shutil.which("ffmpeg")


def save_animation(path: Path, frames: Frames, rate: float = RATE) -> int:
    """Saves frames (H, W, 4), `rate` a second, as WebP, GIF or MP4, by the path's suffix; returns their number.

    GIF and MP4 have no partial transparency, so frames are blended onto white. Raises InputError for any other
    suffix, for MP4 without ffmpeg, if there are no frames, and for a WebP or GIF that does not fit into memory.
    """
    suffix = path.suffix.lower()
    if suffix not in ANIMATIONS:
        raise InputError(f"{path}: animations are saved as {', '.join(ANIMATIONS)}")
    if suffix == ".mp4":
        return _save_mp4(path, frames, rate)
    images: list[Image.Image] = []
    size = 0
    for frame in frames:
        images.append(Image.fromarray(frame if suffix == ".webp" else _blended(frame)))
        size += frame.nbytes
        if size > MOST_BYTES:
            raise InputError(f"{path}: too long or too large for {suffix}; choose .mp4, or a smaller size")
    if not images:
        raise InputError(f"{path}: nothing to animate")
    if suffix == ".gif":
        # One palette for all frames, so that still parts do not flicker.
        palette = _palette(images)
        images = [image.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG) for image in images]
    unit = 10 if suffix == ".gif" else 1  # milliseconds in which a format tells how long a frame is shown

    def frame_end(n: int) -> int:
        return unit * round(n * 1000 / rate / unit)

    with atomic(path) as temporary:
        images[0].save(
            temporary,
            format=suffix[1:].upper(),
            save_all=True,
            append_images=images[1:],
            duration=[frame_end(n + 1) - frame_end(n) for n in range(len(images))],
            loop=0,
            quality=85,
        )
    return len(images)


def _palette(images: Sequence[Image.Image]) -> Image.Image:
    """A palette image with the 255 colours that best suit a sample of the pictures, which all have the same size."""
    step = -(-len(images) // PALETTE_FRAMES)
    some = np.concatenate([np.asarray(image) for image in images[::step]])
    return Image.fromarray(some).quantize(255, dither=Image.Dither.NONE)


def _save_mp4(path: Path, frames: Frames, rate: float) -> int:
    program = ffmpeg()
    if program is None:
        raise InputError(f"{path}: MP4 needs ffmpeg, which is not installed; choose .webp or .gif")
    count = 0
    writer: subprocess.Popen[bytes] | None = None
    with atomic(path) as temporary, tempfile.TemporaryFile() as errors:
        try:
            for frame in frames:
                rgb = _blended(frame)
                rgb = rgb[: len(rgb) // 2 * 2, : rgb.shape[1] // 2 * 2]  # the codec's chroma needs even sides
                if writer is None:
                    size = f"{rgb.shape[1]}x{rgb.shape[0]}"
                    command = [program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size]
                    command += ["-r", f"{rate:g}", "-i", "-", "-pix_fmt", "yuv420p", "-crf", "18", str(temporary)]
                    writer = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=errors)
                assert writer.stdin is not None
                writer.stdin.write(np.ascontiguousarray(rgb).tobytes())
                count += 1
            if writer is None:
                raise InputError(f"{path}: nothing to animate")
            writer.communicate()
        except BrokenPipeError:  # ffmpeg has failed; its output says why
            assert writer is not None
            writer.wait()
        finally:
            if writer is not None and writer.poll() is None:
                writer.kill()  # the user has cancelled
                writer.wait()
        if writer.returncode:
            errors.seek(0)
            last = errors.read().decode("utf-8", "replace").strip().splitlines()[-1:]
            raise InputError(f"{path}: ffmpeg could not write it ({' '.join(last) or 'it gave no reason'})")
    return count


def _blended(rgba: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W, 3). A picture with straight alpha, blended onto white."""
    alpha = rgba[..., 3:].astype(np.float32) / 255
    return (rgba[..., :3] * alpha + 255 * (1 - alpha) + 0.5).astype(np.uint8)


def save_pieces(
    path: Path, pieces: Sequence[tuple[Atoms, PlacedPiece]], up: Vec3 = (0.0, 0.0, 1.0), metres: float = 1.0
) -> int:
    """Saves pieces, each given with the atoms of its object, as one file of Gaussians in the format of its suffix;
    returns the number of Gaussians. `metres`: length of a world unit, for formats that are in metres. Raises InputError
    if there are none."""
    gaussians = joined([piece_gaussians(atoms, piece.drawn()) for atoms, piece in pieces]) if pieces else None
    if gaussians is None or not len(gaussians):
        raise InputError(f"{path}: nothing to save; no piece is shown")
    if metres != 1 and path.suffix.lower() in IN_METRES:
        gaussians = moved(gaussians, np.eye(3), factor=metres)
    write_splats(path, gaussians, Provenance(up))
    return len(gaussians)


def save_meshes(
    path: Path, pieces: Sequence[PlacedPiece], colours: Colours, up: Vec3, metres: float, wanted: Callable[[], bool]
) -> int:
    """Saves pieces of an object, where they are placed, as closed meshes with textured cut faces in one file in the
    format of its suffix; returns the number of triangles.

    `up`: the view's up axis. `metres`: length of a world unit. `wanted`: whether the user still wants the file; if not,
    nothing is written. Raises InputError if there are no pieces, or without the packages that this needs.
    """
    from engine.export.meshes.cutting import MeshOptions
    from engine.export.meshes.files import save_mesh
    from engine.export.meshes.textured import textured_pieces

    # Names for objects in other programs: a single word each, and all different.
    wanted_pieces = [
        MeshOptions(
            f"{'_'.join(re.findall(r'[A-Za-z0-9]+', piece.name)) or 'piece'}_{number}",
            tuple(cell.planes for cell in piece.cells),
            piece.motion.matrix,
        )
        for number, piece in enumerate(pieces, 1)
    ]
    made = textured_pieces(body_of(colours.atoms, str(path)), colours, wanted_pieces, None, str(path))
    if wanted():
        save_mesh(path, made, up, metres)
    return sum(len(piece.triangles) for piece in made.pieces)
