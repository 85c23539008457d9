"""The look in GLSL equals the look in Python, term by term.

Each law that both implement is evaluated by a small shader, built from the files that the renderer includes and
captured by transform feedback, and by the Python function, on the same table of inputs.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from importlib.resources import files
from typing import Any

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from engine.render.cpu import splats as record
from engine.render.cpu.ray_entry import coverage, coverage_of, enter, face_light, facing_of, shade, skin_part
from engine.render.cpu.software_frame import GroupLayers, resolve_row
from engine.render.cpu.splats import RECORD, Splats, project
from engine.render.cpu.weights import BEFORE, BEHIND, SUMS, depth_weight, outside_shares, resolve
from engine.render.culling.view import View
from engine.render.defines import CONSTANTS
from engine.render.gl import Renderer
from engine.render.gl.context import layout, write_uniforms
from engine.render.projection import camera_record
from engine.scene import constants, sh
from engine.scene.camera import Camera
from engine.scene.rotations import normalised_quats, rotation_matrices
from shaders import source
from tests.reference.opaque import coverage as covered_by

Double = NDArray[np.float64]

COUNT = 60
"""Rows in a table."""

CLOSE = 2e-5
"""Relative tolerance: a few float32 operations."""


def glsl(*names: str, main: str, **defines: int) -> str:
    """A vertex shader made of these files of the package and a main function."""
    first, *others = names
    included = [source(name, {}).removeprefix("#version 330 core\n") for name in others]
    return "\n".join([source(first, CONSTANTS | defines), *included, main])


def evaluate(
    renderer: Renderer, shader: str, inputs: dict[str, Any], outputs: dict[str, int], **uniforms: Any
) -> list[Double]:
    """Each of the outputs (N, floats) of a vertex shader, run once for each row of the inputs (N, floats)."""
    renderer.render(cameras()[0], mode="classic")  # leaves a complete framebuffer bound, as transform feedback needs
    ctx = renderer.ctx
    program = ctx.program(vertex_shader=shader, varyings=tuple(outputs))
    write_uniforms(program, uniforms)
    columns = {name: np.reshape(values, (len(values), -1)) for name, values in inputs.items()}
    rows = np.concatenate(list(columns.values()), 1).astype(np.float32)
    given = ctx.buffer(np.ascontiguousarray(rows))
    result = ctx.buffer(reserve=4 * len(rows) * sum(outputs.values()))
    fields = {name: values.shape[1] for name, values in columns.items()}
    array = ctx.vertex_array(program, [layout(program, given, fields)])
    array.transform(result, moderngl.POINTS, vertices=len(rows))
    values = np.frombuffer(result.read(), np.float32).reshape(len(rows), -1).astype(np.float64)
    for item in (array, given, result, program):
        item.release()
    return np.split(values, np.cumsum(list(outputs.values()))[:-1], axis=1)


def cameras() -> list[Camera]:
    """A pinhole and an orthographic camera, neither centred nor with square pixels."""
    rotation = rotation_matrices(normalised_quats(np.array([[0.9, 0.2, -0.3, 0.1]])))[0]
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = rotation, (0.1, -0.2, 3.0)
    return [
        Camera(view, 90.0, 110.0, 33.0, 21.0, 64, 48, near=0.1),
        Camera(view, 20.0, 25.0, 33.0, 21.0, 64, 48, orthographic=True),
    ]


def splats() -> Splats:
    """Discs, needles and balls in and beside the picture, float64 with float32 values."""
    rng = np.random.default_rng(3)
    means = rng.uniform(-1.2, 1.2, (COUNT, 3))
    scales = np.exp(rng.uniform(-4, -0.5, (COUNT, 3)))
    scales[:5, 0] = 1e-5
    quats = rng.normal(size=(COUNT, 4)) * rng.uniform(0.5, 2, (COUNT, 1))
    return Splats(*(a.astype(np.float32).astype(np.float64) for a in (means, scales, quats)))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spherical_harmonics(renderer: Renderer, degree: int) -> None:
    rng = np.random.default_rng(degree)
    directions = rng.normal(size=(COUNT, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    bands = (degree + 1) ** 2
    vectors = -(-3 * bands // 4)
    packed = np.zeros((COUNT, 4 * vectors))
    packed[:, : 3 * bands] = rng.normal(size=(COUNT, 3 * bands))
    main = "in vec3 way; out vec3 colour; void main() { colour = sh_colour(way); }"
    shader = glsl("sh.glsl", main=main, SH_DEGREE=degree, SH_VECTORS=vectors)
    (colour,) = evaluate(renderer, shader, {"sh": packed, "way": directions}, {"colour": 3})
    expected = sh.colours(packed[:, : 3 * bands].reshape(COUNT, bands, 3), directions)
    assert (expected > 0).mean() > 0.4
    assert np.allclose(colour, expected, rtol=CLOSE, atol=CLOSE)


def test_rotation(renderer: Renderer) -> None:
    """A quaternion of any length gives its rotation; one of length zero turns nothing."""
    quats = splats().quats.copy()
    quats[0] = 0
    main = "in vec4 q; out mat3 turn; void main() { turn = rotation_of(q); }"
    (columns,) = evaluate(renderer, glsl("shape.glsl", main=main), {"q": quats}, {"turn": 9})
    expected = rotation_matrices(normalised_quats(quats)).transpose(0, 2, 1).reshape(COUNT, 9)  # GLSL stores columns
    assert np.allclose(columns, expected, atol=CLOSE)


def test_face_coverage(renderer: Renderer) -> None:
    """Also of the kernels' branch-free version."""
    rng = np.random.default_rng(1)
    density = rng.uniform(0, 2 * constants.SOLID_DENSITY, COUNT).astype(np.float32)
    footprint = np.exp(rng.uniform(-6, 1, COUNT)).astype(np.float32)
    pitch = 0.04
    main = (
        "in float density; in float footprint; out float covered;"
        "void main() { covered = face_coverage(density, footprint, 0.02); }"
    )
    table = {"density": density, "footprint": footprint}
    (covered,) = evaluate(renderer, glsl("face_look.glsl", main=main), table, {"covered": 1})
    expected = coverage(density.astype(np.float64), footprint.astype(np.float64), pitch)
    assert ((expected > 0) & (expected < 1)).sum() > 10
    assert np.allclose(covered[:, 0], expected, atol=CLOSE)
    edge = np.float32(pitch / 2)
    kernel = [coverage_of(d, f, edge) for d, f in zip(density, footprint, strict=True)]
    assert np.allclose(kernel, expected, atol=CLOSE)


