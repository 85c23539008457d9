"""Completes a round face that the picture's border cuts off: its outline by an ellipse, its inside by the face itself,
turned around its middle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.faces.edges import cheapest_path

__all__ = ["MIN_SEEN", "NEAR_BORDER", "Oval", "complete_face", "find_oval", "fit_oval", "is_cut_off"]

MIN_SEEN = 0.75
"""Least fraction of a face that the picture shows for the rest to be completed: three quarters of a disc end where it
is nine tenths of its greatest width. Where a face does not narrow, nothing tells where it ends."""

MAX_CHORD = 0.25
"""Length of one side of the picture that a face may lie on, as a fraction of its width, without visibly lacking
anything: 1.6 % of the width of a round face."""

FIT = 0.03
"""Greatest root mean square difference of an outline's hull from its ellipse, as a fraction of the mean radius. Whole
apples, oranges and melons of 20 photographs differ by 0.4 to 3.2 %, pomegranates by 1.4 to 7.6, slices by 6 and
more."""

NEAR_BORDER = 4
"""Pixels from the border within which an outline is the picture's, not the face's: the search leaves the outermost two
pixels to the background, and rounds corners."""

STRIP = 0.1
"""How far before the border a face may begin to be continued, as a fraction of its radius: the width that is
compared."""

COMPARED = 64
"""Pixels to a face's radius when it is compared with itself."""

POLAR = np.pi / 4
"""How much the turn of a face with poles may differ from half a turn, which maps poles to poles and flanks to flanks:
its axis may lean by half of that."""

LIGHT = 0.25
"""Standard deviation, as a fraction of a face's radius, over which the difference along the border is taken for light:
an eighth to a half did equally well with 26 photographs cut off at two sides on purpose."""

EATEN = 0.06
"""How deep beside the border, as a fraction of the face's width, the search may take the face for background, whose
colours it learns from the border."""


