"""The GL engine's opaque mode against the float64 reference, and its invariants."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from engine.render.cpu.kernel_field import KernelField
from engine.render.gl import GLMissing, Renderer
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.camera import Camera, look_at, section
from engine.scene.image import psnr
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from tests.helpers.gl_scenes import around, draw, tight_ball
from tests.helpers.solids import NO_SURFACE, ball, rows_of, scatter, with_leaf
from tests.reference.opaque import kernel_field, reference

CUTS = {
    "uncut": (),
    "one cut": (Plane.of((0.1, 0, 1), 0.02),),
    "three cuts": (Plane.of((0, 0.3, 1), -0.05), Plane.of((1, 0.1, 0), -0.1), Plane.of((0.2, -1, 0.1), -0.2)),
}


@pytest.fixture(scope="module")
def renderers() -> Iterator[dict[bool, Renderer]]:
    """One renderer by GLSL and one by kernels, as they are needed."""
    made: dict[bool, Renderer] = {}
    yield made
    for renderer in made.values():
        renderer.release()


@pytest.fixture(params=[True, False], ids=["shaders", "kernels"])
def renderer(request: pytest.FixtureRequest, renderers: dict[bool, Renderer]) -> Iterator[Renderer]:
    """The renderer by GLSL, and by the CPU's kernels as on software GL: the same laws for both. Each test has both, one
    after the other, so that they share the pictures of the reference."""
    try:
        if request.param not in renderers:
            renderers[request.param] = Renderer(shaders=request.param)
    except GLMissing as missing:
        pytest.skip(str(missing))
    drawn_by = renderers[request.param]
    with drawn_by.ctx:
        assert drawn_by.ctx.error == "GL_NO_ERROR"
    yield drawn_by
    with drawn_by.ctx:
        assert drawn_by.ctx.error == "GL_NO_ERROR"


MADE = {
    "scatter": lambda: scatter(60, 60),
    "ball": lambda: ball(1 / 10),
    "leaf": lambda: with_leaf(ball(1 / 10), spacing=1.1),
}


@cache
def truths(made: str, cut: str) -> list[tuple[Camera, tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Cameras, and the reference's picture for each."""
    atoms = MADE[made]()
    plane = Plane.of((0.1, -0.2, 1), 0)
    cameras = around(30, 35), around(200, 60, 4.0), section(plane, (0, 1, 0), atoms.bounds, 50)
    return [(camera, reference(atoms, camera, CUTS[cut], light=True)) for camera in cameras]


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("made", MADE)
def test_parity_with_the_reference(renderer: Renderer, made: str, cut: str) -> None:
    renderer.set_atoms(MADE[made]())
    for camera, (rgb, alpha, depth) in truths(made, cut):
        ours = draw(renderer, camera, Piece(CUTS[cut]), light=True)
        assert psnr(ours.rgb, rgb) >= 45
        assert psnr(ours.alpha, alpha) >= 45
        seen = np.isfinite(ours.depth) & np.isfinite(depth) & (alpha > 0.99)
        assert np.quantile(np.abs(ours.depth[seen] - depth[seen]), 0.98) < 1e-4


def test_a_moved_piece_is_the_object_seen_from_elsewhere(renderer: Renderer) -> None:
    atoms = ball(1 / 10)
    renderer.set_atoms(atoms)
    turn = np.linalg.inv(look_at((0.1, 0.2, 0.3), (1, 0.4, 0.2), (0, 0, 1)))
    camera, planes = around(30, 35, 1.5, 64, 48), CUTS["one cut"]
    rgb, _, _ = reference(atoms, replace(camera, viewmat=camera.viewmat @ turn), planes)
    assert psnr(draw(renderer, camera, Piece(planes, turn.astype(np.float64))).rgb, rgb) >= 45


