"""Lines where planes meet the object, against circles of known radius."""

from __future__ import annotations

import numpy as np
import pytest

from app.model.outline import WIRES, body_of_atoms, body_of_shell, clipped_lines, contours, wires
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.grid import Body
from engine.scene.plane import Plane
from tests.helpers.solids import NO_SURFACE

PITCH = 2 / 64


def filled(inside) -> Atoms:
    """Atoms on a jittered lattice where a predicate of points (N, 3) holds."""
    rng = np.random.default_rng(3)
    axis = np.arange(-1.6, 1.6, PITCH)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), 3).reshape(-1, 3)
    points = points[inside(points)] + rng.uniform(-0.3, 0.3, (int(inside(points).sum()), 3)) * PITCH
    n = len(points)
    interior = InteriorAtoms(points.astype(np.float32), np.full(n, PITCH / 2, np.float32), np.ones((n, 3), np.float32))
    return Atoms(NO_SURFACE, interior, PITCH)


@pytest.fixture(scope="module")
def ball() -> Body:
    return body_of_atoms(filled(lambda p: np.linalg.norm(p - (0.3, 0.1, -0.2), axis=1) < 1))


def length(lines: np.ndarray) -> float:
    return float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum())


@pytest.mark.parametrize("height", [0.0, 0.5, 0.9])
def test_a_plane_meets_a_ball_in_a_circle(ball: Body, height: float) -> None:
    normal = np.array([0.36, 0.48, 0.8])
    centre = np.array([0.3, 0.1, -0.2])
    plane = Plane.through(centre + height * normal, normal)
    lines = contours(ball, [plane])
    assert np.abs(plane.distance(lines)).max() < 1e-9
    radii = np.linalg.norm(lines - (centre + height * normal), axis=2)
    true = (1 - height**2) ** 0.5
    assert np.abs(radii - true).max() < (0.6 if height < 0.8 else 1.5) * ball.grid.cell
    assert length(lines) == pytest.approx(2 * np.pi * true, rel=0.03)
    # Each end is the end of exactly two segments: the line is closed.
    _, counts = np.unique(np.round(lines.reshape(-1, 3), 7), axis=0, return_counts=True)
    assert (counts == 2).all()
    assert not len(contours(ball, [Plane.through(centre + 1.2 * normal, normal)]))


def test_what_other_cuts_took_away_is_not_outlined(ball: Body) -> None:
    plane, other = Plane.through((0.3, 0.1, -0.2), (0, 0, 1)), Plane.through((0.3, 0.1, -0.2), (1, 0, 0))
    lines = contours(ball, [plane], [[other]])
    assert lines[..., 0].max() < 0.3 + 1e-6
    assert length(lines) == pytest.approx(np.pi + 2, rel=0.03)


def test_a_ring_has_two_lines_and_a_hollow_is_seen() -> None:
    def ring(p: np.ndarray) -> np.ndarray:
        return (np.hypot(p[:, 0], p[:, 1]) - 0.9) ** 2 + p[:, 2] ** 2 < 0.35**2

    body = body_of_atoms(filled(ring))
    across = contours(body, [Plane.of((1, 0, 0), 0.0)])
    assert length(across) == pytest.approx(2 * 2 * np.pi * 0.35, rel=0.04)
    level = contours(body, [Plane.of((0, 0, 1), 0.0)])
    assert length(level) == pytest.approx(2 * np.pi * (1.25 + 0.55), rel=0.03)


def test_a_skin_alone_is_outlined_from_without() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    body = body_of_shell(points)
    lines = contours(body, [Plane.of((0, 0, 1), 0.0), Plane.of((0, 0, 1), -0.6)])
    assert length(lines) == pytest.approx(2 * np.pi * (1 + 0.8), rel=0.05)
    assert not len(contours(body_of_shell(np.zeros((0, 3))), [Plane.of((0, 0, 1), 0.0)]))


def test_wires_are_an_even_net_on_the_skin(ball: Body) -> None:
    centre = (0.3, 0.1, -0.2)
    lines = wires(ball) - centre
    assert np.abs(np.linalg.norm(lines, axis=2) - 1).max() < 0.6 * ball.grid.cell
    # Circles at even heights along each axis: their lengths add up to three times the ball's disc, over their spacing.
    assert length(lines) == pytest.approx(3 * np.pi**2 / (2 / WIRES), rel=0.03)
    _, counts = np.unique(np.round(lines.reshape(-1, 3), 7), axis=0, return_counts=True)
    assert (counts % 2 == 0).all()  # all of them are closed
    outset = np.linalg.norm(wires(ball, 0.6) - centre, axis=2)
    assert outset.mean() == pytest.approx(1 + 0.6 * ball.grid.cell, abs=0.3 * ball.grid.cell)


def test_spheres_of_every_size_fill_what_they_fill() -> None:
    """Coarse ones deep inside leave no hollow, and fine ones do not move the outline outwards."""
    solid, rng = filled(lambda p: np.linalg.norm(p, axis=1) < 1), np.random.default_rng(0)
    means = solid.interior.means
    deep = np.linalg.norm(means, axis=1) < 0.5
    corners = np.stack(np.meshgrid(*3 * [(-0.25, 0.25)]), -1).reshape(-1, 1, 3) * PITCH
    axis = np.arange(-0.6, 0.6, 2 * PITCH)
    wide = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), 3).reshape(-1, 3)
    wide = wide[np.linalg.norm(wide, axis=1) < 0.5]
    parts = (wide, PITCH), ((means[~deep] + corners).reshape(-1, 3), PITCH / 4)
    interior = InteriorAtoms(
        np.concatenate([m for m, _ in parts]).astype(np.float32),
        np.concatenate([np.full(len(m), s, np.float32) for m, s in parts]),
        np.ones((sum(len(m) for m, _ in parts), 3), np.float32),
    )
    body = body_of_atoms(Atoms(NO_SURFACE, interior, PITCH))
    normal = rng.standard_normal(3)
    lines = contours(body, [Plane.through(np.zeros(3), normal / np.linalg.norm(normal))])
    assert np.abs(np.linalg.norm(lines, axis=2) - 1).max() < 0.6 * body.grid.cell


def test_lines_end_where_their_cells_do() -> None:
    rng = np.random.default_rng(1)
    ends = rng.uniform(-1, 1, (200, 2, 3))
    half, other = Plane.of((0, 0, 1), 0), Plane.of((1, 0, 0), -0.2)
    kept = clipped_lines(ends, [(half, other)])
    assert 50 < len(kept) < 200 and max(half.distance(kept).max(), other.distance(kept).max()) < 1e-12
    # Nothing is lost: the parts on both sides of a plane together are as long as the lines.
    both = clipped_lines(ends, [(half,), (half.flipped(),)])
    assert length(both) == pytest.approx(length(ends))
    assert np.array_equal(clipped_lines(ends, [()]), ends)