def test_skin_part(renderer: Renderer) -> None:
    """From no interior to more than a full lattice."""
    interior = np.linspace(0, 1.2 * constants.LATTICE_DENSITY, COUNT).astype(np.float32)
    main = "in float interior; out float part; void main() { part = skin_part(interior); }"
    (part,) = evaluate(renderer, glsl("face_look.glsl", main=main), {"interior": interior}, {"part": 1})
    expected = [skin_part(i) for i in interior]
    assert {0.0, 1.0} < set(expected)
    assert np.allclose(part[:, 0], expected, atol=CLOSE)


def test_outside_shares(renderer: Renderer) -> None:
    """From nothing to more than enough, in the layer, before and behind it; also in software GL's version."""
    rng = np.random.default_rng(2)
    weights = (rng.uniform(0.2, 1, (COUNT, 3)) * (rng.random((COUNT, 3)) > 0.1)).astype(np.float32)
    edges = (weights * rng.uniform(1, 2, (COUNT, 3))).astype(np.float32)
    main = "in vec3 weights; in vec3 edges; out vec3 shares; void main() { shares = outside_shares(weights, edges); }"
    table = {"weights": weights, "edges": edges}
    (shares,) = evaluate(renderer, glsl("outside_look.glsl", main=main), table, {"shares": 3})
    here, before, behind = covered_by(weights.astype(np.float64), edges.astype(np.float64)).T
    expected = np.stack([(1 - before) * here, before, (1 - before) * (1 - here) * behind], 1)
    expected[weights[:, 0] == 0] = 0
    assert ((expected > 0) & (expected < 1)).all(1).sum() > 10
    assert np.allclose(shares, expected, atol=CLOSE)

    sums = np.zeros((1, COUNT, SUMS), np.float32)
    places = [0, BEFORE, BEHIND]
    sums[0][:, places], sums[0][:, [p + 1 for p in places]] = weights, edges
    sums[0][:, [p + 2 + k for k, p in enumerate(places)]] = weights  # each has its own colour
    sums[0][:, BEHIND + 5] = weights[:, 2]
    kernel = [outside_shares(row) for row in sums[0]]
    assert np.allclose(kernel, expected, atol=CLOSE)
    rgb, alpha = np.empty((1, COUNT, 3), np.float32), np.empty((1, COUNT), np.float32)
    resolve(0, sums, rgb, alpha)
    depth, no_face = np.ones((1, COUNT), np.float32), np.zeros((1, 0, 4), np.float32)
    layers = GroupLayers(0, 0, sums, depth, False, no_face, depth, np.float32(0), np.float32(0))
    lane = np.empty((5, COUNT), np.float32)
    resolve_row(0, layers, np.float32(constants.NOTHING), lane)
    for found_rgb, found_alpha in ((rgb[0], alpha[0]), (lane[2:].T, lane[1])):
        assert np.allclose(found_rgb, expected, atol=CLOSE)
        assert np.allclose(found_alpha, expected.sum(1), atol=CLOSE)


