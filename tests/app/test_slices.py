"""The three slices beside the object, and measurements on them and on pieces."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.jobs.slice_reader import Face, SliceReader, WantedFace
from app.model.measure.extent import Filled, extent_of
from app.model.measure.slices import SLICES, Slices
from app.model.measure.units import Unit, round_length
from app.model.pieces import Cell
from engine.scene.inside import InsideRecord, Kind
from engine.scene.plane import Plane
from tests.helpers.solids import ball

SIZE = (120, 90)


class Places:
    """An inside whose colour at each point is its position."""

    detail = 0.01

    def kinds(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        return np.full(len(points), Kind.INSIDE, np.uint8)

    def at(self, points: NDArray[np.floating], footprint: float) -> NDArray[np.float32]:
        return (points * 0.4 + 0.5).astype(np.float32)

    def record(self) -> InsideRecord:
        return {}, {}


SOME = Slices((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 1.0, (0.1, -0.2, 0.5), (0.1, 0.0, 0.0), 1.3)
TILTED = replace(SOME, up=(0.48, 0.6, 0.64))


@pytest.mark.parametrize("slices", [SOME, TILTED])
def test_three_planes_go_through_the_cross_and_views_find_their_points(slices: Slices) -> None:
    normals = np.array([plane.normal for plane in slices.planes])
    assert np.allclose(normals @ normals.T, np.eye(3))
    for index, plane in enumerate(slices.planes):
        assert abs(plane.distance(np.array(slices.cross))) < 1e-9
        point = slices.point(index, SIZE, (31.0, 57.0))
        assert abs(plane.distance(point)) < 1e-9 and np.allclose(slices.place(index, SIZE, point), (31.0, 57.0))
        # A click moves the other two planes, the wheel moves this one; zooming keeps what is under the pointer.
        clicked = slices.moved_to(slices.point(index, SIZE, slices.place(index, SIZE, (0.3, 0.2, 0.1))))
        assert np.isclose(clicked.planes[index].offset, plane.offset)
        assert np.isclose(slices.stepped(index, 3).planes[index].offset, plane.offset - 0.03)
        zoomed = slices.zoomed(index, SIZE, (31.0, 57.0), 2.0)
        assert np.allclose(zoomed.point(index, SIZE, (31.0, 57.0)), point)
        panned = slices.panned(index, SIZE, (31.0, 57.0), (40.0, 50.0))
        assert np.allclose(panned.place(index, SIZE, point), (40.0, 50.0))


def test_the_views_are_turned_as_the_object_is_seen() -> None:
    # Azimuth -90 looks from -y: the front view has x right and z up, the side view y right.
    for index, right, up in ((0, (1, 0, 0), (0, 1, 0)), (1, (1, 0, 0), (0, 0, 1)), (2, (0, 1, 0), (0, 0, 1))):
        x, y = SOME.place(index, SIZE, SOME.cross)
        moved = np.array(SOME.cross) + 0.1 * np.array(right)
        assert SOME.place(index, SIZE, moved)[0] > x + 1, SLICES[index]
        assert SOME.place(index, SIZE, np.array(SOME.cross) + 0.1 * np.array(up))[1] < y - 1, SLICES[index]


def test_the_planes_stay_in_the_object() -> None:
    assert np.linalg.norm(SOME.moved_to(np.array([5.0, 0.0, 0.0])).cross) < 1 + 1e-9
    assert replace(SOME, cross=(0.0, 0.0, 0.995)).stepped(0, 1).cross == (0.0, 0.0, 0.995)


def read(reader: SliceReader, wanted: list[WantedFace], moving: bool) -> list[Face]:
    end = time.monotonic() + 60
    while True:
        reader.update(wanted, moving)
        if not reader.busy:
            return [face for face in reader.faces if face is not None]
        assert time.monotonic() < end
        time.sleep(0.002)


def test_faces_are_coarse_while_they_move_and_are_read_from_the_inside_at_rest() -> None:
    reader, atoms, inside, slices = SliceReader(3), ball(0.04, radius=1.0), Places(), replace(SOME, zoom=1.0)
    slices = replace(slices, target=slices.centre)
    wanted = [WantedFace(atoms, inside, slices.camera(i, SIZE), plane) for i, plane in enumerate(slices.planes)]
    assert [face.coarse for face in read(reader, wanted, True)] == [True] * 3
    for index, face in enumerate(read(reader, wanted, False)):
        assert not face.coarse and face.rgba.shape == (90, 120, 4)
        # The disc in which the plane meets the ball has its geometric size, to a pixel and a half.
        height, scale = float(slices.planes[index].distance(np.zeros(3))), slices.camera(index, SIZE).fx
        radius = np.sqrt(face.rgba[..., 3].sum() / 255 / np.pi)
        assert abs(radius - np.sqrt(1 - height**2) * scale) < 1.5
        point = slices.point(index, SIZE, (60.5, 45.5))
        assert np.abs(face.rgba[45, 60, :3] / 255 - (0.4 * point + 0.5)).max() < 0.01
    reader.close()


def test_lengths_are_told_in_the_unit_that_was_set() -> None:
    assert Unit().text(0.9561) == "0.956 units" and Unit().text(0.0) == "0 units"
    assert Unit("mm", 200.0).text(0.9561) == "191 mm"
    assert Unit("cm", 20.0).text(0.5, 3) == "4,000 cm³" and Unit("mm", 100.0).text(1.2345678, 3) == "1,230,000 mm³"
    assert Unit("m", 1e-9).text(2.0, 2) == "2.00e-18 m²"
    assert Unit("mm", 250.0).named("cm").text(1.0) == "25.0 cm" and Unit("mm", 250.0).named("units") == Unit()
    assert [round_length(x) for x in (0.99, 1.0, 4.9, 70.0)] == [0.5, 1.0, 2.0, 50.0]


def test_a_piece_has_the_volume_and_the_surface_of_a_cap() -> None:
    filled, plane = Filled.of(ball(0.06, radius=1.0)), Plane.of((1, 2, 3), -0.3 * np.sqrt(14))
    whole, low, cap = (extent_of(filled, Cell(faces)) for faces in ((), (plane,), (plane.flipped(),)))
    radius = (3 * whole.volume / (4 * np.pi)) ** (1 / 3)
    assert abs(radius - 1) < 0.03 and whole.faces == 0  # with the half of the skin that stands out
    assert np.isclose(whole.skin, 4 * np.pi * radius**2, rtol=0.01)
    assert np.isclose(low.volume + cap.volume, whole.volume, rtol=1e-6) and np.isclose(low.faces, cap.faces, rtol=1e-4)
    height = radius - 0.3
    assert np.isclose(cap.volume, np.pi * height**2 * (3 * radius - height) / 3, rtol=0.01)
    assert np.isclose(cap.skin, 2 * np.pi * radius * height, rtol=0.01)
    assert np.isclose(cap.faces, np.pi * (radius**2 - 0.3**2), rtol=0.01)
    assert np.isclose(cap.surface, cap.skin + cap.faces)
