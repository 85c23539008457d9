"""The GL engine beyond its formula: updates, levels, picking, overlays, other modes, and what can go wrong."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import get_args

import moderngl
import numpy as np
import pytest
import torch
from scipy import ndimage

from engine.errors import InputError
from engine.render.culling.draw_options import Mode, SplatLook
from engine.render.gl import Lines, PictureSheet, Renderer, Sheet
from engine.render.gl.classic import PORTION
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians
from engine.scene.image import psnr
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from tests.helpers.gl_scenes import around, brush_case, draw, tight_ball
from tests.helpers.solids import ball
from tests.paths import SHARED
from tests.reference.classic import picture as classic_picture
from tests.reference.opaque import reference

REFERENCE = SHARED / "reference"
HALF = Plane.of((0, 0, 1), 0)


def some(n_surface: int, n_interior: int, seed: int = 0) -> Atoms:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n_surface, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    surface = SurfaceAtoms(
        rng.uniform(-0.4, 0.4, (n_surface, 3)).astype(np.float32),
        np.full((n_surface, 3), 0.05, np.float32),
        quats.astype(np.float32),
        rng.normal(size=(n_surface, 1, 3)).astype(np.float32),
    )
    means = rng.uniform(-0.4, 0.4, (n_interior, 3)).astype(np.float32)
    rgb = rng.uniform(0, 1, (n_interior, 3)).astype(np.float32)
    return Atoms(surface, InteriorAtoms(means, np.full(n_interior, 0.05, np.float32), rgb), 0.1)


def pixel(camera: Camera, point: tuple[float, float, float]) -> tuple[int, int]:
    """Row and column of the pixel that shows a world point."""
    x, y, z = camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3]
    return int(camera.fy * y / z + camera.cy), int(camera.fx * x / z + camera.cx)


def test_colours_in_place(renderer: Renderer) -> None:
    atoms = ball(1 / 16, degree=2)
    camera, pieces = around(30, 40), (Piece((HALF,)),)
    renderer.set_atoms(atoms)
    draw(renderer, camera, *pieces)
    draw(renderer, camera, *pieces, mode="interior")
    fresh = replace(
        atoms,
        surface=replace(atoms.surface, sh=atoms.surface.sh[::-1].copy()),
        interior=replace(atoms.interior, rgb=1 - atoms.interior.rgb),
    )
    renderer.update_colours(fresh.surface.sh, fresh.interior.rgb)
    updated = [draw(renderer, camera, *pieces, mode=mode) for mode in ("opaque", "interior")]
    renderer.set_atoms(fresh)
    for mode, picture in zip(("opaque", "interior"), updated, strict=True):
        assert np.array_equal(picture.rgb, draw(renderer, camera, *pieces, mode=mode).rgb)


def test_coarser_levels_keep_the_shape(renderer: Renderer) -> None:
    renderer.set_atoms(tight_ball(1 / 24))
    camera, pieces = around(30, 40, width=200, height=150), (Piece((HALF,)),)
    full = draw(renderer, camera, *pieces)
    quality = []
    for level in (1, 2):
        coarse = draw(renderer, camera, *pieces, level=level)
        assert (np.abs(coarse.alpha - full.alpha) > 0.5).mean() < 0.06
        assert coarse.alpha[ndimage.binary_erosion(full.alpha > 0.99, iterations=6)].min() > 0.99
        quality.append(psnr(coarse.rgb, full.rgb))
    assert quality[0] > quality[1] > 16
    assert np.array_equal(draw(renderer, camera, *pieces).rgb, full.rgb)


def test_the_interior_alone_lies_within_the_solid(renderer: Renderer) -> None:
    atoms = tight_ball(1 / 24)
    renderer.set_atoms(atoms)
    camera = around(30, 40)
    solid, inside = draw(renderer, camera), draw(renderer, camera, mode="interior")
    around_it = ndimage.binary_dilation(solid.alpha > 0, iterations=3)
    assert inside.alpha[~around_it].max() < 0.02
    assert inside.alpha.sum() > 0.85 * solid.alpha.sum()
    red = np.broadcast_to(np.array([1, 0, 0], np.float32), atoms.interior.rgb.shape)
    renderer.update_colours(rgb=np.ascontiguousarray(red))
    shown = draw(renderer, camera, mode="interior", background=(0, 0, 0))
    assert np.abs(shown.rgb[..., 1:]).max() < 1e-3


def test_the_interior_alone_is_solid(renderer: Renderer) -> None:
    """Its outer atoms leave no gaps, near or far: neither the far side nor the background shows through."""
    atoms = ball(1 / 30)
    inside = atoms.interior
    for azimuth, elevation in ((0, 0), (45, 35)):
        camera = around(azimuth, elevation, 1.2)
        near = (inside.means @ camera.forward < 0.15)[:, None]
        rgb = np.where(near, np.array([1, 0, 0], np.float32), np.array([0, 0, 1], np.float32))
        renderer.set_atoms(replace(atoms, interior=replace(inside, rgb=rgb)))
        for distance in (0.5, 1.2, 4.0):
            shown = draw(renderer, around(azimuth, elevation, distance), mode="interior", background=(0, 1, 0))
            within = ndimage.binary_erosion(ndimage.binary_fill_holes(shown.alpha > 0.5), iterations=5)
            assert within.sum() > 50
            assert shown.alpha[within].min() > 0.99
            rim = ndimage.binary_erosion(within, iterations=2 if distance > 2 else 6)
            assert shown.rgb[rim][:, 0].min() > 0.95


def test_pick(renderer: Renderer) -> None:
    renderer.set_atoms(tight_ball(1 / 24))
    camera = around(0, 40, 1.6)
    up = np.eye(4)
    up[2, 3] = 0.3
    pieces = Piece((HALF,)), Piece((HALF.flipped(),), up)
    picture = draw(renderer, camera, *pieces)
    for index, target in ((0, (0.2, 0.1, 0.0)), (1, (0.3, 0.0, 0.7))):
        row, column = pixel(camera, target)
        piece, point = renderer.pick(column, row)
        assert piece == index
        assert point is not None
        assert np.linalg.norm(point - target) < 0.06
    assert picture.alpha[0, 0] == 0
    assert renderer.pick(0, 0) == (None, None)
    assert renderer.pick(-1, 500) == (None, None)
    # Pieces that lie together are told apart by the picked point.
    renderer.render(around(0, 0, 1.6), (Piece((HALF,)), Piece((HALF.flipped(),))))
    assert renderer.pick(60, 30)[0] == 1
    assert renderer.pick(60, 60)[0] == 0


def test_overlays(renderer: Renderer) -> None:
    renderer.set_atoms(tight_ball(1 / 24))
    camera = around(0, 0, 1.5)
    before = draw(renderer, camera, background=(0, 0, 0)).rgb
    line = Lines(np.array([[[0, -0.9, 0], [0, 0.9, 0]]]), (1, 0, 0, 1), width=3, hidden=0.0)
    sheet = Sheet(np.array([[0.6, -1, 0.3], [0.6, 1, 0.3], [0.6, 1, 0.6], [0.6, -1, 0.6]]), (0, 0, 1, 0.5))
    texture = renderer.overlay([line, sheet])
    shown = np.frombuffer(texture.read(), np.float16).reshape(90, 120, 4).astype(np.float32)
    assert np.array_equal(shown[pixel(camera, (0, 0, 0))][:3], before[pixel(camera, (0, 0, 0))])  # behind the ball
    assert np.allclose(shown[pixel(camera, (0, 0.7, 0))], [1, 0, 0, 1])  # beside it
    assert np.allclose(shown[pixel(camera, (0.6, 0.6, 0.45))], [0, 0, 0.5, 1], atol=0.01)
    assert (shown[..., 3] == 1).all()
    assert np.array_equal(renderer.read().rgb, before)


def test_a_picture_lies_on_a_face_and_is_hidden_behind_it(renderer: Renderer) -> None:
    renderer.set_atoms(tight_ball(1 / 24))
    camera = around(0, 0, 1.5)
    before = draw(renderer, camera, background=(0, 0, 0)).rgb
    quarters = np.array([[[255, 0, 0, 255], [0, 255, 0, 255]], [[0, 0, 255, 255], [255, 255, 255, 0]]], np.uint8)
    # Seen from x, with y to the right and z up, as high as the frame; once before the ball and once behind it.
    corners = np.array([[0, -0.8, 0.8], [0, 0.8, 0.8], [0, 0.8, -0.8], [0, -0.8, -0.8]])
    for x, hides in ((0.7, True), (-0.7, False)):
        texture = renderer.overlay([PictureSheet(corners + np.array([x, 0, 0]), quarters.repeat(8, 0).repeat(8, 1))])
        shown = np.frombuffer(texture.read(), np.float16).reshape(90, 120, 4).astype(np.float32)
        for y, z, colour in ((-0.2, 0.2, (1, 0, 0)), (0.2, 0.2, (0, 1, 0)), (-0.2, -0.2, (0, 0, 1)), (0.2, -0.2, None)):
            at = pixel(camera, (x, y, z))
            expected = before[at] if colour is None or not hides else colour
            assert np.allclose(shown[at][:3], expected, atol=0.01)
    assert np.allclose(shown[pixel(camera, (-0.7, -0.7, 0.7))], [1, 0, 0, 1], atol=0.01)  # beside the ball


def test_an_overlay_shows_the_whole_frame(renderer: Renderer) -> None:
    """Whatever was bound before, with any scissor, and whatever the overlay showed before."""
    renderer.set_atoms(tight_ball(1 / 24))
    ctx, first = renderer.ctx, renderer.ctx.fbo
    other = ctx.simple_framebuffer((300, 200))
    for azimuth in (0, 70):
        for scissor in (None, (40, 30, 7, 5)):
            frame = draw(renderer, around(azimuth, 20), Piece((HALF,)), background=(azimuth / 100, 0.5, 0)).rgb
            other.scissor = scissor  # type: ignore[assignment]  # None: no scissor in moderngl
            other.use()
            copy = np.frombuffer(renderer.overlay([]).read(), np.float16).reshape(90, 120, 4)
            assert np.array_equal(copy[..., :3].astype(np.float32), frame)
    first.use()  # a bound framebuffer must not be released
    other.release()


def test_in_the_context_of_another(renderer: Renderer) -> None:
    """The owner's state does not change the picture, and afterwards the owner draws as before to what it has bound."""
    owner = renderer.ctx
    atoms, camera, pieces = tight_ball(1 / 20), around(30, 40), (Piece((HALF,)),)
    renderer.set_atoms(atoms)
    renderer.set_capture(capture(50))
    expected = [draw(renderer, camera, *pieces, mode=mode).rgb for mode in ("opaque", "classic", "interior")]
    first = owner.fbo
    mine = owner.framebuffer([owner.texture((64, 32), 4)], owner.depth_texture((64, 32)))
    program = owner.program(
        vertex_shader="#version 330\nin vec2 p; void main() { gl_Position = vec4(p, 0.0, 1.0); }",
        fragment_shader="#version 330\nout vec4 c; void main() { c = vec4(1.0, 0.5, 0.25, 0.5); }",
    )
    array = owner.vertex_array(program, owner.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32)), "p")

    def own_frame() -> bytes:
        mine.clear(0.2, 0.4, 0.6, 1.0)
        owner.enable(moderngl.BLEND | moderngl.CULL_FACE)
        array.render()
        return mine.read(components=4)

    for shaders in (True, False):
        guest = Renderer(owner, shaders=shaders)
        mine.viewport, mine.scissor = (10, 5, 40, 20), (20, 10, 12, 9)
        mine.use()
        owner.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        before = own_frame()
        guest.set_atoms(atoms)
        guest.set_capture(capture(50))
        for mode, picture in zip(get_args(Mode), expected, strict=True):
            owner.blend_func = moderngl.DST_COLOR, moderngl.ZERO
            owner.enable(moderngl.BLEND | moderngl.CULL_FACE | moderngl.DEPTH_TEST)
            owner.depth_func = ">"
            guest.render(camera, pieces, mode=mode)
            assert np.abs(guest.read().rgb - picture).max() <= 1 / 255
            guest.overlay([Lines(np.zeros((1, 2, 3)), (1, 0, 0, 1))])
            guest.pick(60, 45)
            assert owner.detect_framebuffer().glo == mine.glo
            mine.use()  # restores the owner's viewport and scissor
            assert own_frame() == before
        guest.release()
        assert owner.error == "GL_NO_ERROR"
    first.use()  # a bound framebuffer must not be released
    for item in (array, program, mine):
        item.release()


