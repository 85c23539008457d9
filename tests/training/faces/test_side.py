"""The side of a fruit, seen below its cut face by a camera at an angle, is no part of the face."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.photographs.faces import mask_iou
from tests.training.faces.test_faces import photographed
from training.faces.outline import find_mask
from training.faces.side import without_side

SIZE, RADIUS = 320, 130

FRUITS: dict[str, list[tuple[float, tuple[float, float, float]]]] = {
    "apple": [(0, (0.97, 0.92, 0.78)), (0.98, (0.75, 0.15, 0.18))],
    "melon": [(0, (0.85, 0.2, 0.22)), (0.86, (0.93, 0.95, 0.8)), (0.97, (0.2, 0.45, 0.15))],
    "kiwi": [(0, (0.9, 0.93, 0.7)), (0.25, (0.45, 0.65, 0.15)), (0.98, (0.45, 0.33, 0.2))],
}
"""Colours from the middle outwards, each from a fraction of the radius on; the last is the skin's."""


def half_ball(
    fruit: str, angle: float, towards: float = 90, off: float = 0
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]]:
    """(H, W, 3), (H, W), (H, W). Half a ball with the flesh `off` its middle, in radii, on a white table with a shadow,
    seen at an angle in degrees from above, with its side in the direction `towards`; its face, and face and side."""
    y, x = (np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2) / RADIUS
    turn = np.radians(towards)
    down, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    far = np.hypot(across, down / np.cos(np.radians(angle)))
    face, ball = far < 1, np.hypot(x, y)
    whole = face | ((ball < 1) & (down > 0))
    shadow = ndimage.gaussian_filter(np.roll(whole, (6, 4), (0, 1)).astype(float), 12)
    rgb = np.ones((SIZE, SIZE, 3)) - 0.3 * shadow[..., None]
    rgb[whole] = (np.array(FRUITS[fruit][-1][1]) * (1 - 2 * np.clip(ball - 0.85, 0, 0.15))[..., None])[whole]
    skin = FRUITS[fruit][-1][0]
    inner = np.hypot(across, (down - off) / np.cos(np.radians(angle)))
    layer = np.where(far < skin, np.minimum(inner, skin - 1e-6), far)
    for start, colour in FRUITS[fruit]:
        rgb[face & (layer >= start)] = colour
    rng = np.random.default_rng(0)
    rgb += 0.1 * ndimage.gaussian_filter(rng.standard_normal(whole.shape), 1.5)[..., None] * face[..., None]
    rgb = ndimage.gaussian_filter(rgb, (1, 1, 0)) + 0.01 * rng.standard_normal(rgb.shape)
    return np.clip(rgb, 0, 1).astype(np.float32), face, whole


@pytest.mark.parametrize("fruit", FRUITS)
@pytest.mark.parametrize(("angle", "towards"), [(20, 90), (25, 60), (35, 215)])
def test_the_side_is_cut_off_at_any_angle(fruit: str, angle: float, towards: float) -> None:
    rgb, face, whole = half_ball(fruit, angle, towards)
    assert mask_iou(whole, face) < 0.975
    assert mask_iou(without_side(rgb, whole), face) > 0.982


def test_a_face_is_found_without_its_side() -> None:
    rgb, face, _ = half_ball("apple", 25)
    assert mask_iou(find_mask(rgb, "apple"), face) > 0.98


def test_the_side_in_a_photograph() -> None:
    rgb, truth, _ = photographed("apple_h3")
    assert mask_iou(find_mask(rgb, "apple_h3"), truth) > 0.99


@pytest.mark.parametrize("fruit", FRUITS)
def test_a_face_without_a_side_keeps_its_skin(fruit: str) -> None:
    rgb, face, _ = half_ball(fruit, 0)
    lit = rgb * np.linspace(0.7, 1, SIZE, dtype=np.float32)[:, None, None]
    for seen in (rgb, lit):
        assert np.array_equal(without_side(seen, face), face)


def test_a_rind_may_be_thicker_on_one_side() -> None:
    rgb, face, _ = half_ball("melon", 0, off=-0.08)
    assert np.array_equal(without_side(rgb, face), face)


def test_a_tint_that_fades_away_is_no_side() -> None:
    rgb, face, _ = half_ball("melon", 0)
    y = (np.arange(SIZE) - (SIZE - 1) / 2) / RADIUS
    blue = np.clip((y - 0.6) / 0.4, 0, 1)[:, None, None] * np.array([-0.3, -0.1, 0.3])
    tinted = np.clip(rgb + blue * face[..., None], 0, 1).astype(np.float32)
    assert np.array_equal(without_side(tinted, face), face)


def test_a_wedge_keeps_its_rind() -> None:
    rgb, face, _ = half_ball("melon", 0)
    half = face & (np.arange(SIZE)[:, None] > SIZE / 2)
    wedge = np.where(half[..., None], rgb, 1).astype(np.float32)
    assert np.array_equal(without_side(wedge, half), half)


@pytest.mark.parametrize("diameter", [1, 10.5, 15, 19, 21, 23, 27])
def test_a_face_too_small_to_tell_is_kept(diameter: float) -> None:
    face = np.hypot(*(np.mgrid[:48, :48] - 23.5)) < diameter / 2
    rgb = np.random.default_rng(0).random((48, 48, 3), np.float32)
    assert np.array_equal(without_side(rgb, face), face)
