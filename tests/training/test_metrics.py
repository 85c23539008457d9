"""The metrics against cases whose value is known."""

from __future__ import annotations

import numpy as np
import pytest

from training.evaluate.metrics import face_psnr, face_ssim, patch_distance, sharpness


@pytest.fixture
def face():
    rng = np.random.default_rng(0)
    inside = np.zeros((48, 48), bool)
    inside[6:-6, 6:-6] = True
    return rng.random((48, 48, 3)).astype(np.float32), inside


def test_a_face_meets_itself(face):
    picture, inside = face
    assert face_psnr(picture, picture, inside) == np.inf
    assert face_ssim(picture, picture, inside) == pytest.approx(1)
    assert patch_distance(picture, inside, picture, inside) == 0


def test_psnr_counts_the_face_only(face):
    picture, inside = face
    other = np.where(inside[..., None], picture + np.float32(0.1), np.float32(0))
    assert face_psnr(other, picture, inside) == pytest.approx(20, abs=1e-3)


def test_patch_distance_of_a_shift(face):
    picture, inside = face
    # A constant added to all 147 numbers moves a projection by s * sum(direction); E[sum^2] = 1 for unit directions.
    shifted = picture + np.float32(0.2)
    assert patch_distance(shifted, inside, picture, inside) == pytest.approx(100 * 0.2**2, rel=0.25)
    # The distance ignores position: the same texture elsewhere is the same texture.
    assert patch_distance(picture[::-1], inside, picture, inside) < 0.05 * 100 * 0.2**2


def test_sharpness_of_a_grating():
    x = np.arange(64)
    wave = np.broadcast_to(np.sin(0.5 * x)[None, :, None], (64, 64, 3)).astype(np.float32)
    inside = np.ones((64, 64), bool)
    # The discrete Laplacian of sin(w x) is (2 cos w - 2) sin(w x).
    assert sharpness(wave, inside) == pytest.approx((2 - 2 * np.cos(0.5)) / np.sqrt(2), rel=0.03)
    assert sharpness(np.full_like(wave, 0.3), inside) == 0
