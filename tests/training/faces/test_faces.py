"""The cut face in a photograph: outline, axis, kind of cut, and a mask supplied with it."""

from __future__ import annotations

import csv
import io
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from benchmarks.photographs.faces import axis_error, mask_iou
from engine.errors import InputError
from sample_scenes.exemplars import SUPERSAMPLE, crop, planes
from sample_scenes.solids import SOLIDS
from tests.helpers.exemplar_faces import disc, save
from tests.paths import SAMPLES, SHARED
from training.faces.axis import guess_cut
from training.faces.bulges import without_bulges
from training.faces.core_line import find_core_line
from training.faces.outline import find_mask
from training.priors.exemplar.pictures import find_face, read_picture

FOLDER = SHARED / "photos/fruit"

HARD = {
    "apple_h2": "a red reflection that reaches the border",
    "apple_h4": "wood",
    "orange_h4": "three pixels from the border",
    "orange_v4": "light that shines through",
    "watermelon_h11": "a hard shadow",
}


@cache
def photographed(name: str) -> tuple[NDArray[np.float32], NDArray[np.bool_], dict[str, str]]:
    """A photograph, its hand-marked mask, and its row in the list."""
    if not FOLDER.exists():
        pytest.skip("the photographs are not beside the repository")
    with Image.open(FOLDER / f"{name}.png") as picture, Image.open(FOLDER / f"masks/{name}.png") as mask:
        rgb, truth = (
            np.asarray(picture.convert("RGB"), np.float32) / np.float32(255),
            np.asarray(mask.convert("L")) > 127,
        )
    rows = {row["path"]: row for row in csv.DictReader(io.StringIO((FOLDER / "list.csv").read_text()))}
    return rgb, truth, rows[f"{name}.png"]


@pytest.mark.parametrize("name", HARD)
def test_photographs(name: str) -> None:
    rgb, truth, row = photographed(name)
    mask = find_mask(rgb, name)
    assert mask_iou(mask, truth) > 0.97
    assert axis_error(rgb, mask, row) < 0.03


@pytest.mark.parametrize("change", ["dark", "warm", "noise", "wood", "small"])
def test_another_light_or_table_changes_little(change: str) -> None:
    rgb, truth, _ = photographed("watermelon_h8")
    rng = np.random.default_rng(0)
    if change == "dark":
        rgb = (rgb / 2).astype(np.float32)
    elif change == "warm":
        rgb = (rgb * [1, 0.85, 0.65]).astype(np.float32)
    elif change == "noise":
        rgb = np.clip(rgb + rng.normal(0, 0.04, rgb.shape), 0, 1).astype(np.float32)
    elif change == "wood":
        grain = ndimage.gaussian_filter(rng.normal(size=truth.shape), (1, 25))
        shade = 1 - 0.5 * ndimage.gaussian_filter(np.roll(truth, (16, 12), (0, 1)).astype(float), 8)
        wood = np.array([0.55, 0.4, 0.28]) * ((1 + 0.12 * grain / grain.std()) * shade)[..., None]
        rgb = np.where(truth[..., None], rgb, np.clip(wood, 0, 1)).astype(np.float32)
    else:
        rgb, truth = rgb[::4, ::4], truth[::4, ::4]
    assert mask_iou(find_mask(rgb, change), truth) > 0.97


@pytest.mark.parametrize(("name", "light"), [("apple_h7", (1, 1, 1)), ("apple_h1", (0.9, 0.98, 1.07))])
def test_a_shadow_of_another_colour_is_no_rind(name: str, light: tuple[float, ...]) -> None:
    """The first has a brown shadow; in the second's light a camera clips the white table but not the shadow on it."""
    rgb, truth, _ = photographed(name)
    assert mask_iou(find_mask(np.clip(rgb * np.array(light, np.float32), 0, 1), name), truth) > 0.98


