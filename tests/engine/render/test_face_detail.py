"""Faces read from the inside: every pixel shows the colour of its place, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.render.cpu import opaque
from engine.render.face_detail import Detailed, FaceDetail, detailed, detailed_from, read_face
from engine.render.gl import GLMissing, Renderer
from engine.scene.camera import Camera, fit_distance, orbit, plane_points, section
from engine.scene.constants import FACE_AMBIENT, FACE_LAMP
from engine.scene.image import Picture
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from tests.helpers.solids import Waves, ball, waves

PITCH = 1 / 12
PLANE = Plane.of((0.3, -0.2, 1.0), 0.05)


def straight(size: int = 300) -> Camera:
    return section(PLANE, np.array([0.0, 0, 1]), np.array([[-0.5] * 3, [0.5] * 3]), size)


def test_a_face_shows_its_places() -> None:
    atoms, camera, inside = ball(PITCH), straight(), Waves()
    plain = opaque.render(atoms, camera, [PLANE])
    found = detailed(plain, camera, [Piece((PLANE,))], [Detailed(inside, PITCH)], light=False)
    points = plane_points(camera, PLANE)
    depth = 0.5 - np.linalg.norm(points, axis=-1)
    deep = depth > 3 * PITCH
    assert deep.mean() > 0.05
    assert np.abs(found.rgb - waves(points))[deep].max() < 2e-3
    assert np.array_equal(found.rgb[depth < -PITCH], plain.rgb[depth < -PITCH])
    assert np.array_equal(found.alpha, plain.alpha) and np.array_equal(found.depth, plain.depth)
    # Between skin and inside the colour changes gradually.
    steps = np.abs(found.rgb - plain.rgb).mean(-1)
    assert steps[(depth > 0) & (depth < 0.3 * PITCH)].mean() < 0.5 * steps[deep].mean()
    assert np.allclose(inside.footprints, np.linalg.norm(points[0, 1] - points[0, 0]), rtol=1e-3)


def test_light_falls_on_it_as_on_the_atoms() -> None:
    atoms, camera = ball(PITCH), straight()
    plain = opaque.render(atoms, camera, [PLANE], light=True)
    dim, lit = (
        detailed(plain, camera, [Piece((PLANE,))], [Detailed(Waves(), PITCH)], light).rgb for light in (False, True)
    )
    middle = 150, 150
    assert np.allclose(lit[middle], dim[middle] * (FACE_AMBIENT + FACE_LAMP), atol=1e-3)  # seen straight on


def test_a_face_that_was_read_once_serves_every_view_of_it() -> None:
    atoms, ahead, piece, inside = ball(PITCH), straight(), Piece((PLANE,)), Waves()
    solid = Detailed(inside, PITCH)
    reading = read_face(opaque.render(atoms, ahead, [PLANE]), ahead, piece, solid)
    reads = len(inside.footprints)
    aside = orbit((0, 0, 0), (0, 0, 1), 20, 65, fit_distance(0.5, 0.6, 1.0), 240, 240, 0.6)
    for camera in (ahead, aside):
        plain = opaque.render(atoms, camera, [PLANE], light=True)
        found = detailed_from(reading, plain, camera, piece, solid, light=True)
        assert len(inside.footprints) == reads
        truth = detailed(plain, camera, [piece], [Detailed(Waves(), PITCH)], light=True)
        difference = np.abs(found.rgb - truth.rgb)
        assert np.abs(truth.rgb - plain.rgb).max() > 0.2 and difference.max() < 0.05 and difference.mean() < 1e-3
        assert np.array_equal(found.alpha, plain.alpha) and np.array_equal(found.depth, plain.depth)


@pytest.mark.parametrize("drawn_by", ["the processor", "OpenGL"])
def test_parted_pieces_read_in_their_own_space(drawn_by: str) -> None:
    """The same face, moved and seen from the same side, has the same colours; what hides it stays in front."""
    atoms = ball(PITCH)
    camera = orbit((0, 0, 0), (0, 0, 1), 20, 65, fit_distance(1.0, 0.6, 1.0), 240, 240, 0.6)
    moved = np.eye(4)
    moved[:3, 3] = (0.5, -0.4, 0.1)
    away = Piece((PLANE.flipped(),), np.array([[1.0, 0, 0, -0.3], [0, 1, 0, 0.5], [0, 0, 1, 0.3], [0, 0, 0, 1]]))
    pieces = [Piece((PLANE,), moved), away]
    if drawn_by == "OpenGL":
        try:
            renderer = Renderer()
        except GLMissing as missing:
            pytest.skip(str(missing))
        with renderer:
            renderer.set_atoms(atoms)
            renderer.render(camera, pieces)
            plain = renderer.read()
    else:
        plain = opaque.render_pieces(atoms, camera, pieces)
    found = detailed(plain, camera, pieces, [Detailed(Waves(), PITCH)], light=False)
    changed = np.abs(found.rgb - plain.rgb).max(-1) > 0.02
    assert 0.03 < changed.mean() < 0.3
    rows, columns = np.nonzero(changed)
    z = plain.depth[rows, columns]
    x, y = (columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z
    world = (np.stack([x, y, z], -1) - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
    own = world - moved[:3, 3]
    assert np.abs(PLANE.distance(own)).max() < 0.02  # only the face that is turned to the camera
    deep = np.linalg.norm(own, axis=1) < 0.5 - 3 * PITCH
    assert deep.any() and np.abs(found.rgb[rows, columns] - waves(own))[deep].max() < 0.05


def test_it_is_read_in_small_parts_and_only_where_there_is_an_inside() -> None:
    atoms, camera = ball(PITCH), straight(640)
    plain = opaque.render(atoms, camera, [PLANE])
    pieces = [Piece((PLANE,))]
    work = FaceDetail(plain, camera, pieces, [Detailed(Waves(), PITCH)], False)
    parts = 0
    while not work.ended:
        work.advance()
        parts += 1
    assert parts > 1
    assert np.array_equal(work.rgb, detailed(plain, camera, pieces, [Detailed(Waves(), PITCH)], False).rgb)
    assert FaceDetail(plain, camera, pieces, [None], False).ended
    assert FaceDetail(plain, camera, [Piece()], [Detailed(Waves(), PITCH)], False).ended
    empty = Picture(plain.rgb, plain.alpha, np.full_like(plain.depth, np.inf))
    assert FaceDetail(empty, camera, pieces, [Detailed(Waves(), PITCH)], False).ended
    assert not FaceDetail(plain, replace(camera), pieces, [Detailed(Waves(), PITCH)], False).ended
