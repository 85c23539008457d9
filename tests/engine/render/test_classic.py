"""The classic renderer against the plain formula, its own derivatives, foreign pictures and invariants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from torch import Tensor

import engine.render.classic.rasterizer as classic
from engine.render.classic.depth_order import depth_order
from engine.render.classic.differentiable import rasterize
from engine.render.classic.rasterizer import render
from engine.render.classic.records import Scene
from engine.render.classic.splats import project
from engine.render.projection import camera_record
from engine.scene.camera import Camera, look_at, orbit
from engine.scene.gaussians import Gaussians
from engine.threads import cores, use_cores
from tests.helpers.gl_scenes import brush_case
from tests.helpers.solids import round_gaussians
from tests.paths import SHARED
from tests.reference.classic import picture

REFERENCE = SHARED / "reference"
BACKGROUND = (0.2, 0.5, 0.9)
NAMES = ("means", "scales", "quats", "opacities", "colours")

PINHOLE = Camera(look_at([0.3, -0.4, -4], [0, 0, 0], [0, -1, 0]), 20, 21, 11, 9.5, 23, 19)
FLAT = Camera(look_at([0.3, -0.4, -4], [0, 0, 0], [0, -1, 0]), 6, 7, 11, 9.5, 23, 19, orthographic=True)
CAMERAS = pytest.mark.parametrize("camera", [PINHOLE, FLAT], ids=["pinhole", "orthographic"])


def scene(n: int, bands: int, seed: int, kind: torch.dtype = torch.float64) -> list[Tensor]:
    """Overlapping Gaussians of all shapes about the origin, of `bands` SH coefficients, or RGB for 0."""
    rng = np.random.default_rng(seed)
    arrays = [
        rng.normal(0, 0.7, (n, 3)),
        rng.uniform(0.1, 0.5, (n, 3)),
        rng.normal(size=(n, 4)),
        rng.uniform(0.2, 0.95, n),
        rng.normal(0, 0.4, (n, bands, 3)) if bands else rng.uniform(0, 1, (n, 3)),
    ]
    return [torch.tensor(array, dtype=kind) for array in arrays]


def rasterized(
    parameters: Sequence[Tensor], camera: Camera, background: Sequence[float] = (0.0, 0.0, 0.0)
) -> tuple[Tensor, Tensor, Tensor]:
    """Calls `rasterize` with means, scales, quats, opacities and colours given as one list."""
    means, scales, quats, opacities, colours = parameters
    return rasterize(means, scales, quats, opacities, colours, camera, background)


def gradients(render_with, parameters: list[Tensor], camera: Camera) -> tuple[list[Tensor], list[Tensor]]:
    """The outputs, and the gradients of their sum under fixed random weights."""
    leaves = [parameter.detach().clone().requires_grad_() for parameter in parameters]
    outputs = render_with(*leaves, camera, BACKGROUND)
    generator = torch.Generator().manual_seed(5)
    weights = [torch.randn(out.shape, generator=generator, dtype=torch.float64) for out in outputs]
    torch.autograd.backward(outputs, [weight.to(outputs[0].dtype) for weight in weights])
    return [out.detach() for out in outputs], [leaf.grad if leaf.grad is not None else leaf * 0 for leaf in leaves]


@CAMERAS
@pytest.mark.parametrize("bands", [0, 1, 4, 9, 16])
def test_float64_kernels_are_the_formula(camera: Camera, bands: int) -> None:
    parameters = scene(30, bands, seed=bands)
    ours, our_gradients = gradients(rasterize, parameters, camera)
    true, true_gradients = gradients(picture, parameters, camera)
    for a, b in zip(ours, true, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-12, atol=1e-12)
    for name, a, b in zip(NAMES, our_gradients, true_gradients, strict=True):
        torch.testing.assert_close(
            a, b, rtol=1e-8, atol=1e-9 * float(b.abs().max()), msg=partial("{}: {}".format, name)
        )


@CAMERAS
def test_float32_keeps_to_float64(camera: Camera) -> None:
    parameters = scene(30, 16, seed=3)
    ours, our_gradients = gradients(rasterize, [parameter.float() for parameter in parameters], camera)
    true, true_gradients = gradients(picture, [parameter.float().double() for parameter in parameters], camera)
    for a, b in zip(ours, true, strict=True):
        assert (a - b).abs().max() < 2e-6 * b.abs().max()
    for name, a, b in zip(NAMES, our_gradients, true_gradients, strict=True):
        assert (a - b).abs().max() < 1e-5 * b.abs().max(), name


@CAMERAS
@pytest.mark.parametrize("bands", [0, 16])
def test_gradcheck(camera: Camera, bands: int) -> None:
    parameters = [parameter.requires_grad_() for parameter in scene(5, bands, seed=1)]
    assert torch.autograd.gradcheck(lambda *p: rasterized(p, camera, BACKGROUND), parameters, nondet_tol=0.0)


@pytest.mark.parametrize("side", [-1, 1])
def test_gradcheck_on_both_sides_of_every_edge(side: int) -> None:
    """A pixel at alpha 1/255 and one at 0.99, a finished pixel, a colour at 0, a slope at the limit of the Jacobian."""
    nudge = side * 1e-4
    camera = Camera(np.eye(4), 20, 20, 8, 8, 16, 16)
    reach = math.sqrt(2 * math.log(255 * 0.8) * (0.3 + (20 * 0.3 / 5) ** 2))  # the distance at which alpha is 1/255
    faint = [(reach + nudge + 4.5 - 8) * 5 / 20, (4.5 - 8) * 5 / 20, 5.0]
    centre = [0.5 * 6 / 20, 0.5 * 6 / 20, 6.0]  # projects onto the centre of pixel (8, 8)
    behind = [0.5 * 7 / 20, 0.5 * 7 / 20, 7.0]
    limit = (8 + 0.3 * 8) / 20
    outside = [(limit + nudge) * 8, 0.3, 8.0]
    parameters = [
        torch.tensor([faint, centre, behind, outside], dtype=torch.float64),
        torch.tensor([[0.3] * 3, [0.4] * 3, [0.4] * 3, [1.5, 1.0, 0.7]], dtype=torch.float64),
        torch.tensor([[1.0, 0, 0, 0]] * 3 + [[0.9, 0.1, 0.3, 0.2]], dtype=torch.float64),
        torch.tensor([0.8, 0.99 + nudge, 0.99 + nudge, 0.7], dtype=torch.float64),
        torch.full((4, 1, 3), (nudge - 0.5) / 0.28209479177387814, dtype=torch.float64),
    ]
    parameters[4][:, :, 1] += 1.0
    leaves = [parameter.requires_grad_() for parameter in parameters]
    assert torch.autograd.gradcheck(lambda *p: rasterized(p, camera, BACKGROUND), leaves, eps=1e-7, atol=1e-5)
    ours, our_gradients = gradients(rasterize, parameters, camera)
    true, true_gradients = gradients(picture, parameters, camera)
    for a, b in zip(ours + our_gradients, true + true_gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-8, atol=1e-9)


def test_brush_tiny_case() -> None:
    gaussians, camera, true = brush_case()
    ours = render(gaussians, camera)
    assert np.abs(ours.rgb - true[..., :3]).max() < 1e-5
    assert np.abs(ours.alpha - true[..., 3]).max() < 1e-5


def test_garden_positions_and_depths_against_a_pinhole() -> None:
    path = REFERENCE / "gsplat_test_garden.npz"
    if not path.exists():
        pytest.skip("the reference captures are not here")
    garden = np.load(path, allow_pickle=False)
    means = garden["means3d"]
    width, height = int(garden["width"]), int(garden["height"])
    g = round_gaussians(means, 1e-3, 0.02)
    arrays = (means, g.scales, g.quats, g.opacities, g.sh)
    for view, k in zip(garden["viewmats"].astype(np.float64), garden["Ks"].astype(np.float64), strict=True):
        camera = Camera(view, k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height)
        frame, slices = classic.composite(Scene(*arrays, plain=True), camera)
        starts = [
            (part.first + chunk * part.chunk_size, count)
            for part in slices
            for chunk, count in enumerate(part.record_counts)
        ]
        slots = np.concatenate([np.arange(start, start + count) for start, count in starts])
        records, rows = frame.records[slots, :12].astype(np.float64), frame.owners[slots]
        points = means.astype(np.float64) @ view[:3, :3].T + view[:3, 3]
        true = points[:, :2] / points[:, 2:] * k.diagonal()[:2] + k[:2, 2]
        inside = (points[:, 2] > 0.01) & (true > 0).all(axis=1) & (true < [width, height]).all(axis=1)
        hidden = np.setdiff1d(np.flatnonzero(inside), rows)
        assert len(hidden) == 0  # so faint that none hides another
        assert np.abs(records[:, [0, 2]] + records[:, [1, 3]] - true[rows]).max() < 2e-7
        assert np.abs(records[:, 11] / points[rows, 2] - 1).max() < 1e-7
        assert (np.diff(records[:, 11]) >= 0).all()
        assert len(np.unique(rows)) == len(rows)


@CAMERAS
def test_moving_everything_moves_nothing(camera: Camera) -> None:
    parameters = scene(30, 0, seed=2)
    q = torch.tensor([0.3, -0.5, 0.7, 0.4], dtype=torch.float64)
    q /= q.norm()
    turn = np.eye(4)
    w, x, y, z = q.tolist()
    turn[:3, :3] = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    turn[:3, 3] = 3, -2, 5
    means = parameters[0] @ torch.tensor(turn[:3, :3]).T + torch.tensor(turn[:3, 3])
    a, b = parameters[2][:, :1], parameters[2][:, 1:]
    vector = q[1:].expand_as(b)
    quats = torch.cat([w * a - (b * vector).sum(1, keepdim=True), w * b + a * vector + torch.cross(vector, b, 1)], 1)
    moved = [means, parameters[1], quats, *parameters[3:]]
    there = replace(camera, viewmat=camera.viewmat @ np.linalg.inv(turn))
    for before, after in zip(rasterized(parameters, camera), rasterized(moved, there), strict=True):
        torch.testing.assert_close(after, before, rtol=1e-9, atol=1e-11)


def test_order_of_the_gaussians_is_not_seen() -> None:
    parameters = scene(30, 4, seed=4, kind=torch.float32)
    mixed = torch.randperm(30, generator=torch.Generator().manual_seed(1))
    before, before_gradients = gradients(rasterize, parameters, PINHOLE)
    after, after_gradients = gradients(rasterize, [parameter[mixed] for parameter in parameters], PINHOLE)
    for a, b in zip(before, after, strict=True):
        assert torch.equal(a, b)
    for a, b in zip(before_gradients, after_gradients, strict=True):
        assert torch.equal(a[mixed], b)


@pytest.mark.parametrize("shift", [(3, 0), (0, 5), (6, 7)])
def test_where_the_tiles_lie_is_not_seen(shift: tuple[int, int]) -> None:
    parameters = scene(30, 0, seed=6)
    dx, dy = shift
    # The same rays in a larger picture, padded equally on the far side so that the Jacobian's limits stay symmetric.
    small = replace(FLAT, width=24, height=20)
    large = replace(small, width=24 + dx, height=20 + dy, cx=small.cx + dx, cy=small.cy + dy)
    for a, b in zip(rasterized(parameters, small), rasterized(parameters, large), strict=True):
        torch.testing.assert_close(b[dy:, dx:], a, rtol=1e-12, atol=1e-12)


def ball(n: int) -> list[Tensor]:
    """Opaque Gaussians on and in a unit sphere: whatever lies behind the front is hidden."""
    rng = np.random.default_rng(8)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = np.where(np.arange(n) % 2, 1.0, rng.random(n) ** (1 / 3))
    arrays = (
        direction * radius[:, None],
        rng.uniform(0.01, 0.05, (n, 3)),
        rng.normal(size=(n, 4)),
        rng.uniform(0.9, 1.0, n),
        rng.uniform(0, 1, (n, 3)),
    )
    return [torch.tensor(array, dtype=torch.float32) for array in arrays]


def test_slices_and_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    parameters, camera = ball(20_000), orbit([0, 0, 0], [0, 0, 1], 30, 20, 4, 100, 90)
    monkeypatch.setattr(classic, "LEAST_SLICE", 1000)
    pictures, all_gradients = gradients(rasterize, parameters, camera)
    count = cores()
    for threads in (1, 2, 3):
        use_cores(threads)
        again, again_gradients = gradients(rasterize, parameters, camera)
        for a, b in zip(pictures + all_gradients, again + again_gradients, strict=True):
            assert torch.equal(a, b)
    use_cores(count)
    monkeypatch.setattr(classic, "LEAST_SLICE", 1 << 30)
    whole, whole_gradients = gradients(rasterize, parameters, camera)
    for a, b in zip(pictures, whole, strict=True):
        assert torch.equal(a, b)
    for a, b in zip(all_gradients, whole_gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6 * float(a.abs().max()))


def test_render_is_rasterize() -> None:
    means, scales, quats, opacities, sh = scene(20, 4, seed=9, kind=torch.float32)
    quats = torch.nn.functional.normalize(quats, dim=1)
    ours = render(Gaussians(*(t.numpy() for t in (means, scales, quats, opacities, sh))), PINHOLE, BACKGROUND)
    rgb, alpha, depth = rasterize(means, scales, quats, opacities, sh, PINHOLE, BACKGROUND)
    assert np.array_equal(ours.rgb, rgb.numpy())
    assert np.array_equal(ours.alpha, alpha.numpy())
    seen = ours.alpha > 0
    np.testing.assert_allclose(ours.depth[seen] * ours.alpha[seen], depth.numpy()[seen], rtol=1e-6)
    assert np.isinf(ours.depth[~seen]).all()
    assert (~seen).any()


def test_read_only_arrays_compile_nothing_new() -> None:
    means, scales, quats, opacities, sh = (tensor.numpy() for tensor in scene(20, 4, seed=9, kind=torch.float32))
    rasterized(scene(20, 4, seed=9, kind=torch.float32), PINHOLE)
    known = len(project.signatures)
    for array in (means, scales, quats, opacities, sh):
        array.flags.writeable = False
    render(Gaussians(means, scales, quats, opacities, sh), PINHOLE)
    assert len(project.signatures) == known


def degenerate(name: str, n: int = 3) -> list[Tensor]:
    parameters = scene(n, 16, seed=7, kind=torch.float32)
    means, scales, quats, _, _ = parameters
    if name == "behind the camera":
        means[0] = torch.tensor([0.0, 0.0, -9.0])
    elif name == "at the eye":
        means[0] = torch.tensor(PINHOLE.position)
    elif name == "on the near plane":
        means[0] = torch.tensor(PINHOLE.position + PINHOLE.near * PINHOLE.forward)
    elif name == "a hair beyond the near plane":
        means[0] = torch.tensor(PINHOLE.position + 1.0001 * PINHOLE.near * PINHOLE.forward)
    elif name == "points":
        scales[:] = 0
    elif name == "small beyond measure":
        scales[:] = 1e-38
    elif name == "huge":
        scales[:] = 1e6
    elif name == "huge beyond measure":
        scales[:] = 1e38
    elif name == "needle":
        scales[:] = torch.tensor([1e4, 1e-6, 1e-6])
    elif name == "coincident":
        for parameter in parameters:
            parameter[:] = parameter[0].clone()
    elif name == "coincident and opaque":
        for parameter in parameters:
            parameter[:] = parameter[0].clone()
        parameters[3][:] = 1
    elif name == "quaternions of length zero":
        quats[:] = 0
    elif name == "no opacity":
        parameters[3][:] = 0
    elif name == "not a number":
        means[0] = math.nan
        scales[1] = math.nan
        quats[2] = math.nan
    elif name == "out of sight":
        means[:, 0] += 1e6
    else:
        raise AssertionError(name)
    return parameters


@pytest.mark.parametrize(
    "name",
    [
        "behind the camera",
        "at the eye",
        "on the near plane",
        "a hair beyond the near plane",
        "points",
        "small beyond measure",
        "huge",
        "huge beyond measure",
        "needle",
        "coincident",
        "coincident and opaque",
        "quaternions of length zero",
        "no opacity",
        "not a number",
        "out of sight",
    ],
)
@CAMERAS
def test_degenerate_input_stays_finite(name: str, camera: Camera) -> None:
    outputs, all_gradients = gradients(rasterize, degenerate(name), camera)
    for values in (*outputs, *all_gradients):
        assert torch.isfinite(values).all()
    assert outputs[1].min() >= 0
    assert outputs[1].max() <= 1


def test_one() -> None:
    parameters = scene(1, 1, seed=1)
    outputs, all_gradients = gradients(rasterize, parameters, PINHOLE)
    true, true_gradients = gradients(picture, parameters, PINHOLE)
    for a, b in zip(outputs + all_gradients, true + true_gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-11)


def test_none() -> None:
    (rgb, alpha, depth), empty = gradients(rasterize, scene(0, 1, seed=1), PINHOLE)
    assert torch.equal(rgb, torch.tensor(BACKGROUND, dtype=torch.float64).expand(PINHOLE.height, PINHOLE.width, 3))
    assert not alpha.any()
    assert not depth.any()
    assert [len(gradient) for gradient in empty] == [0] * 5


@CAMERAS
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_depth_order_is_a_stable_sort(camera: Camera, kind: type) -> None:
    rng = np.random.default_rng(0)
    means: np.ndarray = rng.normal(0, 4, (100_000, 3)).astype(kind)
    means[1::2] = means[::2]  # ties
    rotation, shift = camera.viewmat[2, :3], camera.viewmat[2, 3]
    depths = rotation[0] * means[:, 0] + rotation[1] * means[:, 1] + rotation[2] * means[:, 2] + shift
    seen = np.flatnonzero(depths > camera.near) if not camera.orthographic else np.arange(len(means))
    order = depth_order(camera_record(camera), means)
    assert np.array_equal(np.sort(order), seen)
    steps = np.diff(depths[order])
    assert steps.min() > -5e-8  # float32 depths would be wrong by 1e-6
    assert (np.diff(order)[steps == 0] > 0).all()
