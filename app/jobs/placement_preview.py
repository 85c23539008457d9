"""Bends pictures onto their own planes in the object, in the background, so that dragging never waits for it."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from app.model.outline import body_of_atoms
from app.model.rigid_transform import Vec3
from app.translation import _
from engine.errors import InputError
from engine.scene.atoms import Atoms
from engine.scene.grid import Body
from training.faces.marks import Marks
from training.faces.polygon import polygon_mask
from training.families import Family
from training.priors.exemplar.pictures import Picture, axis_of, make_picture
from training.priors.exemplar.placement import OwnPlane, bend_picture, find_own_plane
from training.priors.exemplar.quilting.disc import Disc
from training.priors.exemplar.quilting.labels import made_of_grains

__all__ = ["Placed", "PlacementPreview", "PlacementRequest"]

SIDE = 384
"""Longer side, in pixels, that a picture is reduced to: as much as a bent picture shows, and quick to turn."""


@dataclass(frozen=True, eq=False)
class PlacementRequest:
    """A picture to be placed, and the family and object that it belongs to."""

    rgb: NDArray[np.uint8]
    """(H, W, 3). The picture."""
    marks: Marks
    """Its outline, and the axis as far as it is known."""
    family: Family
    atoms: Atoms | None
    """The object; None while it is not solid, and then only the axis is found."""
    up: Vec3
    alone: bool = False
    """Whether no other family has pictures."""

    def equals(self, other: PlacementRequest | None) -> bool:
        """Whether the result would be the same."""
        if other is None:
            return False
        arrays = self.rgb is other.rgb and self.atoms is other.atoms
        return arrays and (self.marks, self.plane_key) == (other.marks, other.plane_key)

    @property
    def plane_key(self) -> tuple[Family, Vec3, bool]:
        """Everything that the own plane depends on, apart from the object."""
        return replace(self.family, exemplars=(), prompt="", marks=()), self.up, self.alone


@dataclass(frozen=True, eq=False)
class Placed:
    """A picture on its own plane."""

    marks: Marks
    """The marks, including the axis that was used."""
    plane: OwnPlane | None = None
    rgba: NDArray[np.uint8] | None = None
    """(S, S, 4). What the face shows, straight alpha."""
    problem: str = ""


class PlacementPreview:
    """Places one picture at a time; of several requests that come meanwhile, only the last one counts."""

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, "placement")
        self._running: tuple[PlacementRequest, Future[Placed]] | None = None
        self._done: tuple[PlacementRequest, Placed] | None = None
        self._body: tuple[Atoms, Body] | None = None
        self._plane: tuple[object, OwnPlane] | None = None
        self._grains: tuple[NDArray[np.uint8], bool] | None = None

    def update(self, wanted: PlacementRequest) -> Placed | None:
        """Starts the placement, unless it is done or another one is being made; returns the last finished placement of
        the same picture. Never waits."""
        if self._running is not None and self._running[1].done():
            self._done = (self._running[0], self._running[1].result())
            self._running = None
        if self._running is None and not wanted.equals(None if self._done is None else self._done[0]):
            self._running = (wanted, self._worker.submit(self._place, wanted))
        return None if self._done is None or self._done[0].rgb is not wanted.rgb else self._done[1]

    @property
    def busy(self) -> bool:
        """Whether a placement is being made."""
        return self._running is not None

    def close(self) -> None:
        """Starts nothing more."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _place(self, wanted: PlacementRequest) -> Placed:
        marks = wanted.marks
        assert marks.outline is not None
        image = Image.fromarray(wanted.rgb)
        image.thumbnail((SIDE, SIDE), Image.Resampling.BOX)
        rgb = np.asarray(image, np.float32) / np.float32(255)
        mask = polygon_mask(marks.outline, *rgb.shape[:2])
        kind = wanted.family.kind
        if not mask.any():
            return Placed(marks, problem=_("the outline encloses nothing"))
        plane = None if wanted.atoms is None else self._plane_of(wanted, wanted.atoms)
        if plane is not None:
            kind = plane.kind
        known = marks.line if kind == "radial" else marks.core
        if known is None:
            axis = axis_of(rgb, mask, kind)
            marks = replace(marks, core=marks.core or axis.core, line=marks.line or axis.line)
        if plane is None:
            return Placed(marks)
        try:
            picture = make_picture(Path("the picture"), rgb, mask, kind, marks)
        except InputError as error:
            return Placed(marks, problem=str(error))
        return Placed(
            marks, plane, bend_picture(picture, plane, plane.turned is not None and self._has(wanted, picture))
        )

    def _has(self, wanted: PlacementRequest, picture: Picture) -> bool:
        """Whether a radial picture is made of grains. That takes most of a second, and its marks hardly change it."""
        if self._grains is None or self._grains[0] is not wanted.rgb:
            self._grains = (wanted.rgb, made_of_grains(Disc.of(picture), False))
        return self._grains[1]

    def _plane_of(self, wanted: PlacementRequest, atoms: Atoms) -> OwnPlane:
        """The own plane of the family in the object, found again only if either has changed."""
        if self._body is None or self._body[0] is not atoms:
            self._body, self._plane = (atoms, body_of_atoms(atoms)), None
        key = wanted.plane_key
        if self._plane is None or self._plane[0] != key:
            self._plane = (key, find_own_plane(self._body[1], np.asarray(wanted.up, np.float64), key[0], wanted.alone))
        return self._plane[1]
