"""Cut families against their geometry: spacing, angles, and that every plane meets the body."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.scene.camera import equator, plane_points, section
from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane
from training.cli import parse_families
from training.families import Family

UP = np.array([0.0, 0.0, 1.0])


def ball(radius: float = 0.8, cells: int = 40, centre: tuple[float, float, float] = (0.3, -0.2, 0.5)) -> Body:
    cell = 2.2 * radius / cells
    origin = np.asarray(centre) - 1.1 * radius
    grid = Grid(origin, cell, (cells,) * 3)
    return Body(grid, (radius - np.linalg.norm(grid.centres() - np.asarray(centre), axis=-1)).astype(np.float32))


def test_body_knows_its_volume_and_depth():
    body = ball()
    assert body.volume == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=0.01)
    assert body.at(np.array([[0.3, -0.2, 0.9]]))[0] == pytest.approx(0.4, abs=0.01)
    assert body.resampled(body.grid.cell / 2).volume == pytest.approx(body.volume, rel=0.01)


def test_a_stack_is_even_and_covers_the_body():
    planes = Family("horizontal", 40).planes(ball(), UP)
    heights = np.array([-p.offset for p in planes])
    assert np.allclose(np.diff(heights), np.diff(heights)[0])
    assert heights[0] > -0.3
    assert heights[-1] < 1.3
    assert heights[-1] - heights[0] == pytest.approx(1.6 * 39 / 40, rel=0.05)


def test_radial_planes_hold_the_axis_and_share_180_degrees():
    planes = Family("radial", 30).planes(ball(), UP)
    normals = np.array([p.normal for p in planes])
    centre = np.array([[0.3, -0.2, 0.5], [0.3, -0.2, 1.4]])
    assert np.abs(np.array([p.distance(centre) for p in planes])).max() < 0.02
    assert np.allclose((normals[1:] * normals[:-1]).sum(1), np.cos(np.pi / 30))
    assert np.allclose(normals @ UP, 0)


def test_a_range_takes_a_part_of_the_extent_and_of_the_angles():
    whole, part = Family("horizontal", 10), Family("horizontal", 4, span=(0.3, 0.7))
    heights = [[-p.offset for p in f.planes(ball(), UP)] for f in (whole, part)]
    assert np.allclose(heights[0][3:7], heights[1])
    turns = [
        [p.normal for p in Family("radial", n, span=s).planes(ball(), UP)] for n, s in ((12, (0, 1)), (6, (0.5, 1)))
    ]
    assert np.allclose(turns[0][6:], turns[1])
    with pytest.raises(InputError, match=r"range 0\.7\.\.0\.3"):
        Family("radial", 4, span=(0.7, 0.3))


def test_a_section_camera_sees_its_plane_with_up_upwards():
    plane = Plane.through((0.3, -0.2, 0.5), (1.0, 0.4, 0.0))
    camera = section(plane, UP, ball().bounds(), 64)
    points = plane_points(camera, plane)
    assert np.abs(plane.distance(points)).max() < 1e-5
    assert (np.diff(points[:, 32, 2]) < 0).all()
    assert np.linalg.det(camera.viewmat[:3, :3]) == pytest.approx(1.0)
    assert plane.distance(camera.position) > 0


def test_command_line_families(tmp_path):
    picture = tmp_path / "a.png"
    picture.write_bytes(b"not looked at yet")
    families = parse_families([f"radial={picture}", f"horizontal={picture}"], [], ["radial=a halved melon"])
    assert [(f.kind, f.count, f.prompt) for f in families] == [("horizontal", 40, ""), ("radial", 30, "a halved melon")]
    families = parse_families([f"parallel={picture}"], ["parallel:12:-y", "custom:0,0,2,1"], [])
    assert families[0].axis == (0.0, -1.0, 0.0)
    assert families[1].custom == (Plane((0.0, 0.0, 1.0), 0.5),)
    assert all(family.span == (0.0, 1.0) for family in families)
    wanted = ["horizontal:7:0.25..1", "radial:30:0..5e-1", "parallel:12:-y:.1...9"]
    families = parse_families([f"parallel={picture}"], wanted, [])
    assert [family.span for family in families] == [(0.25, 1.0), (0.0, 0.5), (0.1, 0.9)]
    assert [family.count for family in families] == [7, 30, 12] and families[2].axis == (0.0, -1.0, 0.0)


@pytest.mark.parametrize(
    ("exemplars", "families", "said"),
    [
        (["radial={}"], ["horizontal:40"], "add --family radial:30"),
        (["radial"], [], "family=value"),
        (["diagonal={}"], [], "no family 'diagonal'"),
        (["radial=missing.png"], [], "missing.png: no such file"),
        (["radial={}"], ["radial:0"], "above zero"),
        (["radial={}"], ["radial:many"], "above zero"),
        (["radial={}"], ["radial:3", "custom:0,0,0,1"], "normal"),
        (["radial={}"], ["radial:3", "custom:1,2"], "custom:a,b,c,d"),
        (["parallel={}"], ["parallel:3:0,0,0"], "direction"),
        ([], ["horizontal:3"], "at least one"),
        (["radial={}"], ["radial:3:0.8..0.2"], "as in 0.2..0.8"),
        (["radial={}"], ["radial:3:0..1.5"], "as in 0.2..0.8"),
        (["radial={}"], ["radial:3:0.1.."], "as in 0.2..0.8"),
        (["radial={}"], ["radial:3:nan..1"], "as in 0.2..0.8"),
        (["radial={}"], ["radial:0..1"], "above zero"),
        (["parallel={}"], ["parallel:60:x", "parallel:30:y"], "--family parallel:30:y: parallel is given twice"),
    ],
)
def test_families_that_cannot_be(exemplars, families, said, tmp_path):
    picture = tmp_path / "a.png"
    picture.touch()
    with pytest.raises(InputError, match=said) as caught:
        parse_families([text.format(picture) for text in exemplars], families, [])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.8, 0.6), (0.0, 0.7, 0.71), (0.0, -0.85, -0.53)])
def test_a_loaf_is_sliced_across_its_longest_side_however_it_lies(up: tuple[float, float, float]) -> None:
    axis = np.asarray(up) / np.linalg.norm(up)
    e1, e2 = equator(axis)
    grid = Grid(np.full(3, -1.6), 0.08, (40,) * 3)
    along = np.abs(grid.centres() @ np.stack([e1, e2, axis], 1)) - np.array([0.5, 1.0, 0.45])
    body = Body(grid, -along.max(-1).astype(np.float32))
    assert abs(Family("parallel", 5).normal(body, axis) @ e2) == pytest.approx(1)
