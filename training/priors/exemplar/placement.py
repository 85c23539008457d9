"""Where a picture is placed in a body, before anything is solved: bent to the body's outline on its own plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.scene.grid import Body
from engine.scene.image import to_8bit
from engine.scene.plane import Plane
from training.families import Family, Kind
from training.priors.exemplar.frames import Space, View, frame_of, make_space, scale_picture, to_pixel, upright_factor
from training.priors.exemplar.layering.correction import radial_position
from training.priors.exemplar.layering.places import Places, Shape
from training.priors.exemplar.patches import FIXED, OVER, RADIAL
from training.priors.exemplar.pictures import Picture, fill_outside
from training.priors.exemplar.quilting.chunks import Ball
from training.priors.exemplar.quilting.disc import BallMap, Disc
from training.priors.exemplar.rind import rind_depth
from training.priors.exemplar.sampling import read_as_scipy

__all__ = ["OwnPlane", "bend_picture", "find_own_plane"]

PIXELS = 320
"""Pixels along a side of a bent picture: about as many as it covers in half a window."""

VOXELS = 64
"""Cells along the body's longest side at which its outline is found; finer ones move it by less than a pixel."""

MARGIN = 1.04
"""Half a side of the square around the body, over the body's reach."""


@dataclass(frozen=True)
class Turned:
    """Points of the own plane of radial pictures that are turned about the axis (`Revolution`)."""

    shape: Shape
    places: Places
    area: int
    """Area of the cut in square cells."""

    @classmethod
    def of(cls, space: Space, points: NDArray[np.float64]) -> Turned:
        """For points (M, 3) in cells from the middle of a body."""
        shape = Shape.of(space, View(RADIAL, space.basis, []))
        return cls(shape, shape.places(points), space.axial_area)

    def read(self, picture: Picture) -> NDArray[np.float32]:
        """(M, 3). What a picture shows of the points."""
        cells = float(np.sqrt(self.area / picture.mask.sum()))
        scaled = scale_picture(picture, self.shape.inradius, RADIAL, cells)
        rind = rind_depth(scaled.rgb, scaled.depth, OVER, goes_around=True)
        x, y = radial_position(scaled, rind, self.places, self.shape, self.places.side)
        return read_as_scipy(fill_outside(picture.rgb, picture.mask), to_pixel(y, cells), to_pixel(x, cells))


@dataclass(frozen=True)
class OwnPlane:
    """The cut through a body's centre that a family's pictures show, and the places of its points in a picture."""

    kind: Kind
    """How its pictures are read; those of a custom family, like those of the kind that it resembles."""
    plane: Plane
    """The cut; its normal points towards the viewer."""
    centre: NDArray[np.float64]
    """(3,). Centre of the body, world units."""
    corners: NDArray[np.float64]
    """(4, 3). Corners of a square on the plane around the body: top left, top right, bottom right, bottom left; world
    units."""
    places: NDArray[np.float32]
    """(PIXELS, PIXELS, 2). Where each pixel of the square is in the unit disc of a picture, x to the right and y up;
    rows from the top."""
    proportions: float | None
    """Width over height of the body in the family's cuts; None if its pictures may be turned."""
    turned: Turned | None
    """How pictures are turned about the axis instead, if they are; those of grains are not."""
    inside: NDArray[np.float32]
    """(PIXELS, PIXELS). Fraction of each pixel that is inside the body. Range [0, 1]."""


def find_own_plane(body: Body, up: NDArray[np.float64], family: Family, alone: bool = False) -> OwnPlane:
    """The own plane of a family: half way up, upright through the axis, or across a straight body's middle.
    `alone`: whether no other family has pictures, so that radial ones are turned about the axis."""
    space = make_space(body, up, VOXELS)
    grid = space.body.grid
    centre = grid.origin + (space.centre + 0.5) * grid.cell
    family = family.as_standard_kind(body, up)
    if family.kind == "horizontal":
        right, high = space.basis[0], space.basis[1]
    elif family.kind == "radial":
        right, high = space.basis[0], space.up
    else:
        normal = family.normal(body, space.up)
        high = space.up - normal * (normal @ space.up)
        high = high / np.linalg.norm(high) if np.linalg.norm(high) > 1e-3 else space.basis[1]
        right = np.cross(high, normal)
    axes = np.stack([right, high])
    reach = MARGIN * float(np.abs((space.body.points - centre) @ axes.T).max(initial=grid.cell))
    steps = ((np.arange(PIXELS) + 0.5) / PIXELS * 2 - 1) * reach
    x, y = np.meshgrid(steps, -steps)
    points = np.stack([x, y], -1).reshape(-1, 2) @ axes
    ball = BallMap.of(space).to_ball((points @ space.basis.T / grid.cell).astype(np.float32))
    # A level cut that is not through the ball's middle is a smaller disc, which its picture fills.
    places = Ball.of(ball).level if family.kind == "horizontal" else ball @ (space.basis @ axes.T)
    frame, proportions = frame_of(family.kind, space), None
    if frame == RADIAL:
        proportions = space.axial_proportions
    elif frame == FIXED:
        proportions = space.proportions(np.stack([right, high, np.cross(right, high)]))
    depth = space.body.at(centre + points).astype(np.float64)
    inside = np.clip(depth * PIXELS / (2 * reach) + 0.5, 0, 1)
    corners = centre + reach * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) @ axes
    return OwnPlane(
        family.kind,
        Plane.through(centre, np.cross(right, high)),
        centre,
        corners,
        places.reshape(PIXELS, PIXELS, 2).astype(np.float32),
        proportions,
        Turned.of(space, points / grid.cell) if alone and frame == RADIAL else None,
        inside.reshape(PIXELS, PIXELS).astype(np.float32),
    )


def bend_picture(picture: Picture, plane: OwnPlane, has_grains: bool = False) -> NDArray[np.uint8]:
    """(PIXELS, PIXELS, 4). What the body shows on a picture's own plane, with straight alpha, 0 outside of the body.

    This follows the law by which training places it: each direction from the core is stretched to the body's outline,
    once the body has the picture's proportions, if these are to be seen and are not nearly its own. `has_grains`:
    whether it is made of grains (`made_of_grains`), and is quilted though it is alone.
    """
    if plane.turned is not None and not has_grains:
        rgb = plane.turned.read(picture).reshape(PIXELS, PIXELS, 3)
        return to_8bit(np.concatenate([np.clip(rgb, 0, 1), plane.inside[..., None]], -1))
    x, y = np.moveaxis(plane.places, -1, 0)
    if plane.proportions is not None:
        ratio = plane.proportions / picture.proportions
        if plane.kind == "radial":
            ratio = upright_factor(plane.proportions, picture.proportions)
        angle, share = np.arctan2(y * ratio, x), np.hypot(x, y)
        x, y = share * np.cos(angle), share * np.sin(angle)
    rgb = Disc.of(picture).read(x.ravel(), y.ravel()).reshape(*x.shape, 3)
    return to_8bit(np.concatenate([rgb, plane.inside[..., None]], -1))
