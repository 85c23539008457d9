"""The exemplar prior's denoiser against the exact softmax and the exact search."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tests.helpers.exemplar_faces import disc, save
from tests.paths import SAMPLES
from training.evaluate.methods import patch_denoiser
from training.evaluate.methods.patch_denoiser import PatchDenoiser
from training.families import Family
from training.priors.exemplar import read_picture
from training.priors.exemplar.patches import PATCH, posterior
from training.priors.prior import Condition


def test_posterior_is_the_softmax_over_candidates() -> None:
    rng = np.random.default_rng(0)
    features, queries = rng.normal(size=(200, 24)), rng.normal(size=(9, 24))
    colours = rng.random((200, 3))
    members, starts = rng.permutation(200), np.array([0, 80, 200])
    lists = rng.integers(0, 2, 9)
    out = np.empty((9, 3), np.float32)
    single = [a.astype(np.float32) for a in (queries, features, colours)]
    posterior(0, len(out), single[0], lists, starts, members.astype(np.int32), single[1], single[2], 0.7, out)
    for m in range(9):
        own = members[starts[lists[m]] : starts[lists[m] + 1]]
        logs = -((queries[m] - features[own]) ** 2).sum(1) / (2 * 0.7**2)
        weight = np.exp(logs - logs.max())
        np.testing.assert_allclose(out[m], weight @ colours[own] / weight.sum(), atol=1e-5)


def level_cut(family: Family, size: int, mask: NDArray[np.bool_]) -> Condition:
    """A horizontal cut through the middle of a ball that takes 0.8 of the picture."""
    y, x = (np.mgrid[:size, :size] + 0.5) / (size / 2) - 1
    r = (np.hypot(x, y) / 0.8).astype(np.float32)
    return Condition(
        family,
        "",
        mask,
        np.where(mask, 1 - r, 0).astype(np.float32),
        r,
        np.arctan2(-y, x).astype(np.float32),
        np.zeros((size, size), np.float32),
        np.where(mask, 1, np.inf).astype(np.float32),
        np.ones((size, size, 3), np.float32),
    )


def test_denoiser_finds_the_noise(tmp_path: Path) -> None:
    face, mask = disc(96, seeds=8)
    family = Family("horizontal", 40, (save(tmp_path / "face.png", disc(192, seeds=8)[0]),))
    condition = level_cut(family, 96, mask)
    rng = np.random.default_rng(0)
    prior = PatchDenoiser()
    for sigma in (0.15, 0.5):
        noise = rng.normal(size=face.shape).astype(np.float32)
        noisy = face + sigma * noise
        found = prior.denoise(noisy, sigma, condition, rng)
        np.testing.assert_array_equal(found, prior.denoise(noisy, sigma, condition, rng))
        left = np.sqrt(((noisy - sigma * found - face)[mask] ** 2).mean())
        assert left < 0.5 * sigma
        np.testing.assert_allclose(found[~mask], noise[~mask], atol=1e-5)


@pytest.mark.slow
def test_search_is_nearly_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Agrees to 30 dB with a full search through every patch placed like the pixel, by all of the patch's numbers."""
    family = Family("horizontal", 40, (SAMPLES / "orange" / "horizontal_1.png",))
    noise = np.random.default_rng(0).normal(size=(96, 96, 3)).astype(np.float32)
    face, mask = disc(96)
    other = read_picture(SAMPLES / "orange" / "horizontal_2.png", "horizontal")
    rows, columns = np.nonzero(other.mask)
    box = other.rgb[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    r, c = np.nonzero(mask)
    height, width = np.ptp(r) + 1, np.ptp(c) + 1
    scale = height / box.shape[0], width / box.shape[1], 1
    face[r.min() : r.max() + 1, c.min() : c.max() + 1] = ndimage.zoom(box, scale, order=1)
    condition = level_cut(family, 96, mask)
    monkeypatch.setattr(patch_denoiser, "read_picture", cache(read_picture))  # two seconds each time
    for sigma in (0.15, 0.5):
        noisy = face + sigma * noise
        quick = PatchDenoiser().denoise(noisy, sigma, condition, np.random.default_rng(0))
        with monkeypatch.context() as exact:
            exact.setattr(patch_denoiser, "MAX_CANDIDATES", 10**9)
            exact.setattr(patch_denoiser, "COEFFICIENTS", PATCH)
            true = PatchDenoiser().denoise(noisy, sigma, condition, np.random.default_rng(0))
        error = sigma * (quick - true)[mask]
        assert (error**2).mean() < 1e-3
