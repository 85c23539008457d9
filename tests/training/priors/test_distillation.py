"""The loss, score distillation and smoothing against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import ndimage

from engine.scene.image import psnr
from training.families import Family
from training.optimise.losses import reconstruction, ssim
from training.optimise.smoothing import smooth
from training.priors.prior import Condition
from training.priors.sds import distill


def reference_loss(x, y, alpha):
    """The definition of the loss, written plainly in float64 torch."""
    offsets = torch.arange(11, dtype=torch.float64) - 5
    taps = torch.exp(-(offsets**2) / (2 * 1.5**2))
    window = torch.outer(taps, taps) / taps.sum() ** 2

    def mean(p):
        return torch.nn.functional.conv2d(p.permute(2, 0, 1)[:, None], window[None, None])

    mx, my = mean(x), mean(y)
    vx, vy, cov = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    likeness = (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    return alpha * ((x - y) ** 2).mean() + (1 - alpha) * (1 - likeness.mean())


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.0])
def test_the_loss_and_its_gradient_meet_float64(alpha):
    rng = np.random.default_rng(0)
    a = ndimage.gaussian_filter(rng.random((40, 52, 3)), (2, 2, 0))
    b = np.clip(a + 0.1 * rng.standard_normal(a.shape), 0, 1)
    x = torch.tensor(a, requires_grad=True)
    expected = reference_loss(x, torch.tensor(b), alpha)
    expected.backward()
    render = torch.tensor(a, dtype=torch.float32, requires_grad=True)
    loss = reconstruction(render, torch.tensor(b, dtype=torch.float32), alpha)
    loss.backward()
    assert loss.item() == pytest.approx(expected.item(), abs=1e-6)
    assert render.grad is not None and x.grad is not None
    assert np.allclose(render.grad.numpy(), x.grad.numpy(), atol=1e-4 * np.abs(x.grad.numpy()).max())


def test_a_picture_meets_itself():
    picture = np.random.default_rng(0).random((20, 30, 3))
    assert ssim(picture, picture) == pytest.approx(1, abs=1e-5)
    assert psnr(picture, picture) == np.inf
    assert psnr(np.zeros(4), np.full(4, 0.1)) == pytest.approx(20.0)


class GaussianPrior:
    """Every pixel is N(mean, spread^2), so the best noise prediction has a closed form."""

    def __init__(self, mean, spread):
        self.mean, self.spread = mean, spread

    def denoise(self, noisy, sigma, condition, rng):
        return (sigma * (noisy - self.mean) / (sigma**2 + self.spread**2)).astype(np.float32)


def condition(shape):
    flat = np.zeros(shape, np.float32)
    inside = np.zeros(shape, bool)
    inside[4:-4, 4:-4] = True
    grey = np.full((*shape, 3), 0.5, np.float32)
    return Condition(Family("horizontal", 1), "", inside, flat, flat, flat, flat, flat, grey)


@pytest.mark.parametrize(("step", "error"), [(1.0, 0.03), (0.5, 0.06)])
def test_distillation_finds_the_mode(step, error):
    asked = condition((24, 24))
    mean = np.random.default_rng(1).uniform(0.2, 0.8, (24, 24, 3)).astype(np.float32)
    start = np.full_like(mean, 0.5)
    label = distill(start, GaussianPrior(mean, 0.02), asked, np.random.default_rng(0), step=step)
    assert np.sqrt(np.mean((label - mean)[asked.inside] ** 2)) < error
    assert (label[~asked.inside] == 0.5).all()
    again = distill(start, GaussianPrior(mean, 0.02), asked, np.random.default_rng(0), step=step)
    assert (again == label).all()


class GaussianCodes:
    """Codes are the pictures minus grey; each number is N(mean, spread^2)."""

    def __init__(self, mean, spread):
        self.mean, self.spread = np.float32(mean), spread

    def encode(self, label):
        return label - np.float32(0.5)

    def decode(self, code, shape):
        return code + np.float32(0.5)

    def denoise(self, noisy, sigma, condition, rng):
        self.seen = noisy, sigma
        return (sigma * (noisy - self.mean) / (sigma**2 + self.spread**2)).astype(np.float32)


@pytest.mark.parametrize(("step", "error"), [(1.0, 0.02), (0.5, 0.1)])
def test_distillation_of_codes_finds_the_mode(step, error):
    asked = condition((48, 48))
    mean = np.random.default_rng(1).uniform(-0.3, 0.3, (48, 48, 3)).astype(np.float32)
    start = np.full_like(mean, 0.9)
    label = distill(start, GaussianCodes(mean, 0.05), asked, np.random.default_rng(0), step=step)
    assert np.sqrt(np.mean((label - 0.5 - mean)[asked.inside] ** 2)) < error


def test_a_first_label_forgets_the_grey_it_started_from():
    """Two starts end apart by their difference times the product of spread^2 / (spread^2 + sigma^2)."""
    asked = condition((48, 48))
    ends = [
        distill(np.full((48, 48, 3), start, np.float32), GaussianCodes(0.0, 8.0), asked, np.random.default_rng(0))
        for start in (0.4, 0.6)
    ]
    apart = (ends[1] - ends[0])[asked.inside]
    assert np.abs(apart).max() < 0.05 * 0.2


def test_a_prior_of_codes_sees_the_surroundings_as_they_are():
    asked = condition((48, 48))
    start = np.where(asked.inside[..., None], asked.render, np.float32(1))
    codes = GaussianCodes(-0.3, 0.05)
    distill(start, codes, asked, np.random.default_rng(0))
    noisy, sigma = codes.seen
    outside = ((noisy - 0.5) / sigma)[~asked.inside]
    assert abs(outside.mean()) < 0.1 and abs(outside.std() - 1) < 0.1


def test_smoothing_is_the_papers_weighted_mean():
    means = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0]], np.float32)
    initial = np.full((3, 3), 0.5, np.float32)
    current = np.array([[1, 0, 0], [0.5, 0.5, 0.5], [0, 1, 0]], np.float32)
    trained = np.array([True, False, True])
    result = smooth(means, initial, current, trained)
    assert (result[trained] == current[trained]).all()
    # distances 1 and 2, so weights 2/3 and 1/3
    assert np.allclose(result[1], [2 / 3, 1 / 3, 0], atol=1e-6)


def test_smoothing_keeps_detail_and_survives_coincidence():
    means = np.zeros((5, 3), np.float32)
    initial = np.random.default_rng(0).random((5, 3)).astype(np.float32)
    trained = np.array([True, True, False, False, True])
    result = smooth(means, initial, initial, trained)
    assert np.allclose(result, initial, atol=1e-6)
    assert (smooth(means, initial, initial, np.zeros(5, bool)) == initial).all()