def test_cut_through_a_checkerboard(renderer: Renderer) -> None:
    """Flat colours, the kernel field to 2/255, and the same from five cameras."""
    side = np.arange(30) - 14.5
    cells = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
    dark = (np.floor(cells / 2).sum(1) % 2)[:, None]
    means, pitch = (cells / 30).astype(np.float32), 1 / 30
    rgb = (dark * [0.9, 0.9, 0.8] + (1 - dark) * [0.1, 0.2, 0.1]).astype(np.float32)
    atoms = Atoms(NO_SURFACE, InteriorAtoms(means, np.full(len(means), pitch / 2, np.float32), rgb), pitch)
    renderer.set_atoms(atoms)
    field = KernelField(atoms)
    plane = Plane.of((0.3, 0.2, 1), -0.03)
    normal = np.array(plane.normal)
    marks = np.random.default_rng(3).uniform(-0.25, 0.25, (12, 3))
    marks -= np.outer(plane.distance(marks), normal)
    exact, _ = kernel_field(atoms, marks)
    for azimuth, elevation, distance in ((10, 80, 0.7), (100, 45, 0.8), (190, 60, 0.6), (300, 25, 0.8), (45, 50, 0.9)):
        camera = around(azimuth, elevation, distance, 480, 360)
        for mark, true in zip(marks, exact, strict=True):
            c = camera.viewmat[:3, :3] @ mark + camera.viewmat[:3, 3]
            # A window of three pixels centred on the mark.
            cx, cy = 1.5 - camera.fx * c[0] / c[2], 1.5 - camera.fy * c[1] / c[2]
            window = draw(renderer, replace(camera, cx=cx, cy=cy, width=3, height=3), Piece((plane,)))
            assert np.abs(window.rgb[1, 1] - true).max() <= 2 / 255
        picture = draw(renderer, camera, Piece((plane,)))
        rows, columns = np.nonzero(picture.alpha > 0.999)
        z = picture.depth[rows, columns].astype(np.float64)
        ray = np.stack([(columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z, z], 1)
        points = (ray - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
        deep = np.abs(points).max(1) < 0.42
        assert deep.sum() > 3000
        assert np.abs(plane.distance(points[deep])).max() < 0.5 * z.min() / camera.fx
        colour, _ = field.at(points[deep])
        assert np.abs(picture.rgb[rows[deep], columns[deep]] - colour).max() <= 2 / 255
    # The cached grid comes close to that.
    camera = around(10, 80, 0.7, 480, 360)
    for _ in range(2):
        quick = draw(renderer, camera, Piece((plane,)), exact=False)
    true = draw(renderer, camera, Piece((plane,)))
    deep = np.hypot(*(np.mgrid[:360, :480] - np.array([180, 240])[:, None, None])) < 120
    assert psnr(quick.rgb[deep], true.rgb[deep]) > 50
    assert np.abs(quick.rgb - true.rgb)[deep].max() <= 5 / 255


def test_pieces_put_back_together_are_the_uncut_object(renderer: Renderer) -> None:
    renderer.set_atoms(ball(1 / 20))
    one, two = Plane.of((0.2, 0.1, 1), 0.05), Plane.of((1, 0.3, 0), 0.1)
    for azimuth, elevation in ((20, 30), (140, -50)):
        camera = around(azimuth, elevation)
        whole = draw(renderer, camera)
        halves = draw(renderer, camera, Piece((one,)), Piece((one.flipped(),)))
        assert psnr(halves.rgb, whole.rgb) >= 60
        quarters = [Piece((a, b)) for a in (one, one.flipped()) for b in (two, two.flipped())]
        assert psnr(draw(renderer, camera, *quarters).rgb, whole.rgb) >= 60


def test_pieces_apart_are_put_together_by_depth(renderer: Renderer) -> None:
    """Each piece as the reference draws it alone, the nearer one over the other pixel by pixel."""
    atoms = ball(1 / 10)
    renderer.set_atoms(atoms)
    plane, camera = Plane.of((0.2, 0.1, 1), 0.05), around(30, 30, 1.6, 80, 60)
    up, down = np.eye(4), np.linalg.inv(look_at((0.1, 0.2, 0.15), (1, 0.4, 0.2), (0, 0, 1)))
    up[:3, 3] = 0.1, 0, 0.35
    pieces = Piece((plane,), down.astype(np.float64)), Piece((plane.flipped(),), up)
    black = (0.0, 0.0, 0.0)
    alone = [reference(atoms, piece.camera(camera), piece.planes, black) for piece in pieces]
    (rgb, alpha, depth), (other, other_alpha, other_depth) = alone
    both = np.where((alpha > 0) & (other_alpha > 0), 1, 0)
    assert both.sum() > 50  # the pieces overlap in the picture
    first = (depth <= other_depth)[..., None]
    over = np.where(first, rgb + (1 - alpha[..., None]) * other, other + (1 - other_alpha[..., None]) * rgb)
    ours = draw(renderer, camera, *pieces, background=black)
    assert psnr(ours.rgb, over) >= 45
    assert psnr(ours.alpha, 1 - (1 - alpha) * (1 - other_alpha)) >= 45
    swapped = draw(renderer, camera, *pieces[::-1], background=black)
    assert np.abs(swapped.rgb - ours.rgb).max() < 1 / 255


def test_a_gap_shows_the_face_behind_it(renderer: Renderer) -> None:
    """With the middle one of three slices taken out, the lower one's face is whole although nothing was moved."""
    renderer.set_atoms(tight_ball(1 / 20))
    low, high = Plane.of((0, 0, 1), 0.1), Plane.of((0, 0, 1), -0.1)
    camera = around(0, 40)
    both = draw(renderer, camera, Piece((low,)), Piece((high.flipped(),)))
    alone = draw(renderer, camera, Piece((low,)))
    top = draw(renderer, camera, Piece((high.flipped(),)))
    free = top.alpha == 0
    assert (free & (alone.alpha > 0)).sum() > 300
    assert np.abs(both.rgb - alone.rgb)[free].max() < 1 / 255


def test_a_cut_that_misses_changes_nothing(renderer: Renderer) -> None:
    renderer.set_atoms(ball(1 / 16))
    camera = around(20, 30)
    whole = draw(renderer, camera)
    for plane in (Plane.of((0, 0, 1), -0.9), Plane.of((1, 1, 0), -3)):
        assert np.array_equal(draw(renderer, camera, Piece((plane,))).rgb, whole.rgb)
        gone = draw(renderer, camera, Piece((plane.flipped(),)), background=(0.2, 0.4, 0.6))
        assert not gone.alpha.any()


def test_several_cuts_that_miss_something_long_change_nothing(renderer: Renderer) -> None:
    """Planes that pass beside the object, yet nearer to its middle than its ends are."""
    made = ball(1 / 16)
    thin = np.array([0.2, 1, 0.2], np.float32)
    skin = replace(made.surface, means=made.surface.means * thin)
    renderer.set_atoms(Atoms(skin, replace(made.interior, means=made.interior.means * thin), made.pitch))
    camera = around(20, 30)
    whole = draw(renderer, camera)
    beside = Plane.of((1, 0, 0), -0.4), Plane.of((-1, 0, 0), -0.4)
    assert np.array_equal(draw(renderer, camera, Piece(beside)).rgb, whole.rgb)
    assert not draw(renderer, camera, Piece((beside[0], beside[1].flipped()))).alpha.any()


def test_order_does_not_matter(renderer: Renderer) -> None:
    atoms = ball(1 / 20, degree=2)
    camera, pieces = around(20, 30), (Piece((Plane.of((0, 0.2, 1), 0.1),)),)
    renderer.set_atoms(atoms)
    once = draw(renderer, camera, *pieces)
    assert np.array_equal(draw(renderer, camera, *pieces).rgb, once.rgb)
    rng = np.random.default_rng(1)
    a, b = rng.permutation(len(atoms.surface)), rng.permutation(len(atoms.interior))
    renderer.set_atoms(rows_of(atoms, a, b))
    assert np.abs(draw(renderer, camera, *pieces).rgb - once.rgb).max() <= 1 / 255


@pytest.mark.parametrize("distance", [0.6, 1.0, 3.0])
def test_culling_changes_no_pixel(renderer: Renderer, distance: float) -> None:
    renderer.set_atoms(tight_ball(1 / 24))
    assert (renderer._solids[0].skin.culling.min_cosine <= 1).mean() > 0.9
    for azimuth, elevation in ((30, 35), (200, -20), (0, 80)):
        camera = around(azimuth, elevation, distance)
        for planes in ((), (Plane.of((0, 0, 1), 0),), CUTS["three cuts"], (Plane.of((0, 0, 1), -0.45),)):
            for _ in range(2):
                draw(renderer, camera, Piece(planes), exact=False)  # a plane gets a grid when it is seen again
            for exact in (True, False):
                few = draw(renderer, camera, Piece(planes), exact=exact)
                all_of_them = draw(renderer, camera, Piece(planes), exact=exact, cull=False)
                assert np.abs(few.rgb - all_of_them.rgb).max() <= 1 / 255
                assert np.abs(few.alpha - all_of_them.alpha).max() <= 1 / 255


def with_pinholes(atoms: Atoms, share: float = 0.12, size: float = 0.75) -> Atoms:
    """The skin without a share of its atoms, the rest a little smaller and of random colours."""
    rng = np.random.default_rng(4)
    kept = rng.random(len(atoms.surface)) > share
    s = atoms.surface
    sh = s.sh.copy()
    sh[:, 0] = rng.uniform(-1.5, 1.5, (len(s), 3))
    scales = s.scales * np.array([size, size, 1], np.float32)
    return rows_of(replace(atoms, surface=replace(s, scales=scales, sh=sh)), kept)


def test_what_stands_behind_pinholes_counts(renderer: Renderer) -> None:
    """Skins of captures have holes finer than anything known of them before a frame is drawn."""
    renderer.set_atoms(with_pinholes(tight_ball(1 / 24)))
    assert (renderer._solids[0].skin.culling.min_cosine <= 1).mean() > 0.5
    leaks = 0
    for k, distance in enumerate((0.4, 0.7, 1.0, 1.5, 3.0)):
        camera = around(50 * k, 60 - 30 * k, distance, 200, 150)
        for planes in ((), (Plane.of((0.3, 0, 1), 0.05),)):
            few = draw(renderer, camera, Piece(planes))
            all_of_them = draw(renderer, camera, Piece(planes), cull=False)
            assert np.abs(few.rgb - all_of_them.rgb).max() <= 1 / 255
            leaks += ((all_of_them.depth > np.linalg.norm(camera.position) + 0.1) & (few.alpha > 0.5)).sum()
    assert leaks > 20


def test_a_shell_with_a_hole_hides_nothing(renderer: Renderer) -> None:
    """The far side is seen from within through a hole in the skin, so no atom may be left out."""
    atoms = tight_ball(1 / 24)
    renderer.set_atoms(rows_of(atoms, atoms.surface.means[:, 2] < 0.4))
    assert (renderer._solids[0].skin.culling.min_cosine > 1).all()


def test_silhouettes_of_a_piece_before_another_let_no_background_through(renderer: Renderer) -> None:
    renderer.set_atoms(tight_ball(1 / 20))
    camera = around(0, 0, 1.5)
    aside = np.eye(4)
    aside[:3, 3] = 0.6, 0.25, 0.1  # towards the camera
    pieces = Piece(), Piece((), aside)
    light, dark = (draw(renderer, camera, *pieces, background=b) for b in ((1, 1, 1), (0, 0, 0)))
    behind = draw(renderer, camera, Piece()).alpha > 0.999
    front = draw(renderer, camera, pieces[1]).alpha
    edge = behind & (front > 0.02) & (front < 0.98)
    assert edge.sum() > 10
    assert np.abs(light.rgb - dark.rgb)[behind].max() <= 2 / 255


def test_inner_edges_let_no_background_through(renderer: Renderer) -> None:
    """At a leaf's edge the ball behind it covers what the leaf leaves open."""
    alone = tight_ball(1 / 24)
    atoms = with_leaf(alone, (0.66, 0.38, 0.53), spacing=1.1)
    for camera in (around(30, 35, 0.8, 200, 150), around(80, 35, 1.0, 200, 150), around(210, -35, 1.0, 200, 150)):
        renderer.set_atoms(alone)
        covered = draw(renderer, camera).alpha > 0.999
        renderer.set_atoms(atoms)
        light, dark = (draw(renderer, camera, background=b) for b in ((1, 1, 1), (0, 0, 0)))
        assert covered.sum() > 2000
        assert np.abs(light.rgb - dark.rgb)[covered].max() <= 1 / 255


def test_culling_leaves_out_nothing_that_covers_an_edge(renderer: Renderer) -> None:
    """Where the skin in front covers a pixel in part, the far side of the ball covers the rest."""
    renderer.set_atoms(with_leaf(with_pinholes(tight_ball(1 / 24), 0.5, 0.6), (0.66, 0.38, 0.53), spacing=1.1))
    assert (renderer._solids[0].skin.culling.min_cosine <= 1).mean() > 0.9
    for camera in (around(30, 35, 0.8, 200, 150), around(80, 35, 1.0, 80, 60)):
        for planes in ((), (Plane.of((0.3, 0, 1), -0.2),)):
            few, all_of_them = (draw(renderer, camera, Piece(planes), cull=cull) for cull in (True, False))
            assert np.abs(few.rgb - all_of_them.rgb).max() <= 1 / 255
            assert np.abs(few.alpha - all_of_them.alpha).max() <= 1 / 255


def test_zoom_sweep(renderer: Renderer) -> None:
    """From a tenth of the fitting distance (by focal length: the eye stays outside) to ten times."""
    renderer.set_atoms(ball(1 / 20))
    for distance in np.geomspace(0.1, 10, 13):
        camera = around(30, 20, max(distance, 1.0))
        zoom = max(1.0, 1 / distance)
        camera = replace(camera, fx=camera.fx * zoom, fy=camera.fy * zoom)
        picture = draw(renderer, camera)
        y, x = np.mgrid[:90, :120] + 0.5
        reach = 0.5 / math.sqrt(np.linalg.norm(camera.position) ** 2 - 0.25) * camera.fx
        inside = np.hypot(x - camera.cx, y - camera.cy) < reach - 1.5
        outside = np.hypot(x - camera.cx, y - camera.cy) > reach * 1.06 + 2
        assert inside.any()
        assert picture.alpha[inside].min() >= 0.99, distance
        assert picture.alpha[outside].max(initial=0) <= 0.01, distance


def test_orbit_sweep(renderer: Renderer) -> None:
    """Over steps of one degree each frame differs from the last by about as much: nothing pops."""
    renderer.set_atoms(ball(1 / 20))
    pieces = (Piece((Plane.of((0.2, 0, 1), 0),)),)
    frames = []
    for step in range(25):
        picture = draw(renderer, around(step, 35), *pieces)
        y, x = np.mgrid[:90, :120]
        disc = np.hypot(x - 60, (y - 55) * 1.4) < 25  # well within the face
        assert picture.alpha[disc].min() >= 0.99
        frames.append(picture.rgb)
    steps = [np.abs(b - a).mean() for a, b in pairwise(frames)]
    assert max(steps) < 1.6 * np.median(steps)
    assert max(np.abs(b - a).mean(2).max() for a, b in pairwise(frames)) < 0.8
