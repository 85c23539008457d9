"""The differentiable opaque image: the same picture, and its gradients against finite differences in float64."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from engine.fit.differentiable import AtomTensors, opaque_image
from engine.fit.harmonics import harmonic_colours
from engine.render.cpu.opaque import render
from engine.render.cpu.outside import draw, splats_of, view_colours
from engine.render.cpu.weights import BEHIND
from engine.scene import sh
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, orbit, section
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from tests.helpers.solids import ball, scatter
from tests.reference.opaque import coverage

UP = (0.0, 0.0, 1.0)
CUT = Plane.of((0, 0, 1), -0.1)
PARAMETERS = ("means", "scales", "quats", "sh", "interior_means", "sigmas", "rgb")
FAR = orbit((0, 0, 0), UP, 30, 35, 2.0, 11, 9)
NEAR = orbit((0, 0, 0), UP, 30, 50, 0.9, 11, 9)
STRAIGHT = section(CUT, UP, np.array([[-0.4] * 3, [0.4] * 3]), 9)


def test_it_is_the_same_picture() -> None:
    atoms = ball(0.1)
    camera = orbit((0, 0, 0), UP, 30, 35, 2.0, 61, 45)
    for planes in ([], [CUT, Plane.of((1, 0.2, 0), -0.2)]):
        rgb, alpha = opaque_image(AtomTensors.of(atoms), camera, planes, (0.2, 0.5, 0.9))
        truth = render(atoms, camera, planes, (0.2, 0.5, 0.9))
        np.testing.assert_allclose(rgb.numpy(), truth.rgb, atol=1e-5)
        np.testing.assert_allclose(alpha.numpy(), truth.alpha, atol=1e-5)


def things_behind_things(seed: int) -> Atoms:
    """Small soft ellipsoids before larger ones, all at a slant, and a few interior atoms: edges inside silhouettes."""
    atoms = scatter(24, 6, seed=seed, degree=3)
    skin, towards = atoms.surface, -FAR.forward.astype(np.float32)
    near, size = np.repeat([0.35, -0.3], 12)[:, None], np.repeat([0.05, 0.2], 12)[:, None]
    means = 0.5 * (skin.means - skin.means @ towards[:, None] * towards) + near * towards
    scales = skin.scales / skin.scales.max(1, keepdims=True) ** 0.5 * size
    moved = replace(skin, means=means.astype(np.float32), scales=scales.astype(np.float32))
    return replace(atoms, surface=moved)


@pytest.mark.parametrize("planes", [[], [CUT]], ids=["whole", "cut"])
@pytest.mark.parametrize("camera", [FAR, NEAR, STRAIGHT], ids=["far", "near", "straight"])
@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("made", ["scattered", "behind", "far behind"])
def test_gradients_meet_finite_differences(made: str, camera: Camera, planes: list[Plane], seed: int) -> None:
    scene = scatter(5, 6, seed=seed, degree=3) if made == "scattered" else things_behind_things(seed)
    if made == "far behind":  # by forty layers: depth weights at their smallest
        scene = replace(scene, pitch=0.01)
    atoms = AtomTensors.of(scene, torch.float64)
    parameters = [getattr(atoms, name).requires_grad_() for name in PARAMETERS]
    rng = torch.Generator().manual_seed(seed)
    of_rgb = torch.rand(camera.height, camera.width, 3, generator=rng, dtype=torch.float64)
    of_alpha = torch.rand(camera.height, camera.width, generator=rng, dtype=torch.float64)

    def loss(values: list[torch.Tensor]) -> torch.Tensor:
        changed: dict[str, Any] = dict(zip(PARAMETERS, values, strict=True))
        moved = replace(atoms, **changed)
        rgb, alpha = opaque_image(moved, camera, planes, (0.2, 0.5, 0.9))
        return (rgb * of_rgb).sum() + (alpha * of_alpha).sum()

    gradients = torch.autograd.grad(loss(parameters), parameters, allow_unused=True)
    step = 1e-6
    wrong, entries = 0, 0
    for k, gradient in enumerate(gradients):
        given = torch.zeros_like(parameters[k]) if gradient is None else gradient
        assert torch.isfinite(given).all()
        picks = torch.randperm(given.numel(), generator=rng)[:18]
        for at in picks.tolist():
            ends = []
            for sign in (1, -1):
                values = [p.detach().clone() for p in parameters]
                values[k].view(-1)[at] += sign * step
                ends.append(loss(values))
            slope = float(ends[0] - ends[1]) / (2 * step)
            wrong += abs(slope - float(given.reshape(-1)[at])) > 1e-5 * (1 + abs(slope))
            entries += 1
    # A step may cross a jump (a fragment enters, a front changes), where there is no slope.
    assert wrong <= 0.03 * entries


def test_gradients_reach_what_lies_behind() -> None:
    """Where both the layer and what lies behind it cover a pixel in part, but not where the layer covers it fully."""
    scene = things_behind_things(4)
    camera = orbit((0, 0, 0), UP, 30, 35, 2.0, 44, 36)
    sums = draw(splats_of(scene), [view_colours(scene, camera)], camera, [Piece(())], scene.pitch).sums
    layer = coverage(sums[..., 0], sums[..., 1])
    behind = coverage(sums[..., BEHIND], sums[..., BEHIND + 1])
    open_twice = (layer > 0) & (layer < 1) & (behind > 0) & (behind < 1)
    assert open_twice.sum() > 8
    for pixels in (open_twice, layer == 1):
        atoms = AtomTensors.of(scene)
        scales = atoms.scales.requires_grad_()
        opaque_image(atoms, camera)[1][torch.from_numpy(pixels)].sum().backward()
        assert scales.grad is not None
        assert bool(scales.grad[12:].any()) == (pixels is open_twice)


@pytest.mark.parametrize("camera", [FAR, STRAIGHT])
def test_harmonic_colours_meet_the_harmonics_and_their_derivative(camera: Camera) -> None:
    rng = np.random.default_rng(8)
    for degree in range(4):
        means, coefficients = rng.normal(size=(30, 3)), rng.normal(size=(30, (degree + 1) ** 2, 3))
        way = means - camera.position if not camera.orthographic else np.tile(camera.forward, (30, 1))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        inputs = torch.from_numpy(means).requires_grad_(), torch.from_numpy(coefficients).requires_grad_()
        found = harmonic_colours(*inputs, camera)
        np.testing.assert_allclose(found.detach().numpy(), sh.colours(coefficients, way), atol=1e-13)
        assert (found == 0).any()
        assert torch.autograd.gradcheck(lambda m, c: harmonic_colours(m, c, camera), inputs)


def test_what_nobody_sees_has_no_gradient_and_what_is_odd_stays_finite() -> None:
    atoms = scatter(12, 8)
    atoms.surface.scales[:4] = np.array([[0, 0, 0], [1e-30, 1, 1], [1e6, 1, 1], [1e-9, 1e-9, 10]])
    atoms.surface.quats[2] = 0
    atoms.surface.means[5] = FAR.position
    atoms.surface.means[6] = FAR.position - FAR.forward
    atoms.surface.means[7] = atoms.surface.means[8]
    for planes in ([], [CUT]):
        tensors = AtomTensors.of(atoms)
        for name in PARAMETERS:
            getattr(tensors, name).requires_grad_()
        rgb, alpha = opaque_image(tensors, FAR, planes)
        (rgb.square().sum() + alpha.sum()).backward()
        for name in PARAMETERS:
            gradient = getattr(tensors, name).grad
            if planes or name not in ("interior_means", "sigmas", "rgb"):
                assert torch.isfinite(gradient).all(), name
            else:  # the inside is on cut faces only
                assert gradient is None
        assert tensors.means.grad is not None
        assert tensors.means.grad[6].abs().sum() == 0 or planes


def test_the_same_gradient_again() -> None:
    atoms = ball(0.1)
    camera = orbit((0, 0, 0), UP, 30, 35, 2.0, 61, 45)
    runs = []
    for _ in range(2):
        tensors = AtomTensors.of(atoms)
        for name in PARAMETERS:
            getattr(tensors, name).requires_grad_()
        opaque_image(tensors, camera, [CUT])[0].square().sum().backward()
        runs.append([getattr(tensors, name).grad.numpy() for name in PARAMETERS])
    for first, second in zip(*runs, strict=True):
        np.testing.assert_array_equal(first, second)