def test_depth_weight(renderer: Renderer) -> None:
    """A quarter for each layer's depth, down to a bound; independent of where a step begins."""
    rng = np.random.default_rng(3)
    layer = np.float32(0.25)
    front = rng.uniform(-2, 9, COUNT).astype(np.float32)
    z = front + (layer * rng.uniform(1, 60, COUNT)).astype(np.float32)
    main = "in float z; in float nearest; out float weight; void main() { weight = depth_weight(z, nearest, 0.25); }"
    (weight,) = evaluate(renderer, glsl("outside_look.glsl", main=main), {"z": z, "nearest": front}, {"weight": 1})
    steps = np.minimum(z // layer - front // layer, constants.FADE_LAYERS)
    assert 0 < (steps == constants.FADE_LAYERS).sum() < COUNT
    assert np.array_equal(weight[:, 0], (0.25**steps).astype(np.float32))
    assert np.array_equal([depth_weight(a, b, layer) for a, b in zip(z, front, strict=True)], 0.25**steps)


@pytest.mark.parametrize("camera", cameras(), ids=["pinhole", "orthographic"])
def test_ray_entry_and_light(renderer: Renderer, camera: Camera) -> None:
    """The point where a pixel's ray meets a plane, and the brightness that a lamp at the eye gives it."""
    eye = replace(camera, viewmat=np.eye(4))
    plane = np.array([0.3, -0.2, -0.9])
    plane = np.append(plane / np.linalg.norm(plane), 1.9)
    cam = camera_record(eye)
    hits = enter(cam, plane[None])
    assert len(hits.pixels) > 2000
    pixels = np.stack([hits.pixels % 64, hits.pixels // 64], 1) + 0.5
    main = """in vec2 pixel; out vec3 point; out float brightness;
    void main() {
        point = hit(pixel);
        brightness = face_light(cut_in_camera.xyz, -normalize(ray_of(pixel)));
    }"""
    shader = glsl("camera.glsl", "cut.glsl", "face_look.glsl", main=main, **defines(camera))
    uniforms = {**View(eye, np.zeros(3), 4.0).uniforms, "cut_in_camera": plane}
    point, brightness = evaluate(renderer, shader, {"pixel": pixels}, {"point": 3, "brightness": 1}, **uniforms)
    assert np.allclose(point, hits.points, rtol=CLOSE, atol=1e-4)
    assert np.allclose(point[:, 2], hits.depth, rtol=CLOSE)
    across, down = (pixels[:, 0] - cam.cx) / cam.fx, (pixels[:, 1] - cam.cy) / cam.fy
    facing = [facing_of(plane, x, y, camera.orthographic) for x, y in zip(across, down, strict=True)]
    assert np.allclose(hits.facing, facing, rtol=CLOSE)
    expected = 0.85 + 0.15 * np.array(facing)
    for found in (brightness[:, 0], shade(hits), face_light(np.array(facing))):
        assert np.allclose(found, expected, rtol=CLOSE)


@pytest.mark.parametrize("camera", cameras(), ids=["pinhole", "orthographic"])
def test_depth_and_footprint(renderer: Renderer, camera: Camera) -> None:
    """The depth buffer is linear over the object's ball; a pixel's footprint is the geometric mean of its sides."""
    view = View(camera, np.array([0.2, 0.1, -0.1]), 1.5)
    middle = view.matrix[2, 3]
    z = np.linspace(middle - view.radius, middle + view.radius, COUNT)
    main = """in float z; out float stored; out float footprint;
    void main() { stored = linear_depth(z); footprint = footprint_at(z); }"""
    shader = glsl("camera.glsl", main=main, **defines(camera))
    stored, footprint = evaluate(renderer, shader, {"z": z}, {"stored": 1, "footprint": 1}, **view.uniforms)
    assert np.allclose(stored[:, 0], np.linspace(0, 1, COUNT), atol=CLOSE)
    assert np.allclose(footprint[:, 0], view.footprint(z), rtol=CLOSE)
    hits = enter(camera_record(camera), np.array([[0.0, 0.0, -1.0, 2.0]]))
    assert np.allclose(hits.footprint, view.footprint(np.full(len(hits.depth), 2.0)), rtol=CLOSE)


@pytest.mark.parametrize("camera", cameras(), ids=["pinhole", "orthographic"])
def test_ewa_projection(renderer: Renderer, camera: Camera) -> None:
    """Mean, conic, weight, sharpness and depth slope in project.vert.glsl and in the kernels' records."""
    given = splats()
    records, spans = np.zeros((COUNT, RECORD)), np.zeros((COUNT, 6), np.int32)
    project(0, COUNT, camera_record(camera), np.zeros((0, 4)), np.zeros(2, np.int64), given, records, spans)
    visible = (spans[:, 1] > spans[:, 0]) & (spans[:, 3] > spans[:, 2])
    assert visible.sum() > COUNT // 3
    inputs = {"mean": given.means, "scale": given.scales, "quat": given.quats, "sh": np.zeros((COUNT, 4))}
    outputs = {"record_centre": 4, "record_conic": 4, "record_shape": 4, "record_colour": 4}
    shader = source("project.vert.glsl", CONSTANTS | {"SH_VECTORS": 1} | defines(camera))
    uniforms = {**View(camera, np.zeros(3), 4.0).uniforms, "enlarge": 1.0}
    centre, conic, shape, _ = (a[visible] for a in evaluate(renderer, shader, inputs, outputs, **uniforms))
    r = records[visible].T
    assert np.allclose(centre[:, 0], r[record.U] + r[record.U_FRACTION], atol=1e-3)
    assert np.allclose(centre[:, 1], r[record.V] + r[record.V_FRACTION], atol=1e-3)
    assert np.allclose(centre[:, 2], r[record.DEPTH], rtol=CLOSE)
    assert np.allclose(centre[:, 3], r[record.WEIGHT], rtol=1e-3, atol=1e-5)
    # q / 2 = (wx dx)^2 + (wy (dy + s dx))^2, written out.
    wx, wy, shear = r[record.WHITEN_X] ** 2, r[record.WHITEN_Y] ** 2, r[record.SHEAR]
    expected = 2 * np.stack([wx + wy * shear**2, wy * shear, wy], 1)
    assert np.allclose(conic[:, :3], expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max(1, keepdims=True))
    assert np.allclose(conic[:, 3], r[record.SHARPNESS] / r[record.WEIGHT], rtol=1e-3)
    slopes = np.stack([r[record.DEPTH_X], r[record.DEPTH_Y]], 1)
    assert np.allclose(shape[:, :2], slopes, rtol=1e-3, atol=1e-4 * np.abs(slopes).max(1, keepdims=True))


def defines(camera: Camera) -> dict[str, int]:
    """A camera's switches; those that are off are left out."""
    return {"ORTHOGRAPHIC": 1} if camera.orthographic else {}


def test_every_constant_reaches_the_shaders() -> None:
    text = source("screen.vert.glsl", CONSTANTS)
    given = dict(re.findall(r"^#define (\w+) (\S+)$", text, re.MULTILINE))
    for name in constants.__all__:
        assert float(given[name]) == getattr(constants, name), name
    numbers = [sh.C0, sh.C1, *sh.C2, *sh.C3]
    assert {float(value) for name, value in given.items() if name.startswith("SH_C")} == set(numbers)


def test_no_shader_repeats_a_constant() -> None:
    """Every number of the look is in engine/scene/constants.py or engine/scene/sh.py and nowhere else."""
    known = {abs(value): name for name, value in CONSTANTS.items()}
    number = re.compile(r"(?<![\w.])(?:\d+\.\d*|\.\d+|\d+(?=[eE]))(?:[eE][-+]?\d+)?")
    for path in files("shaders").iterdir():
        if path.name.endswith(".glsl"):
            code = re.sub(r"//.*", "", path.read_text(encoding="utf-8"))
            for literal in number.findall(code):
                near = [name for value, name in known.items() if math.isclose(float(literal), value, rel_tol=1e-4)]
                assert not near, f"{path.name}: {literal} is {near[0]}"


@pytest.mark.parametrize("name", [path.name for path in files("shaders").iterdir() if path.name.endswith(".glsl")])
def test_a_shader_compares_only_what_is_defined(name: str) -> None:
    """Some compilers refuse `#if` with an undefined name, which others take for 0."""
    code = source(name, CONSTANTS)
    for compared in re.finditer(r"^#(?:el)?if +(\w+)", code, re.MULTILINE):
        assert f"#define {compared[1]} " in code[: compared.start()], compared[0]
