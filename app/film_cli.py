"""Films of `fruitninja-render`: checks what was asked for, and writes the frames to one file or to a folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.jobs.export import ANIMATIONS, FASTEST_GIF, RATE, save_animation
from app.jobs.film.frame_folder import save_frames
from app.jobs.film.project_film import Filmed, Shooting, save_project_film
from app.jobs.results import find_result
from app.model.camera_control import OrbitCamera
from app.model.film.motion import Film, Keyframe, frame_count, frames, placed, seen
from app.model.film.presets import explode, sweep, turntable
from app.model.film.record import LONGEST, film_record, read_film
from app.model.film.timeline import FilmLook
from app.model.pieces import PointSample
from app.model.project import SUFFIX, load_project
from app.model.rigid_transform import Vec3, vec3
from app.model.settings import load_settings
from engine.errors import InputError
from engine.io.files import read_file
from engine.io.trained import is_trained, load_trained, sidecar_path
from engine.render.face_detail import Detailed
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, fit_distance
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from training.priors.inside_file import read_inside

__all__ = ["FilmOptions", "Scene", "film_project", "is_project", "make_film", "save_film"]

PRESETS = ("turntable", "sweep", "explode")

PLAIN = (1.0, 1.0, 1.0)
"""RGB of the background if the project uses that of the window's theme, since there is no theme here."""

SECONDS = 6.0
"""Default length of a film: slow enough to see what turns past."""

FASTEST = 120.0
"""Most frames a second: those of fast screens."""

SIDECAR_LIMIT = 1 << 24
"""Bytes of the largest sidecar that is read for its hash; a real one has a few KB."""

Shot = Callable[[Camera, Sequence[Piece]], NDArray[np.uint8]]
"""Draws pieces as a picture (H, W, 4)."""


@dataclass(frozen=True)
class Scene:
    """What is filmed, and from where."""

    trained: Path
    """The file of the solid."""
    atoms: Atoms
    up: Vec3
    view: tuple[float, float, float]
    """Azimuth and elevation in degrees, and distance as a multiple of that which fits the object into the picture. A
    preset begins there."""
    size: tuple[int, int]
    """Width, height in pixels."""


@dataclass(frozen=True)
class FilmOptions:
    """A film as the options ask for it."""

    name: str
    """One of PRESETS, or the name of the file that `keyframes` are from."""
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
) -> FilmOptions:
    """The film that the options ask for. Raises InputError for contradictory options or a bad file of keyframes."""
    fps = RATE if rate is None else rate
    _check_form(out, fps, transparent)
    if name not in PRESETS:
        if not name.endswith(".json"):
            raise InputError(f"--film {name}: give {', '.join(PRESETS)}, or a file of keyframes that ends in .json")
        if planes or has_camera or seconds is not None:
            raise InputError(f"{name}: keyframes have planes, camera and times of their own; leave the options out")
        return FilmOptions(name, (), 0.0, fps, read_film(Path(name)))
    length = SECONDS if seconds is None else seconds
    if not (math.isfinite(length) and 0.1 <= length <= LONGEST):
        raise InputError(f"--seconds {length:g}: give a number from 0.1 to {LONGEST:g}")
    if name == "explode" and not planes:
        raise InputError("--film explode: give the planes that part the pieces, as in --plane 0,0,1,0 --plane 1,0,0,0")
    return FilmOptions(name, planes, length, fps)


def _check_form(out: Path, fps: float, transparent: bool) -> None:
    """Raises InputError if a film cannot be saved in this form."""
    suffix = out.suffix.lower()
    if suffix and suffix not in ANIMATIONS:
        raise InputError(f"{out}: a film is saved as {', '.join(ANIMATIONS)}, or as PNGs in a folder without a suffix")
    if transparent and suffix in (".gif", ".mp4"):
        raise InputError(f"{out}: {suffix} has no transparency; choose .webp or a folder, or another --background")
    fastest = FASTEST_GIF if suffix == ".gif" else FASTEST
    if not 0.1 <= fps <= fastest:
        raise InputError(f"{out}: {fps:g} frames a second; give --fps a number from 0.1 to {fastest:g}")


def is_project(path: Path) -> bool:
    """Whether a file is a project of the window, judged by its name."""
    return path.suffix == SUFFIX


def film_project(
    path: Path,
    out: Path,
    size: tuple[int, int] | None,
    fps: float | None,
    background: tuple[Vec3 | None] | None,
    drawn: Callable[[float], None],
) -> str:
    """Saves the film of one of the window's projects, with all objects that have an inside, and returns the number and
    size of its frames in words. `size`, `fps`, `background`: None for the project's own. `drawn` is called with the
    part that is drawn. Raises InputError if there is no film, or if it cannot be saved."""
    project = load_project(path, outside=load_settings().trusts(path))
    if len(project.film.keyframes) < 2:
        raise InputError(f"{path}: this project has no film; keep two keyframes in the window, and save it")
    kept = project.viewing.film
    look = FilmLook(size or kept.size, kept.rate if fps is None else fps)
    own = {"window": project.viewing.background or PLAIN, "white": PLAIN, "black": (0.0, 0.0, 0.0), "transparent": None}
    (ground,) = background or (own.get(kept.background, kept.colour),)
    _check_form(out, look.rate, ground is None)
    objects: dict[int, Filmed] = {}
    sources, up = [path], None
    for document in project.documents:
        found = find_result(document)
        if found is None and document.scene is not None and is_trained(document.scene):
            found = document.scene
        if found is None:
            continue
        atoms, meta = load_trained(found)
        inside = read_inside(found)
        objects[document.number] = Filmed(atoms, None if inside is None else Detailed(inside, atoms.pitch))
        sources.append(sidecar_path(found))  # holds checksums of the other files
        up = up or document.up or meta.up
    if up is None:
        raise InputError(f"{path}: none of its objects has an inside; train one in the window first")
    count = save_project_film(out, project, objects, Shooting(look, ground, up, light=True), sources, drawn)
    return f"{count} frames of {look.size[0]}x{look.size[1]}"


def save_film(out: Path, wanted: FilmOptions, scene: Scene, shot: Shot, settings: dict[str, str]) -> str:
    """Saves a film and returns the number of its frames in words. `settings`: all else that decides how frames look."""
    solid = PointSample.of_atoms(scene.atoms)
    film = film_of(wanted, scene, solid)
    count = frame_count(film.seconds, wanted.rate)
    aspect = scene.size[0] / scene.size[1]
    eye = OrbitCamera(target=vec3(solid.centre))
    eye = replace(eye, distance=fit_distance(solid.radius + scene.atoms.pitch, math.radians(eye.fov), aspect))
    has_alpha = bool(out.suffix) or settings["background"] == "transparent"  # animations are written from RGBA frames

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


def film_of(wanted: FilmOptions, scene: Scene, solid: PointSample) -> Film:
    """The keyframes of a film."""
    if wanted.keyframes is not None:
        return wanted.keyframes
    azimuth, elevation, distance = scene.view
    start = Keyframe(0.0, azimuth, max(-90.0, min(90.0, elevation)), 1 / distance)
    if wanted.name == "explode":
        return explode(start, wanted.seconds, wanted.planes)
    if wanted.name == "turntable":
        return turntable(replace(start, planes=wanted.planes), wanted.seconds)
    # By default a horizontal plane sweeps, from above.
    moving = wanted.planes[0] if wanted.planes else Plane.of(scene.up, 0.0)
    return sweep(replace(start, planes=wanted.planes[1:]), wanted.seconds, moving, solid.points)