def test_of_what_hangs_on_a_face_only_what_fades_is_cut_off() -> None:
    face, mask = disc(300, radius=0.6)
    y, x = (np.mgrid[:300, :300] + 0.5) / 150 - 1
    beneath = np.clip((0.8 - np.hypot(x, y)) / 0.2 * (1.6 * y > np.abs(x)), 0, 1) * (y > 0) * ~mask
    shadow = (face * (1 - beneath[..., None] * [0.4, 0.6, 0.7])).astype(np.float32)
    assert (beneath > 0.5).sum() > 0.03 * mask.sum()
    assert mask_iou(without_bulges(shadow, mask | (beneath > 0.5)), mask) > 0.99
    stalk = (np.abs(x) < 0.04) & (y < 0) & (y > -0.75) & ~mask
    whole = mask | stalk
    face[stalk] = [0.3, 0.2, 0.1]
    np.testing.assert_array_equal(without_bulges(face, whole), whole)
    rind = np.where(
        mask[..., None], np.where(np.hypot(x, y)[..., None] < 0.54, [0.9, 0.85, 0.7], [0.1, 0.12, 0.1]), 0.05
    )
    np.testing.assert_array_equal(without_bulges(rind.astype(np.float32), mask), mask)
    square = np.maximum(np.abs(x), np.abs(y)) < 0.6
    slice_ = np.where(square[..., None], [0.8, 0.7, 0.5], 1.0).astype(np.float32)
    np.testing.assert_array_equal(without_bulges(slice_, square), square)


def test_a_grey_face_is_no_shadow() -> None:
    face, mask = disc(200, seeds=6, radius=0.7)
    grey = np.repeat(face.mean(-1, keepdims=True), 3, axis=-1).astype(np.float32)
    assert mask_iou(find_mask(grey, "grey"), mask) > 0.97


def test_equal_pictures_have_equal_masks() -> None:
    face, _ = disc(160, seeds=5)
    np.testing.assert_array_equal(find_mask(face, "a"), find_mask(face.copy(), "b"))


@pytest.mark.parametrize("name", ["orange/horizontal_1", "orange/radial_1", "watermelon/radial_1", "bread/parallel_1"])
def test_solids_of_our_own_are_found_to_the_pixel(name: str) -> None:
    rgb, face = find_face(SAMPLES / f"{name}.png")
    mask = face.mask
    assert mask_iou(mask, ndimage.binary_fill_holes((rgb < 0.99).any(-1))) > 0.985
    if "radial" in name:
        (x0, y0), (x1, y1) = find_core_line(rgb, mask).ends
        assert abs(np.degrees(np.arctan2(x0 - x1, y1 - y0))) < 5
        assert (x0 + x1) / 2 == pytest.approx(rgb.shape[1] / 2, abs=0.02 * rgb.shape[1])


def test_a_leaning_core_line_is_found_and_the_picture_turned(tmp_path: Path) -> None:
    y, x = (np.mgrid[:200, :200] + 0.5) / 100 - 1
    turn = np.radians(12)
    across, along = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    mask = np.hypot(across / 0.6, along / 0.75) < 1
    face = np.where(mask[..., None], [0.9, 0.6, 0.1], 1.0).astype(np.float32)
    face[mask & (np.abs(across) < 0.05)] = [0.95, 0.9, 0.8]
    for side in (-1, 1):
        seed = np.hypot((across - side * 0.2) / 0.05, (along - 0.2) / 0.15) < 1
        face[seed] = [0.2, 0.1, 0.05]
    (x0, y0), (x1, y1) = find_core_line(face, mask).ends
    assert np.degrees(np.arctan2(x0 - x1, y1 - y0)) == pytest.approx(12, abs=2)
    upright = read_picture(save(tmp_path / "leaning.png", face), "radial")
    assert mask_iou(upright.mask, upright.mask[:, ::-1]) > 0.95
    assert guess_cut(upright.rgb, upright.mask).kind == "radial"
    assert guess_cut(*disc(200, seeds=5)).kind == "horizontal"


@pytest.mark.parametrize("name", ["apple_v1", "orange_v3", "watermelon_v10", "bread_1", "orange_h6"])
def test_a_picture_held_askew_is_of_the_same_kind(name: str) -> None:
    rgb, truth, row = photographed(name)
    turned = ndimage.rotate(rgb, 20, order=1, mode="nearest"), ndimage.rotate(truth * 1.0, 20, order=1) > 0.5
    assert guess_cut(*turned).kind == row["family"]


