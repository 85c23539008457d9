"""A cut face that lies on a plate or a board, or that a finger touches: the face alone, or a line that says so."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
import skimage.data
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from benchmarks.photographs.drawn import whole_fruit
from benchmarks.photographs.faces import mask_iou
from engine.errors import InputError
from tests.paths import SHARED
from training.faces.bulges import find_front
from training.faces.carrier import find_seen_face
from training.faces.edges import skin_share
from training.faces.outline import find_central

SIZE = 192
FOLDER = SHARED / "photos/fruit"

Y, X = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2 - 1
RGB = NDArray[np.float32]
Mask = NDArray[np.bool_]


def over(under: NDArray, what: Mask, colour: NDArray | list[float]) -> NDArray:
    """A shape painted over a picture, its edge blurred as by a lens."""
    share = ndimage.gaussian_filter(what.astype(float), 0.7)[..., None]
    return under * (1 - share) + np.array(colour) * share


def lay(under: NDArray, what: Mask, colour: NDArray | list[float]) -> NDArray:
    """The same with the shadow that it casts."""
    shade = ndimage.shift(ndimage.gaussian_filter(what.astype(float), 4), (5, 4), order=1)
    return over(under * (1 - 0.5 * shade[..., None]), what, colour)


def photographed(picture: NDArray) -> RGB:
    """The picture with a camera's noise."""
    return np.clip(picture + np.random.default_rng(0).normal(0, 0.01, picture.shape), 0, 1).astype(np.float32)


def table() -> NDArray:
    """Dark wood."""
    grain = ndimage.gaussian_filter(np.random.default_rng(1).normal(size=(SIZE, SIZE)), (1, 20))
    return np.array([0.42, 0.28, 0.17]) * (1 + 0.1 * grain / grain.std())[..., None]


def fruit(under: NDArray) -> tuple[NDArray, Mask]:
    """A face with a rind and a core, off-centre."""
    r = np.hypot(X - 0.08, (Y + 0.05) * 1.05)
    picture = lay(under, r < 0.5, [0.3, 0.45, 0.12])
    picture = over(picture, r < 0.46, [0.95, 0.93, 0.75])
    return over(picture, r < 0.12, [0.45, 0.3, 0.2]), r < 0.5


CARRIERS = {
    "plate": (np.hypot(X, Y) < 0.9, [0.93, 0.93, 0.92]),
    "blue plate": (np.hypot(X, Y) < 0.9, [0.25, 0.4, 0.6]),
    "board": ((np.abs(X) < 0.85) & (np.abs(Y) < 0.8), [0.78, 0.62, 0.42]),
    "plate that the border cuts off": (np.hypot(X, Y) < 1.25, [0.93, 0.93, 0.92]),
}


@pytest.mark.parametrize("name", CARRIERS)
def test_the_face_and_not_what_it_lies_on(name: str) -> None:
    picture, truth = fruit(lay(table(), *CARRIERS[name]))
    found = find_seen_face(photographed(picture), name)
    assert mask_iou(found.mask, truth) > 0.95  # a pixel too much all around gives 0.96
    assert "plate or board, which is left out" in found.note


def test_a_face_is_not_taken_for_a_plate_with_its_stone_on_it() -> None:
    r = np.hypot(X, Y)
    for skin in (0.02, 0.04):
        picture = over(lay(table(), r < 0.75, [0.7, 0.15, 0.1]), r < 0.75 - skin, [0.96, 0.8, 0.4])
        found = find_seen_face(photographed(over(picture, np.hypot(X, Y - 0.1) < 0.3, [0.45, 0.2, 0.12])), "peach")
        assert mask_iou(found.mask, r < 0.75) > 0.95  # of a two-pixel skin, one pixel is mixed
        assert found.note == ""


