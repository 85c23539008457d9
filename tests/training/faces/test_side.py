"""The side of a fruit, seen below its cut face by a camera at an angle, is no part of the face."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.photographs.changed import as_half
from benchmarks.photographs.faces import mask_iou
from tests.helpers.exemplar_faces import disc
from tests.training.faces.test_faces import photographed
from training.faces.carrier import find_seen_face
from training.faces.outline import find_mask
from training.faces.side import find_half, without_side

SIZE, RADIUS = 320, 130

FRUITS: dict[str, list[tuple[float, tuple[float, float, float]]]] = {
    "apple": [(0, (0.97, 0.92, 0.78)), (0.98, (0.75, 0.15, 0.18))],
    "melon": [(0, (0.85, 0.2, 0.22)), (0.86, (0.93, 0.95, 0.8)), (0.97, (0.2, 0.45, 0.15))],
    "kiwi": [(0, (0.9, 0.93, 0.7)), (0.25, (0.45, 0.65, 0.15)), (0.98, (0.45, 0.33, 0.2))],
}
"""Colours from the middle outwards, each from a fraction of the radius on; the last is the skin's."""

ALL = FRUITS | {"orange": [(0, (0.98, 0.6, 0.1)), (0.86, (0.97, 0.95, 0.85)), (0.96, (0.95, 0.5, 0.05))]}
"""With one whose skin has the colour of its flesh."""


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
    rgb[whole] = (np.array(ALL[fruit][-1][1]) * (1 - 2 * np.clip(ball - 0.85, 0, 0.15))[..., None])[whole]
    skin = ALL[fruit][-1][0]
    inner = np.hypot(across, (down - off) / np.cos(np.radians(angle)))
    layer = np.where(far < skin, np.minimum(inner, skin - 1e-6), far)
    for start, colour in ALL[fruit]:
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


@pytest.mark.parametrize("fruit", ["apple", "melon", "orange"])
@pytest.mark.parametrize(("angle", "towards"), [(45, 90), (50, 215), (60, 300)])
def test_the_face_of_a_half_is_found_beside_much_of_its_side(fruit: str, angle: float, towards: float) -> None:
    rgb, face, whole = half_ball(fruit, angle, towards)
    seen = find_seen_face(rgb, fruit)
    assert mask_iou(whole, face) < 0.85 and "side of the object" in seen.note
    assert mask_iou(seen.mask, face) > 0.94  # a peel in the colour of the side is lost on the near half


def test_a_face_that_cannot_be_traced_stays_the_oval(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("training.faces.carrier.trace", lambda _, guess: np.zeros_like(guess))
    rgb, face, _ = half_ball("apple", 50)
    assert mask_iou(find_seen_face(rgb, "apple").mask, face) > 0.94


@pytest.mark.parametrize("angle", [50, 65])
def test_the_user_is_told_of_a_side_that_is_not_told_from_the_face(angle: float) -> None:
    """A kiwi's skin is nearly as dark as its flesh, so that the edge between them is weak."""
    rgb, face, _ = half_ball("kiwi", angle)
    seen = find_seen_face(rgb, "kiwi")
    assert mask_iou(seen.mask, face) > 0.94 or "skin or rind" in seen.note


@pytest.mark.parametrize("name", ["apple_h1", "apple_v2", "orange_v3", "watermelon_h8"])
def test_a_photographed_face_is_found_on_half_a_ball(name: str) -> None:
    rgb, truth = as_half(55)(*photographed(name)[:2])
    seen = find_seen_face(np.ascontiguousarray(rgb), name)
    assert mask_iou(seen.mask, truth) > 0.99 and seen.note


@pytest.mark.parametrize("fruit", ALL)
@pytest.mark.parametrize("off", [0, -0.09])
def test_a_face_seen_from_above_is_no_half(fruit: str, off: float) -> None:
    rgb, face, _ = half_ball(fruit, 0, off=off)
    assert find_half(rgb, face) is None
    assert find_half(np.repeat(rgb, 2, axis=0), np.repeat(face, 2, axis=0)) is None


def test_icing_on_a_cake_is_no_side() -> None:
    """The icing lies on top of the face, as the side of a half would, but ends straight."""
    rgb = np.ones((SIZE, SIZE, 3), np.float32)
    rgb[90:240, 50:270] = (0.9, 0.75, 0.5)
    rgb[90:130, 50:270] = (0.6, 0.1, 0.15)
    cake = np.zeros((SIZE, SIZE), bool)
    cake[90:240, 50:270] = True
    assert find_half(ndimage.gaussian_filter(rgb, (1, 1, 0)), cake) is None


def test_what_is_too_small_is_no_half() -> None:
    rgb = np.random.default_rng(0).random((48, 48, 3), np.float32)
    for size in (0, 1, 5, 12):
        face = np.hypot(*(np.mgrid[:48, :48] - 23.5)) < size / 2
        assert find_half(rgb, face) is None


def test_what_is_flat_or_has_no_edge_is_no_half() -> None:
    line = np.zeros((64, 200), bool)
    line[30:31, 10:190] = True
    block = np.zeros_like(line)
    block[8:-8, 8:-8] = True
    for face in (line, block):
        assert find_half(np.full((64, 200, 3), 0.5, np.float32), face) is None


def test_a_face_that_the_border_cuts_off_is_no_half() -> None:
    """The border takes its rind on one side; on the other it is as a side would be."""
    face, mask = disc(200, seeds=6, radius=0.7)
    picture = np.where(mask[..., None], face, 1).astype(np.float32)[:, 37:]
    found = find_mask(picture, "cut off")
    assert found[:, 0].any() and find_half(picture, found) is None