@pytest.mark.parametrize("name", ["orange_v2", "apple_h1", "apple_h2", "watermelon_v1", "pomegranate_v5", "bread_1"])
def test_light_from_one_side_changes_no_kind(name: str) -> None:
    rgb, truth, row = photographed(name)
    light = np.linspace(0.6, 1.1, rgb.shape[1])[:, None]
    lit = np.clip(rgb * light, 0, 1).astype(np.float32)
    assert guess_cut(rgb, truth).kind == guess_cut(lit, truth).kind == row["family"]


def test_a_lopsided_face_has_its_core_line_where_the_rim_says() -> None:
    y, x = (np.mgrid[:200, :200] + 0.5) / 100 - 1
    mask = np.hypot(np.where(x > 0, x / 0.8, x / 0.6), y / 0.75) < 1
    face = np.where(mask[..., None], [0.9, 0.6, 0.1], 1.0).astype(np.float32)
    plain = find_core_line(face, mask)
    for end in (-0.7, 0.7):
        face[mask & (np.hypot(x / 0.06, (y - end) / 0.1) < 1)] = [0.3, 0.2, 0.05]
    marked = find_core_line(face, mask)
    np.testing.assert_allclose(marked.ends[:, 0], 100, atol=4)
    assert marked.spread < 4 < plain.spread  # pixels, of 140
    assert marked.evidence > 2 * plain.evidence + 2


@pytest.mark.parametrize("lean", [0, 20])
def test_a_core_line_begins_where_the_crown_grows_though_the_crown_and_the_body_are_lopsided(lean: float) -> None:
    y, x = (np.mgrid[:240, :240] + 0.5) / 120 - 1
    turn = np.radians(lean)
    across, along = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    body = np.hypot(np.where(across > 0, across / 0.6, across / 0.5), along / 0.55) < 1
    crown = (np.abs(across) < 0.12) & (along < 0) & (along > -0.7 - across)
    mask = body | crown | ((np.abs(across) < 0.03) & (along > 0) & (along < 0.62))
    face = np.where(mask[..., None], [0.8, 0.3, 0.3], 1.0).astype(np.float32)
    (x0, y0), (x1, y1) = find_core_line(face, mask).ends
    assert np.degrees(np.arctan2(x0 - x1, y1 - y0)) == pytest.approx(lean, abs=2.5)
    for end in ((x0, y0), (x1, y1)):
        u, v = np.array(end) / 120 - 1
        assert abs(u * np.cos(turn) + v * np.sin(turn)) < 0.03 * 1.1
    assert guess_cut(face, mask).kind == "radial"


def test_a_mask_beside_the_photograph_wins(tmp_path: Path) -> None:
    face, mask = disc(120)
    path = save(tmp_path / "melon.png", face)
    half = mask & (np.arange(120) < 60)[:, None]
    Image.fromarray(half).save(tmp_path / "melon.mask.png")
    np.testing.assert_array_equal(find_face(path)[1].mask, half)
    Image.fromarray(half[:50]).save(tmp_path / "melon.mask.png")
    with pytest.raises(InputError, match=r"melon\.mask\.png: 120x50 pixels, but melon\.png has 120x120"):
        find_face(path)


@pytest.mark.parametrize(("size", "least"), [(128, 0.96), (240, 0.99), (512, 0.99)])
def test_a_coat_nearly_as_white_as_the_table_is_the_face(size: int, least: float) -> None:
    """Cream is nearer in colour to the table than to the cake, which has the stronger edge; in small pictures it is as
    thin as what a lens mixes."""
    cake = SOLIDS["cake"](0)
    for plane in planes(cake, "radial"):
        rgb, inside = cake.slice(plane, crop(cake, plane, size), supersample=SUPERSAMPLE)
        assert mask_iou(find_mask(rgb.astype(np.float32), "cake"), np.asarray(inside) > 0.5) > least