def test_half_an_egg_is_kept_and_the_user_told_that_it_may_be_a_plate() -> None:
    egg = np.hypot(X / (1 - 0.15 * Y), Y / 1.2) < 0.65
    picture = over(lay(table(), egg, [0.96, 0.95, 0.92]), np.hypot(X, Y - 0.1) < 0.3, [0.95, 0.7, 0.2])
    found = find_seen_face(photographed(picture), "egg")
    assert mask_iou(found.mask, egg) > 0.97
    assert "hardly a skin or rind" in found.note


def test_a_finger_from_the_border_is_left_out() -> None:
    picture, truth = fruit(np.full((SIZE, SIZE, 3), 0.9))
    finger = (np.abs(X) < 0.12) & (Y > 0.35)
    found = find_seen_face(photographed(over(picture, finger, [0.8, 0.58, 0.48])), "held")
    assert mask_iou(found.mask, truth) > 0.93  # the finger hides part of the face
    assert "reaches from the border" in found.note


@pytest.mark.parametrize("level", [0.0, 0.03])
def test_a_skin_is_a_third_colour_and_a_mixture_is_none(level: float) -> None:
    thing = np.hypot(X, Y) < 0.7
    shadow = np.clip(1.2 + X[..., None], 0.3, 1)  # light and shadow on the table are mixtures, too
    picture = over(np.array([0.4, 0.5, 0.7]) * shadow, thing, [0.9, 0.85, 0.8])
    assert skin_share(photographed(picture), thing) == 0
    if level:
        rim = thing & (np.hypot(X, Y) > 0.7 - level)
        assert skin_share(photographed(over(picture, rim, [0.7, 0.2, 0.1])), thing) == 1


@cache
def real(name: str) -> tuple[RGB, Mask]:
    if not FOLDER.exists():
        pytest.skip("the photographs are not beside the repository")
    with Image.open(FOLDER / f"{name}.png") as picture, Image.open(FOLDER / f"masks/{name}.png") as mask:
        rgb = np.asarray(picture.convert("RGB"), np.float32) / np.float32(255)
        return rgb, np.asarray(mask.convert("L")) > 127


@pytest.mark.parametrize("name", ["apple_h1", "orange_v3", "pomegranate_h3", "watermelon_v1"])
def test_photographs_of_faces_have_a_skin(name: str) -> None:
    assert skin_share(*real(name)) > 0.9


@pytest.mark.parametrize("name", ["orange_h1"])
def test_photographed_faces_on_a_plate(name: str) -> None:
    rgb, mask = (cv2.resize(a.astype(np.float32), (SIZE, SIZE), interpolation=cv2.INTER_AREA) for a in real(name))
    smaller = np.array([[0.6, 0, SIZE / 5], [0, 0.6, SIZE / 5]])
    rgb, small = (cv2.warpAffine(a, smaller, (SIZE, SIZE)) for a in (rgb, mask))
    picture = lay(lay(table(), *CARRIERS["plate"]), small > 0.5, rgb)
    found = find_seen_face(photographed(picture), name)
    assert mask_iou(found.mask, small > 0.5) > 0.95
    assert found.note


def cheese() -> tuple[Mask, NDArray]:
    """A face without a skin: its mask, a block, and its colour."""
    return (np.abs(X) < 0.45) & (np.abs(Y - 0.1 * X) < 0.35), np.array([0.95, 0.8, 0.42])


@pytest.mark.parametrize("name", ["plate", "board"])
def test_a_face_without_a_skin_is_known_by_its_shadow(name: str) -> None:
    block, colour = cheese()
    found = find_seen_face(photographed(lay(lay(table(), *CARRIERS[name]), block, colour)), name)
    assert mask_iou(found.mask, block) > 0.95
    assert "plate or board, which is left out" in found.note


