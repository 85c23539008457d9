"""A solid object, whole or the part that planes leave of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from engine.errors import InputError
from engine.export.body import body_of
from engine.export.colours import Colours
from engine.export.kinds import Export, write_export
from engine.export.page.page import PAGES, PageView, write_page
from engine.io.trained import COMPACT, STANDARD, Meta, is_trained, load_trained, save_trained
from engine.render.cpu.kernel_field import KernelField
from engine.render.face_detail import Detailed
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.grid import Body
from engine.scene.inside import Inside
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from fruitninja.arguments import PathLike, PlaneLike, as_inks, as_plane, as_points, check_view
from fruitninja.drawing import (
    MARGIN,
    ball_around,
    camera_for,
    check_size,
    default_angles,
    draw_section,
    drawing,
    frame,
)
from training.priors.inside_file import read_inside

__all__ = ["Solid", "Whole", "open_solid"]

NOTEBOOK = (512, 384)
"""Size in pixels of the picture that a notebook shows: half the width of a page."""

WHITE = (1.0, 1.0, 1.0)

SLIVER = 1e-9
"""Fraction of the whole volume up to which a part is rounding and not a piece; the same as for meshes
(engine.export.meshes.cutting)."""


@dataclass(frozen=True, eq=False)
class Whole:
    """The data that a solid and all its parts share."""

    atoms: Atoms
    meta: Meta
    inside: Inside | None
    """None if the object has only atoms."""
    source: Path
    """File of the object, or of the capture that it was made from."""

    @cached_property
    def body(self) -> Body:
        """The solid that the interior atoms fill."""
        return body_of(self.atoms, str(self.source))

    @cached_property
    def field(self) -> KernelField:
        """Colours of the atoms at any point."""
        return KernelField(self.atoms)

    @cached_property
    def shown(self) -> Colours:
        """Colours of the inside, if there is one, and of the atoms."""
        return Colours(self.atoms, self.inside)


class Solid:
    """A solid object, or the part of it on the kept side of planes. It is immutable: cutting returns a new solid.

    Lengths are in units of the file that it was made from. A plane may also be given as four numbers a, b, c, d: the
    kept side is a x + b y + c z + d <= 0.
    """

    def __init__(self, whole: Whole, planes: Sequence[Plane] = ()) -> None:
        """Call `fruitninja.open`, `fruitninja.grow` or `Capture.solidify` instead, which make solids."""
        self._whole = whole
        self.planes: tuple[Plane, ...] = tuple(planes)
        """The cuts: what is left is on the kept side of all of them."""

    def __repr__(self) -> str:
        atoms, cuts = self.atoms, f", cut by {len(self.planes)} planes" if self.planes else ""
        inside = "" if self._whole.inside is None else " and an inside"
        counts = f"{len(atoms.surface):,} surface and {len(atoms.interior):,} interior atoms"
        return f"<Solid {self._whole.source.name}: {counts}{inside}{cuts}>"

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        out = BytesIO()
        Image.fromarray(self.render(size=NOTEBOOK)).save(out, format="PNG")
        return out.getvalue()

    # What it is

    @property
    def atoms(self) -> Atoms:
        """The opaque particles of the whole object, including any part cut away: `atoms.surface` and `atoms.interior`
        hold their arrays."""
        return self._whole.atoms

    @property
    def inside(self) -> Inside | None:
        """The inside as a function of position; None if the object has only atoms."""
        return self._whole.inside

    @property
    def meta(self) -> Meta:
        """What it was made from, and how."""
        return self._whole.meta

    @property
    def up(self) -> NDArray[np.float64]:
        """(3,). The up axis, a unit vector."""
        return np.array(self._whole.meta.up, np.float64)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3). Least and greatest coordinates of the atom centres that are left; zeros if there are none."""
        points = np.concatenate([self.atoms.surface.means, self.atoms.interior.means]).astype(np.float64)
        for plane in self.planes:
            points = points[plane.distance(points) <= 0]
        return np.stack([points.min(0), points.max(0)]) if len(points) else np.zeros((2, 3))

    @property
    def volume(self) -> float:
        """Volume, cubic units of the file. The volumes of the two sides of a cut add up to that of what was cut.

        Each grid cell of the body counts with the part of it under the skin times the part on the kept side of each
        plane, both estimated from the distance of its centre. Raises Error if there is nothing inside.
        """
        body = self._whole.body
        grid = body.grid
        share = np.clip(body.depth.astype(np.float64) / grid.cell + 0.5, 0, 1)
        x, y, z = np.ogrid[tuple(slice(0, count) for count in grid.shape)]
        for plane in self.planes:
            (a, b, c), (u, v, w) = plane.normal, grid.origin / grid.cell + 0.5
            cells = a * (x + u) + b * (y + v) + c * (z + w) + plane.offset / grid.cell
            share *= np.clip(0.5 - cells, 0, 1)
        return float(share.sum()) * grid.cell**3

    # Cutting

    def cut(self, *planes: PlaneLike) -> Solid:
        """Returns the part on the kept side of all planes."""
        return Solid(self._whole, (*self.planes, *map(as_plane, planes)))

    def pieces(self, *planes: PlaneLike) -> list[Solid]:
        """Returns all pieces that the planes divide the solid into, kept sides first, without empty ones."""
        parts, least = [self], SLIVER * self.volume
        for plane in map(as_plane, planes):
            parts = [half for part in parts for half in (part.cut(plane), part.cut(plane.flipped()))]
            parts = [part for part in parts if part.volume > least]
        return parts

    # Looking

    def section(self, plane: PlaneLike, size: int = 512, width: float | None = None) -> NDArray[np.uint8]:
        """(size, size, 4). The cut face in a plane, seen straight on from the removed side, without light.

        RGB with straight alpha: transparent outside the solid. Colours are read from the inside in all the detail that
        a pixel shows. `width`: width of the picture, units of the file; None shows the whole object in any plane, at
        the same scale in all of them. The up axis points upwards, and the picture is centred on the middle of the whole
        object's bounds.
        """
        check_size(size, size)
        if width is not None and not 0 < width < np.inf:
            raise InputError(f"width {width:g}: give a length above 0")
        whole = self._whole
        picture = draw_section(
            whole.field,
            self.atoms.pitch,
            self.inside,
            as_plane(plane),
            self.planes,
            self.up,
            self.atoms.bounds,
            size,
            width,
        )
        return picture.straight_alpha()

    def colours(self, points: ArrayLike, footprint: float | None = None) -> NDArray[np.float32]:
        """(N, 3). RGB of the inside at points (N, 3), even where it has been cut away. Range [0, 1].

        `footprint`: size of the finest details wanted, units of the file, such as the distance between neighbouring
        points; None for all detail. Outside the solid the colours are meaningless.
        """
        given, shown = as_points(points), self._whole.shown
        if footprint is not None and not 0 < footprint < np.inf:
            raise InputError(f"footprint {footprint:g}: give a length above 0")
        return shown.within(given, shown.detail if footprint is None else footprint)

    def camera(
        self,
        azimuth: float | None = None,
        elevation: float | None = None,
        distance: float | None = None,
        size: tuple[int, int] = (1280, 720),
    ) -> Camera:
        """Returns the camera that `render` uses. `azimuth` and `elevation`: angles about and above the middle of the
        whole object, degrees. `distance`: multiple of that from which the whole object fits the picture. `size`: width
        and height of the picture in pixels.

        If none of the first three is given, it frames what is left and sees the cut faces.
        """
        check_size(*size)
        check_view(azimuth, elevation, distance)
        angles = None
        if not azimuth is elevation is distance is None:
            around, above = default_angles(self.planes, self.up)
            angles = [
                around if azimuth is None else azimuth,
                above if elevation is None else elevation,
                1.0 if distance is None else distance,
            ]
        return camera_for(self.atoms, self.up, self.planes, angles, *size)

    def render(
        self,
        camera: Camera | None = None,
        *,
        azimuth: float | None = None,
        elevation: float | None = None,
        distance: float | None = None,
        size: tuple[int, int] = (1280, 720),
    ) -> NDArray[np.uint8]:
        """(H, W, 3). A picture over white with its cut faces in full detail, as `fruitninja-render` draws it.

        `camera`: also decides the picture's size; None: the camera that `Solid.camera` makes of the other arguments.
        """
        view = self.camera(azimuth, elevation, distance, size) if camera is None else camera
        inside = self.inside if self.planes else None
        with drawing([self.atoms], bool(self.planes)) as (draw, _):
            details = [None if inside is None else Detailed(inside, self.atoms.pitch)]
            return frame(draw, details, view, [Piece(self.planes)], WHITE, light=False)[..., :3]

    # Files

    def save(self, path: PathLike) -> None:
        """Writes the object as a .ply, or as an .spz of a tenth of its size, with the files that belong beside it:
        `fruitninja.open` and all FruitNinja programs open it. Raises Error for a part of an object; use `export`."""
        out, whole = Path(path), self._whole
        if self.planes:
            raise InputError(f"{out}: only a whole object is saved so; export what is left of it instead")
        if out.suffix.lower() not in (STANDARD, COMPACT):
            raise InputError(f"{out}: an object is saved as {STANDARD} or {COMPACT}; give a name that ends so")
        if out.exists() and whole.source.exists() and out.samefile(whole.source) and not is_trained(out):
            raise InputError(f"{out}: this is the capture itself; give another name")
        save_trained(out, self.atoms, whole.meta, None if self.inside is None else self.inside.record())

    def export(
        self,
        path: PathLike,
        kind: str | None = None,
        *,
        pieces: bool = False,
        step: float | None = None,
        metres: float = 1.0,
        inks: Sequence[tuple[int, int, int]] = (),
    ) -> str:
        """Writes what is left for other programs; returns one line that says what is in the file.

        `kind`: splats, mesh, volume or particles, if the file name's ending leaves it open. `pieces`: write both sides
        of all planes, each as an object of its own; meshes only. `step`: distance between texels, voxels or particles,
        units of the file. `metres`: length of a unit of the file. `inks`: colours of a printer's materials, sRGB, range
        [0, 255]: each voxel of a stack (.zip) is then one of them. docs/EXPORT.md describes the files.
        """
        whole = self._whole
        wanted = pieces, step, metres, as_inks(inks)
        export = Export(whole.source, self.atoms, self.inside, whole.meta, self.planes, Path(path), *wanted)
        return write_export(export, kind)

    def html(
        self,
        path: PathLike,
        *,
        azimuth: float | None = None,
        elevation: float | None = None,
        distance: float | None = None,
        background: tuple[float, float, float] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> str:
        """Writes a page that shows the object in any browser, offline: the reader turns it, zooms, and moves the planes
        that cut it. Returns one line that says what is in it.

        It opens with the planes of this solid, or with one across the middle. `azimuth`, `elevation`, `distance`: as in
        `Solid.camera`. `background`: RGB, range [0, 1]; None follows the reader's choice of dark or light. `progress`
        is called with the part that is done, range [0, 1]; writing takes a minute or two.
        """
        out, whole = Path(path), self._whole
        if out.suffix.lower() not in PAGES:
            raise InputError(f"{out}: a page is saved as {PAGES[0]}; give a name that ends so")
        check_view(azimuth, elevation, distance)
        points = np.concatenate([self.atoms.surface.means, self.atoms.interior.means]).astype(np.float64)
        middle = self.atoms.bounds.astype(np.float64).mean(0)
        planes = self.planes or (Plane.through(middle, self.up),)
        around, above = default_angles(planes, self.up)
        view = PageView(
            *ball_around(points, self.atoms.pitch),
            around if azimuth is None else azimuth,
            above if elevation is None else elevation,
            MARGIN if distance is None else distance,
        )
        return write_page(
            out,
            whole.source.stem,
            whole.body,
            whole.shown,
            self.up,
            planes,
            view,
            background,
            progress or (lambda part: None),
        )


def open_solid(path: PathLike) -> Solid:
    """Reads a solid from its file, a .ply or .spz with the files beside it. Raises Error if it is not a solid, or
    damaged."""
    path = Path(path)
    atoms, meta = load_trained(path)
    return Solid(Whole(atoms, meta, read_inside(path), path))
