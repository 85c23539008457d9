"""Films of `fruitninja-render`: what was asked for, and the frames of it in one file or in a folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.jobs.export import ANIMATIONS, RATE, save_animation
from app.jobs.film.frame_folder import save_frames
from app.model.camera_control import OrbitCamera
from app.model.film.motion import Film, Keyframe, frame_count, frames, placed, seen
from app.model.film.presets import explode, sweep, turntable
from app.model.film.record import LONGEST, film_record, read_film
from app.model.pieces import Solid
from app.model.rigid_transform import Vec3, vec3
from engine.errors import InputError
from engine.io.files import read_file
from engine.io.trained import sidecar_path
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, fit_distance
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["Scene", "Wanted", "make_film", "save_film"]

PRESETS = ("turntable", "sweep", "explode")

SECONDS = 6.0
"""Of a film: slow enough to look at what turns by."""

FASTEST, FASTEST_GIF = 120.0, 50.0
"""Frames a second: of screens, and of GIFs, which count in hundredths; browsers show one of 1/100 s for 1/10 s."""

SIDECAR_LIMIT = 1 << 24
"""Bytes of a sidecar that is read for its hash; a real one has some KB."""

Shot = Callable[[Camera, Sequence[Piece]], NDArray[np.uint8]]
"""Draws pieces as (H, W, 4)."""


@dataclass(frozen=True)
class Scene:
    """What is filmed, and from where."""

    trained: Path
    """The file of the solid."""
    atoms: Atoms
    up: Vec3
    view: tuple[float, float, float]
    """Azimuth, elevation in degrees, distance in those that fit the object into the picture; a preset begins there."""
    size: tuple[int, int]
    """Width, height in pixels."""


@dataclass(frozen=True)
class Wanted:
    """A film as the options have it."""

    name: str
    """One of PRESETS, or none of them for `keyframes`."""
    planes: tuple[Plane, ...]
    seconds: float
    rate: float
    """Frames a second."""
    keyframes: Film | None = None


def make_film(
    name: str,
    out: Path,
    planes: tuple[Plane, ...],
    has_camera: bool,
    seconds: float | None,
    rate: float | None,
    transparent: bool,
) -> Wanted:
    """What the options ask for. Raises InputError where they do not fit one another, or for a bad file of keyframes."""
    suffix = out.suffix.lower()
    if suffix and suffix not in ANIMATIONS:
        raise InputError(f"{out}: a film is saved as {', '.join(ANIMATIONS)}, or as PNGs in a folder without a suffix")
    if transparent and suffix in (".gif", ".mp4"):
        raise InputError(f"{out}: {suffix} has no transparency; choose .webp or a folder, or another --background")
    fps = RATE if rate is None else rate
    fastest = FASTEST_GIF if suffix == ".gif" else FASTEST
    if not 0.1 <= fps <= fastest:
        raise InputError(f"--fps {fps:g}: give a number from 0.1 to {fastest:g}")
    if name not in PRESETS:
        if not name.endswith(".json"):
            raise InputError(f"--film {name}: give {', '.join(PRESETS)}, or a file of keyframes that ends in .json")
        if planes or has_camera or seconds is not None:
            raise InputError(f"{name}: keyframes have planes, camera and times of their own; leave the options out")
        return Wanted(name, (), 0.0, fps, read_film(Path(name)))
    length = SECONDS if seconds is None else seconds
    if not (math.isfinite(length) and 0.1 <= length <= LONGEST):
        raise InputError(f"--seconds {length:g}: give a number from 0.1 to {LONGEST:g}")
    if name == "explode" and not planes:
        raise InputError("--film explode: give the planes that part the pieces, as in --plane 0,0,1,0 --plane 1,0,0,0")
    return Wanted(name, planes, length, fps)


def save_film(out: Path, wanted: Wanted, scene: Scene, shot: Shot, settings: dict[str, str]) -> str:
    """Saves a film and returns, in words, how many frames it has; `settings`: what else decides how frames look."""
    solid = Solid.of_atoms(scene.atoms)
    film = film_of(wanted, scene, solid)
    count = frame_count(film.seconds, wanted.rate)
    aspect = scene.size[0] / scene.size[1]
    eye = OrbitCamera(target=vec3(solid.centre))
    eye = replace(eye, distance=fit_distance(solid.radius + scene.atoms.pitch, math.radians(eye.fov), aspect))
    has_alpha = bool(out.suffix) or settings["background"] == "transparent"  # what animations are written from has it

    def draw(shown: Keyframe) -> NDArray[np.uint8]:
        rgba = shot(seen(eye, shown).camera(*scene.size, scene.up), placed(film, shown, solid))
        return rgba if has_alpha else rgba[..., :3]

    keys = frames(film, count, solid.centre)
    if out.suffix:
        save_animation(out, map(draw, keys), wanted.rate)
        return f"{count} frames"
    record = {
        **settings,
        "solid": sha256(read_file(sidecar_path(scene.trained), SIDECAR_LIMIT)).hexdigest(),  # has checksums of the rest
        "size": list(scene.size),
        "frames": count,
        "film": film_record(film),
    }
    new = save_frames(out, record, (partial(draw, shown) for shown in keys))
    return f"{count} frames, {new} of them new,"


def film_of(wanted: Wanted, scene: Scene, solid: Solid) -> Film:
    """The keyframes of a film."""
    if wanted.keyframes is not None:
        return wanted.keyframes
    azimuth, elevation, distance = scene.view
    start = Keyframe(0.0, azimuth, max(-90.0, min(90.0, elevation)), 1 / distance)
    if wanted.name == "explode":
        return explode(start, wanted.seconds, wanted.planes)
    if wanted.name == "turntable":
        return turntable(replace(start, planes=wanted.planes), wanted.seconds)
    # Without a plane a horizontal one, from above.
    moving = wanted.planes[0] if wanted.planes else Plane.of(scene.up, 0.0)
    return sweep(replace(start, planes=wanted.planes[1:]), wanted.seconds, moving, solid.points)