def test_brush_tiny_case(renderer: Renderer) -> None:
    gaussians, camera, true = brush_case()
    renderer.set_capture(gaussians)
    ours = draw(renderer, camera, mode="classic", background=(0, 0, 0))
    assert np.abs(ours.rgb - true[..., :3]).max() <= 2 / 255
    assert np.abs(ours.alpha - true[..., 3]).max() <= 2 / 255


def capture(count: int = 150, seed: int = 5) -> Gaussians:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(count, 4))
    return Gaussians(
        rng.uniform(-0.4, 0.4, (count, 3)).astype(np.float32),
        np.exp(rng.uniform(-5, -2, (count, 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0.1, 1, count).astype(np.float32),
        (0.3 * rng.normal(size=(count, 16, 3))).astype(np.float32),
    )


def test_classic_parity(renderer: Renderer) -> None:
    gaussians = capture()
    renderer.set_capture(gaussians)
    for camera in (around(30, 20, width=60, height=45), around(210, -50, 0.7, 60, 45)):
        values = (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities, gaussians.sh)
        means, scales, quats, opacities, colours = (torch.as_tensor(v, dtype=torch.float64) for v in values)
        rgb, _, _ = classic_picture(means, scales, quats, opacities, colours, camera, (1.0, 1.0, 1.0))
        assert psnr(draw(renderer, camera, mode="classic").rgb, rgb.numpy()) >= 40


@pytest.mark.parametrize("shaders", [True, False], ids=["as on a card", "in software"])
def test_slabs_of_a_capture_add_up(shaders: bool) -> None:
    """Hundreds of faint layers under opaque ones: nothing is lost to half floats, nor where nothing more shows."""
    gaussians, camera = capture(6 * PORTION), around(30, 20, width=60, height=45)
    faint = np.random.default_rng(0).random(len(gaussians)) < 0.8
    gaussians = replace(gaussians, opacities=np.where(faint, 0.02, 0.9).astype(np.float32))
    values = (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities, gaussians.sh)
    means, scales, quats, opacities, colours = (torch.as_tensor(v, dtype=torch.float64) for v in values)
    rgb, alpha, far = classic_picture(means, scales, quats, opacities, colours, camera, (1.0, 1.0, 1.0))
    with Renderer(shaders=shaders) as renderer:
        renderer.set_capture(gaussians)
        for exact, decibels, off in ((True, 65, 1e-3), (False, 50, 1e-2)):
            seen = draw(renderer, camera, mode="classic", exact=exact)
            assert psnr(seen.rgb, rgb.numpy()) >= decibels
            assert np.abs(seen.alpha - alpha.numpy()).max() < off
            in_sight = alpha.numpy() > 0.1
            assert np.abs(seen.depth * alpha.numpy() - far.numpy())[in_sight].max() < off


def test_a_look_draws_splats_of_other_sizes_and_opacities(renderer: Renderer) -> None:
    gaussians, camera, look = capture(), around(30, 20, width=60, height=45), SplatLook(0.5, 0.4)
    renderer.set_capture(gaussians)
    seen = draw(renderer, camera, mode="classic", look=look)
    made = replace(gaussians, scales=gaussians.scales * 0.5, opacities=gaussians.opacities * np.float32(0.4))
    renderer.set_capture(made)
    assert psnr(seen.rgb, draw(renderer, camera, mode="classic").rgb) > 60
    atoms = ball(1 / 16, degree=0)
    surface = replace(atoms.surface, scales=atoms.surface.scales * np.float32(0.6))
    interior = replace(atoms.interior, sigmas=atoms.interior.sigmas * np.float32(0.6))
    made_small = replace(atoms, surface=surface, interior=interior)
    for pieces in ((Piece(),), (Piece((HALF,)),)):
        renderer.set_atoms(atoms)
        seen = draw(renderer, camera, *pieces, look=SplatLook(0.6))
        renderer.set_atoms(replace(made_small, pitch=0.6 * atoms.pitch))
        assert psnr(seen.rgb, draw(renderer, camera, *pieces).rgb) > 30


def test_the_camera_does_not_wait_for_the_sort(renderer: Renderer) -> None:
    renderer.set_capture(capture(4000))
    near, far = around(0, 20), around(120, -30)
    draw(renderer, near, mode="classic")
    assert not renderer.sorting
    exact = draw(renderer, far, mode="classic")
    draw(renderer, near, mode="classic")
    draw(renderer, far, mode="classic", wait=False)
    assert renderer.sorting
    stop = time.monotonic() + 20
    while renderer.sorting and time.monotonic() < stop:
        time.sleep(0.01)
        late = draw(renderer, far, mode="classic", wait=False)
    assert np.array_equal(late.rgb, exact.rgb)


# What can go wrong.


@pytest.mark.parametrize(("surface", "interior"), [(0, 0), (1, 0), (0, 1), (1, 1)])
@pytest.mark.parametrize("mode", ["opaque", "interior", "classic"])
def test_hardly_any_atoms(renderer: Renderer, surface: int, interior: int, mode: str) -> None:
    renderer.set_atoms(some(surface, interior))
    renderer.set_capture(capture(surface))
    for planes in ((), (Plane.of((0, 0, 1), 0.01),)):
        picture = draw(renderer, around(10, 20), Piece(planes), mode=mode)
        assert np.isfinite(picture.rgb).all()
        assert (picture.alpha <= 1).all()


def test_nothing_set(renderer: Renderer) -> None:
    with Renderer() as empty:
        for mode in ("opaque", "classic", "interior"):
            assert not draw(empty, around(0, 0), mode=mode).alpha.any()
        assert draw(empty, around(0, 0), background=(0.5, 0, 1)).rgb[3, 3].tolist() == [0.5, 0, 1]
        assert empty.ctx.error == "GL_NO_ERROR"


def test_camera_inside_and_planes_through_it(renderer: Renderer) -> None:
    renderer.set_atoms(tight_ball(1 / 20))
    inside = around(20, 10, 0.1)
    eye = inside.position
    for planes in ((), (HALF,), (Plane.through(eye, (0, 0, 1)),), (Plane.through(eye, inside.forward),)):
        for piece in (Piece(planes), Piece(tuple(p.flipped() for p in planes))):
            assert np.isfinite(draw(renderer, inside, piece).rgb).all()
    # A camera in the removed part sees the face fill the picture.
    seen = draw(renderer, around(0, 90, 0.08), Piece((HALF,)))
    assert seen.alpha.min() > 0.99


def test_tangent_plane(renderer: Renderer) -> None:
    atoms = ball(1 / 8)
    renderer.set_atoms(atoms)
    camera = around(20, 60, 2.0, 60, 45)
    for plane in (Plane.of((0, 0, 1), -0.5), Plane.of((0, 0, -1), 0.5)):
        rgb, alpha, _ = reference(atoms, camera, (plane,))
        ours = draw(renderer, camera, Piece((plane,)))
        assert psnr(ours.rgb, rgb) >= 45
        assert psnr(ours.alpha, alpha) >= 45


def test_thirty_planes(renderer: Renderer) -> None:
    renderer.set_atoms(tight_ball(1 / 20))
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(30, 3))
    planes = tuple(Plane.of(n, -0.3 * float(np.linalg.norm(n))) for n in normals)
    cut = draw(renderer, around(20, 30), Piece(planes))
    seen = np.isfinite(cut.depth)
    rows, columns = np.nonzero(seen)
    camera = around(20, 30)
    z = cut.depth[seen].astype(np.float64)
    ray = np.stack([(columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z, z], 1)
    points = (ray - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
    most = np.max([p.distance(points) for p in planes], axis=0)
    assert np.abs(most).max() < 1e-5  # every pixel lies on the polyhedron
    assert cut.alpha[seen].min() > 0.99
    twice = draw(renderer, around(20, 30), Piece(planes + planes))
    assert np.array_equal(twice.rgb, cut.rgb)
    many = tuple(Plane.of(n, -0.45 * float(np.linalg.norm(n))) for n in rng.normal(size=(400, 3)))
    with pytest.raises(InputError, match="planes"):
        draw(renderer, around(20, 30), Piece(many))


def test_needles_and_dust(renderer: Renderer) -> None:
    atoms = some(200, 50)
    scales = atoms.surface.scales.copy()
    scales[:100] = [1e-7, 1e-7, 0.2]
    scales[100:150] = [1e-9, 0.1, 0.1]
    scales[150:] = 1e-9
    renderer.set_atoms(replace(atoms, surface=replace(atoms.surface, scales=scales)))
    for distance in (0.2, 1.0, 10.0):
        for planes in ((), (Plane.of((0.3, 0.2, 1), 0.01),)):
            picture = draw(renderer, around(10, 20, distance), Piece(planes))
            assert np.isfinite(picture.rgb).all()


def test_sizes(renderer: Renderer) -> None:
    renderer.set_atoms(tight_ball(1 / 20))
    pieces = (Piece((HALF,)),)
    first = draw(renderer, around(20, 30, width=64, height=48), *pieces)
    for width, height in ((1, 1), (300, 2), (2, 300), (33, 77)):
        picture = draw(renderer, around(20, 30, width=width, height=height), *pieces)
        assert picture.rgb.shape == (height, width, 3)
        renderer.overlay([])
        renderer.set_capture(capture(10))
        assert draw(renderer, around(20, 30, width=width, height=height), mode="classic").alpha.shape == (height, width)
    again = draw(renderer, around(20, 30, width=64, height=48), *pieces)
    assert np.array_equal(first.rgb, again.rgb)


def test_far_from_the_origin(renderer: Renderer) -> None:
    """A capture with world coordinates in the thousands looks as it does at the origin."""
    atoms, away = tight_ball(1 / 20), np.array([4096, -8192, 1024], np.float32)
    camera, plane = around(20, 30), Plane.of((0.1, 0, 1), 0.05)
    renderer.set_atoms(atoms)
    home = draw(renderer, camera, Piece((plane,)))
    view = camera.viewmat.copy()
    view[:3, 3] -= view[:3, :3] @ away.astype(np.float64)
    moved = replace(
        atoms,
        surface=replace(atoms.surface, means=atoms.surface.means + away),
        interior=replace(atoms.interior, means=atoms.interior.means + away),
    )
    renderer.set_atoms(moved)
    there = Plane.of(plane.normal, plane.offset - float(np.dot(plane.normal, away.astype(np.float64))))
    assert psnr(draw(renderer, replace(camera, viewmat=view), Piece((there,))).rgb, home.rgb) > 35