def test_dark_surroundings_of_a_core_are_no_shadow() -> None:
    r = np.hypot(X, Y)
    ring = np.clip((r - 0.35) / 0.12, 0, 1)[..., None]  # like seeds around the core
    flesh = np.array([0.45, 0.65, 0.15]) * (0.5 + 0.5 * ring)
    picture = over(over(lay(table(), r < 0.75, [0.1, 0.1, 0.1]), r < 0.75, flesh), r < 0.35, [0.92, 0.93, 0.75])
    assert mask_iou(find_seen_face(photographed(picture), "kiwi").mask, r < 0.75) > 0.95


def granite() -> NDArray:
    """Grey speckles from bright to dark."""
    grain = ndimage.gaussian_filter(np.random.default_rng(2).normal(size=(SIZE, SIZE, 3)), (0.8, 0.8, 0))
    return np.clip(0.5 + 0.16 * grain / grain.std(), 0, 1)


def test_specks_of_the_table_in_the_colours_of_the_face_are_none_of_it() -> None:
    bread = (np.abs(X) / 0.6) ** 6 + (np.abs(Y) / 0.5) ** 6 < 1
    found = find_seen_face(photographed(lay(granite(), bread, [0.9, 0.82, 0.7])), "granite")
    assert mask_iou(found.mask, bread) > 0.95
    assert "has several colours" in found.note