@dataclass(frozen=True)
class Oval:
    """The ellipse of a face that the picture's border cuts off."""

    centre: NDArray[np.float64]
    """(2,). (x, y) in pixels."""
    axes: NDArray[np.float64]
    """(2, 2). Half axes as rows, pixels."""

    def contains(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(...). Which places (..., 2) in pixels lie in it."""
        return np.square(self.to_disc(places)).sum(-1) <= 1

    def to_disc(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 2). Places (..., 2) in pixels, mapped to the unit disc that the face is when seen straight on."""
        return (places - self.centre) @ (self.axes / np.square(self.axes).sum(1, keepdims=True)).T

    def misfit(self, outline: NDArray[np.number]) -> float:
        """Root mean square difference of the pixels (N, 2) of an outline from the ellipse, as a fraction of its
        radius."""
        reach = np.linalg.norm(self.to_disc(np.asarray(outline, np.float64) + 0.5), axis=1)
        return float(np.sqrt(np.square(reach - 1).mean()))


def is_cut_off(mask: NDArray[np.bool_]) -> bool:
    """Whether the picture's border visibly cuts off a face (H, W); a cut-out that fills its picture is whole."""
    return 0 < _sides_that_cut(mask) < 4


def _sides_that_cut(mask: NDArray[np.bool_]) -> int:
    """How many sides of the picture a face (H, W) lies on; 0 if it visibly lacks nothing."""
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return 0
    across = max(np.ptp(rows), np.ptp(columns)) + 1
    low, high = NEAR_BORDER - 1, -NEAR_BORDER
    touched = [int(side.sum()) for side in (mask[low], mask[high], mask[:, low], mask[:, high])]
    if max(touched) <= MAX_CHORD * across:
        return 0
    return sum(n > max(NEAR_BORDER, MAX_CHORD / 4 * across) for n in touched)


def find_oval(mask: NDArray[np.bool_], sides: int) -> Oval | None:
    """The ellipse of a face (H, W) that one to `sides` sides of the picture cut off; None if none does, if more do, if
    the face is not round, or if less than MIN_SEEN of it is seen."""
    if not 0 < _sides_that_cut(mask) <= sides:
        return None
    rows, columns = np.nonzero(mask)
    height, width = mask.shape
    hull = cv2.convexHull(np.stack([columns, rows], -1).astype(np.int32))  # without dents that the search ate
    drawn = cv2.fillConvexPoly(np.zeros(mask.shape, np.uint8), hull, 1)
    outlines, _ = cv2.findContours(drawn, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = max(outlines, key=len)[:, 0]
    own = points[((points >= NEAR_BORDER) & (points < np.array([width, height]) - NEAR_BORDER)).all(1)]
    oval = fit_oval(own)
    if oval is None:
        return None
    area = np.pi * np.linalg.norm(oval.axes, axis=1).prod()
    if oval.misfit(own) > FIT or drawn.sum() < MIN_SEEN * area:
        return None
    return oval


def fit_oval(outline: NDArray[np.number]) -> Oval | None:
    """The ellipse through the pixels (N, 2) of an outline as (x, y); None if they are too few or on no ellipse."""
    if len(outline) < 20:  # an ellipse has five unknowns
        return None
    (x, y), diameters, angle = cv2.fitEllipseDirect(outline.astype(np.float32))
    if not np.isfinite([x, y, *diameters, angle]).all() or min(diameters) < 1:
        return None
    turn = np.radians(angle)
    directions = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return Oval(np.array([x, y]) + 0.5, directions * np.array(diameters)[:, None] / 2)


def complete_face(
    rgb: NDArray[np.float32], mask: NDArray[np.bool_], has_poles: bool
) -> tuple[NDArray[np.float32], NDArray[np.bool_], tuple[int, int]]:
    """The picture (H, W, 3) and its face (H, W), extended by what the border cuts off of the face, which is filled with
    the face itself, turned around its middle (`_continue`); and the columns and rows added before the first. Unchanged,
    with (0, 0), if `find_oval` finds nothing, or several sides cut off so much that no turn fills it. `has_poles`:
    whether the face is cut along its axis, so that it is not like itself after every turn."""
    found = find_oval(mask, 4)
    if found is None:
        return rgb, mask, (0, 0)
    reach = np.hypot(*found.axes)  # half the width and height of its box
    size = np.array(mask.shape[::-1])
    before = np.maximum(np.ceil(reach - found.centre), 0).astype(int) + NEAR_BORDER
    after = np.maximum(np.ceil(found.centre + reach - size), 0).astype(int) + NEAR_BORDER
    padding = ((before[1], after[1]), (before[0], after[0]))
    oval = Oval(found.centre + before, found.axes)
    places = np.moveaxis(np.indices((size + before + after)[::-1])[::-1], 0, -1) + 0.5
    across, down = np.eye(2)
    sides = [(-across, -before[0]), (across, before[0] + size[0]), (-down, -before[1]), (down, before[1] + size[1])]
    beyond = [places @ normal - where for normal, where in sides]  # pixels beyond each side of the picture
    farthest = np.max(beyond, 0)
    whole = np.pad(mask, padding) | (oval.contains(places) & (farthest > -EATEN * 2 * reach.max()))
    shown = np.pad(rgb, (*padding, (0, 0)), mode="edge")
    inner = ndimage.binary_erosion(whole & (farthest <= 0), iterations=2)
    known = shown[tuple(ndimage.distance_transform_edt(~inner, return_distances=False, return_indices=True))]
    for number, out in enumerate(beyond):
        if (whole & (out > 0)).any() and not _continue(shown, known, whole, oval, sides, number, has_poles):
            return rgb, mask, (0, 0)
    return shown, whole, (int(before[0]), int(before[1]))


def _continue(
    shown: NDArray[np.float32],
    known: NDArray[np.float32],
    whole: NDArray[np.bool_],
    oval: Oval,
    sides: list[tuple[NDArray[np.float64], float]],
    number: int,
    has_poles: bool,
) -> bool:
    """Paints the part of an oval beyond one side of the original picture into a larger one (H, W, 3); returns whether
    it can.

    Seen straight on, the oval is a disc. A copy of the disc, turned or mirrored so that it agrees best with the disc in
    a strip before the side, continues it beyond: rind goes on as rind, and rays as straight rays. Within the strip the
    copy begins where the two differ least (Efros and Freeman 2001), and takes on the light that is there.

    Args:
        known: (H, W, 3). The original picture, with the nearest of its colours everywhere else.
        whole: (H, W). The face.
        sides: A `normal` and a `where` each; the original picture shows the places p with `normal` . p <= `where`.
        number: Index of the side beyond which to paint.
        has_poles: As for `complete_face`.
    """
    normal, where = sides[number]
    outward = oval.axes @ normal
    pixels = float(np.linalg.norm(outward))
    line = float(where - normal @ oval.centre) / pixels  # the side's distance from the middle of the disc
    outward /= pixels
    towards = np.stack([outward, [-outward[1], outward[0]]])
    first = line - STRIP
    half = np.sqrt(1 - first**2)  # of the chord where the strip begins

    def grid(last: float, per_radius: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Distances (A,) towards the side up to `last` and (B,) along it, `per_radius` to a radius; both, (A, B, 2)."""
        counts = [max(round(length * per_radius), 2) for length in (last - first, 2 * half)]
        away, along = np.linspace(first, last, counts[0]), np.linspace(-half, half, counts[1])
        return away, along, np.stack(np.meshgrid(away, along, indexing="ij"), -1)

    def on_disc(places: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(np.square(places).sum(-1) <= 1)

    def moved(places: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (..., 2) of places (..., 2) on the moved disc."""
        return oval.centre + places @ (motion @ towards @ oval.axes)

    def look(picture: Sequence[NDArray[np.float32]], places: NDArray[np.float64]) -> NDArray[np.float32]:
        """Colours (..., 3) of a picture, channel by channel, at pixels (..., 2)."""
        at = places[..., 1] - 0.5, places[..., 0] - 0.5
        return np.stack([ndimage.map_coordinates(c, at, order=1, mode="nearest") for c in picture], -1)

    channels = list(np.moveaxis(known, -1, 0))
    coarse = [ndimage.gaussian_filter(c, pixels / COMPARED / 2) for c in channels]
    *_, strip = grid(line, COMPARED)
    *_, needed = grid(1, COMPARED / 4)
    strip, needed = strip[on_disc(strip)], np.concatenate([needed[on_disc(needed)], [[1, 0]]])
    before = look(coarse, moved(strip, np.eye(2)))
    unlike, best = np.inf, None
    most = POLAR if has_poles else np.pi
    for turn in np.arange(np.pi - most, np.pi + most, 1 / COMPARED):
        for hand in (1, -1):
            motion = np.array([[np.cos(turn), np.sin(turn)], [-hand * np.sin(turn), hand * np.cos(turn)]])
            source = moved(needed, motion)
            if all((source @ way <= end).all() for way, end in sides):
                apart = float(np.square(look(coarse, moved(strip, motion)) - before).sum())
                if apart < unlike:
                    unlike, best = apart, motion
    if best is None:
        return False
    away, along, places = grid(line, pixels)
    light = (look(channels, moved(places, np.eye(2))) - look(channels, moved(places, best))).astype(np.float64)
    begin = away[cheapest_path(np.square(light).sum(-1))]
    inside = on_disc(places)
    sums = np.concatenate([(light * inside[..., None]).sum(0), inside.sum(0)[:, None]], -1)
    sums = ndimage.gaussian_filter1d(sums, LIGHT * pixels, axis=0, mode="constant")
    light = sums[:, :3] / sums[:, 3:]
    rows, columns = np.nonzero(whole)
    places = oval.to_disc(np.stack([columns + 0.5, rows + 0.5], -1)) @ towards.T
    beyond = places[:, 0] > np.interp(places[:, 1], along, begin)
    lit = np.stack([np.interp(places[beyond, 1], along, c) for c in light.T], -1)
    shown[rows[beyond], columns[beyond]] = np.clip(look(channels, moved(places[beyond], best)) + lit, 0, 1)
    return True
