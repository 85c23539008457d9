"""Frozen geometry: W times colours is the full renderer's picture, and the products are each other's transpose."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from engine.fit.view_weights import ViewWeights
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.opaque import render
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, orbit, section
from engine.scene.plane import Plane
from tests.helpers.solids import ball, scatter, with_leaf

UP = (0.0, 0.0, 1.0)
CUTS = [Plane.of((0, 0, 1), -0.1), Plane.of((1, 0.2, 0), -0.2)]
CAMERA = orbit((0, 0, 0), UP, 30, 35, 2.0, 61, 45)
STRAIGHT = replace(CAMERA, orthographic=True, fx=35.0, fy=40.0)


@pytest.mark.parametrize("planes", [[], CUTS])
@pytest.mark.parametrize("camera", [CAMERA, STRAIGHT])
@pytest.mark.parametrize(
    "atoms",
    [ball(0.1), with_leaf(ball(0.1), spacing=1.1), scatter(25, 30)],
    ids=["ball", "leaf", "scatter"],
)
def test_w_times_colours_is_the_render(atoms: Atoms, camera: Camera, planes: list[Plane]) -> None:
    view = ViewWeights.surface(atoms, camera, planes)
    truth = render(atoms, camera, planes, (0.2, 0.5, 0.9))
    shown = view.apply(view.colours(atoms)) + (1 - view.alpha.reshape(camera.height, camera.width, 1)) * np.array(
        [0.2, 0.5, 0.9], np.float32
    )
    assert np.abs(shown - truth.rgb).max() < 2e-6
    assert np.abs(view.alpha - truth.alpha.ravel()).max() < 1e-6
    picture = view.picture(
        torch.from_numpy(atoms.surface.sh), torch.from_numpy(atoms.interior.rgb), background=(0.2, 0.5, 0.9)
    )
    assert np.abs(picture.numpy() - truth.rgb).max() < 2e-6
    sums = view.apply(np.ones((view.columns, 3), np.float32))[..., 0].ravel()
    assert np.abs(sums - view.alpha).max() < 2e-6


def test_a_section_is_the_face_from_either_side() -> None:
    atoms = ball(0.1)
    field = KernelField(atoms)
    camera = section(CUTS[0], UP, atoms.bounds, 40)
    view = ViewWeights.section(atoms, CUTS[0], camera, field)
    truth = render(atoms, camera, CUTS[:1], (0, 0, 0), field=field)
    whole = (view.alpha == 1).reshape(40, 40)
    assert whole.sum() > 200
    assert np.abs(view.apply(view.colours(atoms)) - truth.rgb)[whole].max() < 1e-6
    assert not view.pixels.all()
    empty = np.diff(view.offsets) == 0
    np.testing.assert_array_equal(empty, ~view.pixels)
    back = ViewWeights.section(atoms, CUTS[0].flipped(), camera, field)
    np.testing.assert_array_equal(back.alpha, view.alpha)
    np.testing.assert_allclose(back.weights, view.weights, atol=1e-6)


@pytest.mark.parametrize("keep", [0, 6])
def test_the_products_are_transposed(keep: int) -> None:
    atoms = ball(0.1)
    view = ViewWeights.surface(atoms, CAMERA, CUTS)
    view = view.truncated(keep) if keep else view
    rng = np.random.default_rng(7)
    c = rng.normal(size=(view.columns, 3)).astype(np.float32)
    y = rng.normal(size=(CAMERA.height, CAMERA.width, 3)).astype(np.float32)
    left = float((view.apply(c).astype(np.float64) * y).sum())
    right = float((view.apply_transposed(y).astype(np.float64) * c).sum())
    assert abs(left - right) < 1e-5 * np.sqrt((y**2).sum())
    np.testing.assert_array_equal(view.apply_transposed(y), view.apply_transposed(y))


def test_the_picture_has_gradients_in_harmonics_and_rgb() -> None:
    atoms = ball(0.15)
    view = ViewWeights.surface(atoms, CAMERA, CUTS)
    coefficients = torch.from_numpy(atoms.surface.sh.copy()).requires_grad_()
    rgb = torch.from_numpy(atoms.interior.rgb.copy()).requires_grad_()
    target = torch.rand(CAMERA.height, CAMERA.width, 3, generator=torch.Generator().manual_seed(1))
    loss = ((view.picture(coefficients, rgb) - target) ** 2).sum()
    loss.backward()
    step = 1e-3
    for tensor in (coefficients, rgb):
        assert tensor.grad is not None
        direction = tensor.grad / tensor.grad.norm()
        ends = []
        for sign in (1, -1):
            moved = [t.detach() + sign * step * direction if t is tensor else t.detach() for t in (coefficients, rgb)]
            ends.append(((view.picture(*moved) - target).double() ** 2).sum())
        slope = float((ends[0] - ends[1]) / (2 * step))
        assert abs(slope / float(tensor.grad.norm()) - 1) < 0.01


def test_truncated_keeps_the_largest_and_the_sum() -> None:
    atoms = ball(0.1)
    exact = ViewWeights.surface(atoms, CAMERA, CUTS)
    for keep in (1, 4, 1000):
        short = exact.truncated(keep)
        assert np.diff(short.offsets).max() == min(keep, np.diff(exact.offsets).max())
        sums = short.apply(np.ones((short.columns, 3), np.float32))[..., 0].ravel()
        np.testing.assert_allclose(sums, exact.alpha, atol=2e-6)
        for row in range(0, len(exact.alpha), 97):
            own = slice(exact.offsets[row], exact.offsets[row + 1])
            largest = np.sort(np.argsort(-exact.weights[own], kind="stable")[:keep])
            kept = short.atoms[short.offsets[row] : short.offsets[row + 1]]
            np.testing.assert_array_equal(kept, exact.atoms[own][largest])
    np.testing.assert_array_equal(exact.truncated(1000).weights, exact.weights)


def test_more_entries_come_closer() -> None:
    atoms = ball(0.06)
    exact = ViewWeights.surface(atoms, orbit((0, 0, 0), UP, 30, 35, 2.0, 128, 128), CUTS)
    colours = exact.colours(atoms)
    truth = exact.apply(colours)
    errors = [float(np.square(exact.truncated(keep).apply(colours) - truth).mean()) for keep in (1, 2, 4, 8, 16, 32)]
    assert all(b < a for a, b in pairwise(errors))


def test_no_atoms_no_pixels_no_trouble() -> None:
    for atoms in (scatter(0, 0), scatter(1, 0), scatter(0, 1)):
        for view in (ViewWeights.surface(atoms, CAMERA, CUTS), ViewWeights.section(atoms, CUTS[0], STRAIGHT)):
            picture = view.picture(torch.from_numpy(atoms.surface.sh), torch.from_numpy(atoms.interior.rgb))
            assert torch.isfinite(picture).all()
            assert view.truncated(3).apply_transposed(picture.numpy()).shape == (view.columns, 3)