def cloth() -> NDArray:
    """Chequered, red and white."""
    checks = ((np.arange(SIZE) // 14 % 2)[:, None] + (np.arange(SIZE) // 14 % 2))[..., None] / 2
    return np.array([0.95, 0.93, 0.9]) * (1 - checks) + np.array([0.75, 0.12, 0.12]) * checks


def test_a_face_on_a_chequered_cloth_is_found_and_the_user_told_to_look() -> None:
    picture, truth = fruit(cloth())
    found = find_seen_face(photographed(picture), "cloth")
    assert mask_iou(found.mask, truth) > 0.85  # squares in the shadow may pass for the face
    assert "has several colours" in found.note


def test_nothing_is_found_on_a_cloth_alone_or_where_the_border_cuts_the_face() -> None:
    r = np.hypot(X - 0.9, Y)
    for picture in (cloth(), over(lay(cloth(), r < 0.8, [0.3, 0.45, 0.12]), r < 0.74, [0.5, 0.7, 0.2])):
        with pytest.raises(InputError):
            find_seen_face(photographed(picture), "cloth")


def small_fruit(under: NDArray, x: float, is_cut: bool = True) -> tuple[NDArray, Mask]:
    """A fruit of half the width at a place across the picture, as its face or whole."""
    r = np.hypot(X - x, Y)
    picture = lay(under, r < 0.4, [0.75, 0.45, 0.1])
    return (over(picture, r < 0.36, [0.95, 0.75, 0.3]) if is_cut else picture), r < 0.4


@pytest.mark.parametrize("behind", [True, False], ids=["half", "whole"])
@pytest.mark.parametrize("apart", [0.55, 0.65, 0.79])
def test_of_two_that_touch_or_overlap_the_face_in_front_is_found(apart: float, behind: bool) -> None:
    picture, _ = small_fruit(table(), apart / 2, behind)
    picture, truth = small_fruit(picture, -apart / 2)
    found = find_seen_face(photographed(picture), "two")
    assert mask_iou(found.mask, truth) > 0.93  # a pixel around a disc 77 wide is a twentieth of it
    assert "something else seems to touch" in found.note


def round_thing(under: NDArray, place: tuple[float, float], size: float) -> tuple[NDArray, Mask]:
    r = np.hypot(X - place[0], Y - place[1])
    return lay(under, r < size, [0.3, 0.42, 0.15]), r < size


def test_the_face_of_three_that_touch_is_found() -> None:
    """It is in front of a whole one, and another barely touches that: with this gone, there is another neck."""
    picture, _ = round_thing(table(), (0.6, -0.35), 0.3)
    picture, _ = round_thing(picture, (0.0, -0.35), 0.32)
    r = np.hypot(X + 0.1, Y - 0.22)
    picture = over(lay(picture, r < 0.42, [0.75, 0.45, 0.1]), r < 0.39, [0.95, 0.75, 0.3])
    found = find_seen_face(photographed(picture), "three")
    assert mask_iou(found.mask, r < 0.42) > 0.9
    assert "something else seems to touch" in found.note


def test_the_cut_one_of_two_that_touch_is_told_by_its_inside_where_no_skin_is_seen() -> None:
    """Its rind has one colour, that of the whole one, which is larger, in front of it and shaded."""
    picture, truth = round_thing(table(), (-0.42, 0), 0.4)
    picture = over(picture, np.hypot(X + 0.42, Y) < 0.3, [0.93, 0.9, 0.75])
    ball, there = whole_fruit((X - 0.36) / 0.46, Y / 0.46, [0.3, 0.42, 0.15])
    found = find_front(photographed(lay(picture, there, ball)), truth | there)
    assert found is not None and mask_iou(found, truth & ~there) > 0.9


@pytest.mark.parametrize("name", ["apple_h3", "orange_h1", "orange_v3", "watermelon_v11"])
def test_a_photographed_face_in_front_of_another(name: str) -> None:
    large = [cv2.resize(a.astype(np.float32), (SIZE, SIZE), interpolation=cv2.INTER_AREA) for a in real(name)]
    picture = table()
    for across in (0.4, 0.02):
        smaller = np.array([[0.55, 0, SIZE * across], [0, 0.55, SIZE / 5]])
        rgb, shown = (cv2.warpAffine(a, smaller, (SIZE, SIZE)) for a in large)
        truth = shown > 0.5
        picture = lay(picture, truth, rgb)
    assert mask_iou(find_seen_face(photographed(picture), name).mask, truth) > 0.9


@pytest.mark.parametrize(
    ("place", "told"),
    [((-0.1, -0.3), "seems to touch"), ((-0.3, -0.35), "seems to touch"), ((0.5, 0.05), "lies beside")],
    ids=["half hidden", "mostly hidden", "beside"],
)
@pytest.mark.parametrize("name", ["drawn", "apple_h7", "orange_h1", "watermelon_h8"])
def test_a_whole_fruit_is_no_part_of_a_face(name: str, place: tuple[float, float], told: str) -> None:
    """Half hidden, it has no neck to the face; beside it, it is the larger of two things."""
    whole, there = whole_fruit((X - place[0]) / 0.45, (Y - place[1]) / 0.45, [0.75, 0.45, 0.1])
    picture = lay(table(), there, whole)
    if name == "drawn":
        picture, truth = small_fruit(picture, -0.45)
    else:
        large = (cv2.resize(a.astype(np.float32), (SIZE, SIZE), interpolation=cv2.INTER_AREA) for a in real(name))
        smaller = np.array([[0.42, 0, 0.065 * SIZE], [0, 0.42, 0.29 * SIZE]])
        rgb, shown = (cv2.warpAffine(a, smaller, (SIZE, SIZE)) for a in large)
        truth = shown > 0.5
        picture = lay(picture, truth, rgb)
    found = find_seen_face(photographed(picture), name)
    assert mask_iou(found.mask, truth) > 0.9
    assert told in found.note


def bricks() -> NDArray:
    """A photograph of a wall, as scikit-image brings it along."""
    wall = cv2.resize(skimage.data.brick(), (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    return np.repeat(wall[..., None] / 255, 3, -1)


def test_a_face_before_bricks_is_found_and_the_user_told_to_look() -> None:
    picture, truth = fruit(bricks())
    found = find_seen_face(photographed(picture), "bricks")
    assert mask_iou(found.mask, truth) > 0.9  # the thin rind is nearly as dark as the wall
    assert "has several colours" in found.note


@pytest.mark.parametrize("name", ["apple_h3", "orange_v6", "pomegranate_h1", "watermelon_h11"])
def test_photographed_faces_before_bricks(name: str) -> None:
    large = [cv2.resize(a.astype(np.float32), (SIZE, SIZE), interpolation=cv2.INTER_AREA) for a in real(name)]
    smaller = np.array([[0.7, 0, SIZE / 5], [0, 0.7, SIZE / 8]])
    rgb, small = (cv2.warpAffine(a, smaller, (SIZE, SIZE)) for a in large)
    found = find_seen_face(photographed(lay(bricks(), small > 0.5, rgb)), name)
    assert mask_iou(found.mask, small > 0.5) > 0.95


def test_nothing_is_found_before_bricks_alone_or_where_the_border_cuts_the_face() -> None:
    r = np.hypot(X - 0.9, Y)
    for picture in (bricks(), over(lay(bricks(), r < 0.8, [0.3, 0.45, 0.12]), r < 0.74, [0.5, 0.7, 0.2])):
        with pytest.raises(InputError):
            find_seen_face(photographed(picture), "bricks")


@pytest.mark.parametrize("top", [-0.4, -0.1])
def test_a_strip_of_sea_between_sky_and_sand_is_no_part_of_the_face(top: float) -> None:
    """Sky and sand are plain and have two corners each; the sea has none, and was two wings of the face."""
    row = Y[..., None]
    sky, sea, sand = [0.62, 0.75, 0.9], [0.2, 0.42, 0.62], [0.72, 0.58, 0.35]
    picture, truth = fruit(np.where(row < top, sky, np.where(row < top + 0.3, sea, sand)))
    found = find_seen_face(photographed(picture), "sea")
    assert mask_iou(found.mask, truth) > 0.8  # the thin rind is as dark as the sea
    assert found.note


def slices_around(places: list[float]) -> NDArray:
    """Slices that touch one in the middle, in these directions, on white."""
    rng, picture = np.random.default_rng(3), np.full((SIZE, SIZE, 3), 0.97)
    for turn in places:
        flesh = np.array([0.95, rng.uniform(0.3, 0.8), 0.15])
        r = np.hypot(X - 1.6 * np.cos(turn), Y - 1.6 * np.sin(turn))
        picture = over(lay(picture, r < 0.76, 0.6 * flesh), r < 0.66, flesh)
    return picture


@pytest.mark.parametrize("others", [5, 6, 7])
def test_a_slice_among_others_is_found_whole(others: int) -> None:
    """The colours of its flesh go on beside it, so that they pass for a pattern; its rind is seen all around."""
    picture, r = slices_around([n / others * 2 * np.pi for n in range(others)]), np.hypot(X, Y)
    picture = over(lay(picture, r < 0.84, [0.35, 0.4, 0.12]), r < 0.76, [0.8, 0.82, 0.4])
    sectors = np.abs(np.sin(5 * np.arctan2(Y, X))) < 0.1
    found = find_seen_face(photographed(over(picture, sectors & (r < 0.76), [0.9, 0.9, 0.6])), "slices")
    assert mask_iou(found.mask, r < 0.84) > 0.95
    assert "has several colours" in found.note


@pytest.mark.parametrize("shape", [(8, 300), (12, 12), (300, 20)])
def test_a_strip_of_a_few_pixels_is_refused_in_a_line(shape: tuple[int, int]) -> None:
    picture = np.random.default_rng(0).uniform(size=(*shape, 3)).astype(np.float32)
    assert find_central(picture) is None
    with pytest.raises(InputError):
        find_seen_face(picture, "strip")


@pytest.mark.parametrize("shade", [0.62, 0.4])
def test_a_crust_in_the_colour_of_the_table_is_no_shadow(shade: float) -> None:
    table, r = np.array([0.8, 0.75, 0.66]), np.hypot(X, Y)
    picture = over(lay(np.ones((SIZE, SIZE, 3)) * table, r < 0.6, table * shade), r < 0.5, [0.55, 0.35, 0.65])
    assert (
        mask_iou(find_seen_face(photographed(picture), "geode").mask, r < 0.6) > 0.9
    )  # some of the shadow is included
