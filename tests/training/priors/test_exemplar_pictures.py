"""The exemplar prior: pictures as users supply them."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from engine.errors import InputError
from tests.helpers.exemplar_faces import UP, ball, disc, quiet, save
from tests.paths import SHARED
from training.faces.completion import complete_face
from training.faces.marks import Marks
from training.families import Family, Kind
from training.priors.exemplar import ExemplarPrior, read_picture
from training.priors.exemplar.lighting import colour_gain
from training.priors.exemplar.pictures import MAX_SIDE, read_photograph, resolved_share
from training.priors.exemplar.quilting.disc import Disc


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks, each in its own bounding box."""
    boxes = []
    for mask in (a, b):
        rows, columns = np.nonzero(mask)
        box = mask[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1].astype(np.float32)
        boxes.append(ndimage.zoom(box, (100 / box.shape[0], 100 / box.shape[1]), order=1) > 0.5)
    return float((boxes[0] & boxes[1]).sum() / (boxes[0] | boxes[1]).sum())


@pytest.mark.parametrize("background", ["white", "black", "blue", "table", "uneven", "transparent"])
def test_background_is_found(tmp_path: Path, background: str) -> None:
    face, mask = disc(200, seeds=6, radius=0.6)
    face, mask = np.roll(face, (20, -25), (0, 1)), np.roll(mask, (20, -25), (0, 1))
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:200, :200] / 200
    behind = {
        "white": np.ones((200, 200, 3)),
        "black": np.full((200, 200, 3), 0.03),
        "blue": np.broadcast_to([0.1, 0.2, 0.6], (200, 200, 3)),
        "table": 0.75 + 0.04 * ndimage.gaussian_filter(rng.normal(size=(200, 200, 1)), (2, 8, 0)) * [5, 4, 3],
        "uneven": np.broadcast_to(0.55 + 0.35 * (x + y)[..., None] / 2, (200, 200, 3)),
        "transparent": np.ones((200, 200, 3)),
    }[background]
    picture = np.where(mask[..., None], face, behind)
    if background == "transparent":
        picture = np.concatenate([picture, mask[..., None]], -1)
    found = read_picture(save(tmp_path / "face.png", picture), "horizontal")
    assert overlap(found.mask, mask) > 0.96


def test_uneven_light_is_taken_out(tmp_path: Path) -> None:
    face, mask = disc(160)
    slope = np.linspace(0.8, 1.2, 160)[None, :, None]
    lit = read_picture(save(tmp_path / "lit.png", np.where(mask[..., None], 0.8 * face * slope, 1)), "radial")
    half = lit.mask.shape[1] // 2
    row = lit.rgb[lit.mask.shape[0] // 2, :, 0]
    assert abs(row[half - 30] / row[half + 30] - 1) < 0.03


def test_two_pictures_are_brought_to_one_light() -> None:
    face, mask = disc(120)
    other, other_mask = disc(160, seeds=9)
    tint = np.array([0.8, 0.95, 1.1], np.float32)
    gain = colour_gain(other * tint, other_mask, face, mask)
    np.testing.assert_allclose(gain * tint, 1, atol=0.04)
    np.testing.assert_array_equal(colour_gain(other, other_mask, face, mask), 1)


def test_shades_of_dark_colours_are_not_taken_for_light() -> None:
    """Two faces of a melon in the same light, one a little redder: the white rind is not changed."""
    mask = disc(160)[1]
    rind = ndimage.distance_transform_edt(mask)[..., None] < 12
    one, other = (np.where(rind, 0.9, flesh).astype(np.float32) for flesh in ([0.85, 0.16, 0.16], [0.86, 0.19, 0.18]))
    np.testing.assert_array_equal(colour_gain(one, mask, other, mask), 1)


def test_modes_and_orientation(tmp_path: Path) -> None:
    face, mask = disc(120)
    face[20:50][mask[20:50]] = 0.0  # darker at the top
    grey = (face.mean(-1) * 65535).astype(np.uint16)
    Image.fromarray(grey).save(tmp_path / "deep.png")
    assert read_picture(tmp_path / "deep.png", "radial").rgb.shape[2] == 3
    holes = face.mean(-1)
    holes[:3, :3] = [[np.nan, np.inf, -np.inf]]
    Image.fromarray(holes.astype(np.float32)).save(tmp_path / "holes.tif")
    assert abs(read_picture(tmp_path / "holes.tif", "radial").mask.sum() - mask.sum()) < 0.1 * mask.sum()
    exif = Image.Exif()
    exif[0x0112] = 3  # upside down
    Image.fromarray((face[::-1, ::-1] * 255).astype(np.uint8)).save(tmp_path / "turned.jpg", exif=exif, quality=95)
    read = read_picture(tmp_path / "turned.jpg", "radial")
    third = len(read.rgb) // 3
    assert read.rgb[:third].mean() < read.rgb[-third:].mean()


@pytest.mark.parametrize("mode", ["P", "1"])
def test_few_colours_are_blended_where_a_picture_is_made_smaller(tmp_path: Path, mode: str) -> None:
    board = np.indices((1600, 1600)).sum(0) % 2 * 255
    Image.fromarray(board.astype(np.uint8)).convert(mode).save(tmp_path / "a.png")
    rgb, _ = read_photograph(tmp_path / "a.png")
    assert rgb.shape == (MAX_SIDE, MAX_SIDE, 3) and rgb.std() < 0.1


def test_refusals_are_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no picture")
    save(tmp_path / "blank.png", np.full((100, 100, 3), 0.5))
    save(tmp_path / "tiny.png", np.zeros((8, 8, 3)))
    save(tmp_path / "noise.png", np.random.default_rng(0).random((100, 100, 3)))
    for name in ("text", "blank", "tiny", "noise", "missing"):
        with pytest.raises(InputError, match=name) as caught:
            read_picture(tmp_path / f"{name}.png", "horizontal")
        assert "\n" not in str(caught.value)
    many = Family("parallel", 60, tuple(tmp_path / f"{n}.png" for n in range(41)))
    with pytest.raises(InputError, match="41 pictures of cut faces; give at most 40"):
        ExemplarPrior().solve(ball(), UP, [many], 16, 0, quiet)
    with pytest.raises(InputError, match="no exemplar"):
        ExemplarPrior().solve(ball(), UP, [Family("horizontal", 40)], 16, 0, quiet)


def test_photograph_of_an_orange() -> None:
    photo = SHARED / "photos/sliced_orange.png"
    if not photo.exists():
        pytest.skip("the photographs are not beside the repository")
    assert read_picture(photo, "horizontal").mask.mean() > 0.6


def test_an_enlarged_picture_resolves_what_it_did_before(tmp_path: Path) -> None:
    face, mask = disc(100, seeds=12)
    lens = ndimage.gaussian_filter(np.where(mask[..., None], face, 1), (0.7, 0.7, 0))
    sharp = Image.fromarray((255 * lens).astype(np.uint8))
    shares = []
    for times in (1, 4):
        sharp.resize((100 * times,) * 2, Image.Resampling.BICUBIC).save(tmp_path / f"{times}.png")
        shares.append(resolved_share(read_picture(tmp_path / f"{times}.png", "horizontal")))
    assert shares[0] == 1
    assert 1 / 4 < shares[1] < 0.6


@pytest.mark.slow
def test_the_volume_is_no_finer_than_the_pictures_need(tmp_path: Path) -> None:
    families = (Family("horizontal", 4, (save(tmp_path / "small.png", disc(30, seeds=6)[0]),)),)
    body, prior = ball(), ExemplarPrior()
    asked, coarse = (prior.solve(body, UP, families, voxels, 0, quiet) for voxels in (32, 128))
    side = np.ptp(body.bounds(), axis=0).max()
    assert asked.body.grid.cell == pytest.approx(side / 32)
    assert 24 < side / coarse.body.grid.cell <= 2 * 30


SIDES = ("L", "T", "R", "B", "LR", "LT", "LTRB")
"""Sides from which a picture is cropped: left, top, right, bottom."""


def cropped(picture: NDArray, mask: NDArray[np.bool_], sides: str, share: float) -> NDArray:
    """The picture without this share of the face's width, cut off on these sides."""
    rows, columns = np.nonzero(mask)
    top, left = (round(v.min() + share * np.ptp(v)) for v in (rows, columns))
    bottom, right = (round(v.max() - share * np.ptp(v)) for v in (rows, columns))
    return picture[
        top if "T" in sides else 0 : bottom if "B" in sides else None,
        left if "L" in sides else 0 : right if "R" in sides else None,
    ]


@pytest.mark.parametrize("flesh", ["red", "pale", "two backgrounds"])
def test_a_face_that_the_border_cuts_off_is_completed_or_refused(tmp_path: Path, flesh: str) -> None:
    """Of a pale face only the rind stands out once the border has marked flesh as background; it is the same from all
    sides, so one for each number of them is enough."""
    face, mask = disc(200, seeds=6, radius=0.7)
    if flesh == "pale":
        y, x = np.mgrid[:200, :200] / 100 - 1
        face[(np.hypot(x, y) < 0.62) & (face[..., 0] > 0.5)] = [0.95, 0.93, 0.86]
    behind = np.ones((200, 200, 3))
    if flesh == "two backgrounds":
        behind[:90] = [0.35, 0.4, 0.5]
    picture = np.where(mask[..., None], face, behind)
    whole = read_picture(save(tmp_path / "whole.png", picture), "horizontal")
    assert overlap(whole.mask, mask) > 0.96
    completed = set()
    for sides in ("L", "LR", "LT", "LTRB") if flesh == "pale" else SIDES:
        for share in (0.05, 0.15, 0.45):
            path = save(tmp_path / f"{sides}_{share}.png", cropped(picture, mask, sides, share))
            refused = pytest.raises(InputError, match=r"border|stands out")
            with contextlib.suppress(pytest.fail.Exception), refused:
                found = read_picture(path, "horizontal")
                completed.add((sides, share))
            if (sides, share) not in completed:
                continue
            np.testing.assert_allclose(
                np.ptp(np.nonzero(found.mask), 1),
                np.ptp(np.nonzero(whole.mask), 1),
                rtol=0.06,
                err_msg=f"{sides} {share}",
            )
    assert all(share < 0.4 for _, share in completed)
    if flesh == "red":
        assert ("L", 0.15) in completed


@pytest.mark.parametrize("kind", ["horizontal", "radial"])
def test_what_the_border_cuts_off_shows_the_other_side(tmp_path: Path, kind: Kind) -> None:
    y, x = (np.mgrid[:200, :200] + 0.5) / 100 - 1
    mask = np.hypot(x, y) < 0.7
    face = np.where(mask[..., None], [0.9, 0.5, 0.1], 1.0)
    face[mask & (np.hypot(x, y) > 0.6)] = [0.2, 0.5, 0.1]
    for side in (-1, 1):
        face[np.hypot(x - side * 0.45, y - 0.2) < 0.08] = [0.2, 0.1, 0.1]
    whole = read_picture(save(tmp_path / "whole.png", face), kind)
    part = read_picture(save(tmp_path / "part.png", face[:, 50:]), kind)
    if kind == "horizontal":
        assert whole.core is not None and part.core is not None
        wider = whole.mask.shape[1] - part.mask.shape[1]
        np.testing.assert_allclose(part.core, np.array(whole.core) - [wider, 0], atol=3)
    size = min(whole.mask.shape[1], part.mask.shape[1])
    seen = [p.rgb[4:-4, p.mask.shape[1] - size :][: whole.mask.shape[0] - 12] for p in (whole, part)]
    rows = min(len(s) for s in seen)
    assert np.abs(seen[0][:rows] - seen[1][:rows]).mean() < 0.04  # for colours from 0.1 to 0.9


def test_what_the_border_cuts_off_of_an_oblique_slice_goes_on_as_it_was() -> None:
    """Ten segments in a rind, in light from one side."""
    y, x = (np.mgrid[:240, :240] + 0.5 - 120) / 100
    along, across = x * 0.8 - y * 0.6, (x * 0.6 + y * 0.8) / 0.7
    radius, turn = np.hypot(along, across), np.arctan2(across, along)
    flesh = np.where(np.cos(10 * turn)[..., None] > 0.8, [0.95, 0.9, 0.8], [0.9, 0.55, 0.1])
    face = np.where(radius[..., None] > 0.9, [0.3, 0.5, 0.1], flesh) * (0.9 + 0.1 * y[..., None])
    truth = np.where(radius[..., None] < 1, face, 1).astype(np.float32)
    slivers = [(0, 240, 0, right) for right in range(196, 208)]
    large = [(0, 240, 0, 175), (0, 240, 65, 240), (0, 180, 0, 240), (60, 240, 0, 240), (0, 240, 42, 198)]
    for top, bottom, left, right in slivers + large:
        seen = slice(top, bottom), slice(left, right)
        completed, mask, (columns, rows) = complete_face(truth[seen], radius[seen] < 1, has_poles=False)
        where = np.nonzero(mask)
        there = where[0] + top - rows, where[1] + left - columns
        made = (there[0] < top) | (there[0] >= bottom) | (there[1] < left) | (there[1] >= right)
        assert mask.sum() == pytest.approx((radius < 1).sum(), rel=0.01)
        assert np.abs(completed[where] - truth[there])[made].mean() < 0.06, (top, bottom, left, right)


def test_a_cut_out_face_that_the_border_cuts_in_half_is_said_to_be(tmp_path: Path) -> None:
    face, mask = disc(160)
    cut_out = np.concatenate([face, mask[..., None]], -1)
    for shown, said in ((cut_out[:, 80:], True), (cut_out[:, 30:], False), (cut_out[16:-16, 16:-16], False)):
        assert ("cuts the cut face off" in read_picture(save(tmp_path / "a.png", shown), "horizontal").note) == said


def test_a_cut_out_face_may_fill_its_picture(tmp_path: Path) -> None:
    face, mask = disc(160)
    tight = cropped(np.concatenate([face, mask[..., None]], -1), mask, "LTRB", 0.0)
    assert read_picture(save(tmp_path / "tight.png", tight), "horizontal").mask.mean() > 0.6
    picture = np.concatenate([face, mask[..., None]], -1)
    half = read_picture(save(tmp_path / "half.png", cropped(picture, mask, "L", 0.3)), "horizontal")
    assert 0.5 < half.mask.mean() < 0.9


@pytest.mark.slow
def test_photographs_that_are_cut_off_by_more_are_refused(tmp_path: Path) -> None:
    folder = SHARED / "photos/fruit"
    if not folder.exists():
        pytest.skip("the photographs are not beside the repository")
    for name, sides, share in (("apple_h1", "LTRB", 0.05), ("bread_1", "L", 0.3)):
        picture = np.asarray(Image.open(folder / f"{name}.png").convert("RGB")) / 255
        with Image.open(folder / f"masks/{name}.png") as opened:
            truth = np.asarray(opened.convert("L")) > 127
        assert overlap(read_picture(folder / f"{name}.png", "horizontal").mask, truth) > 0.9
        with pytest.raises(InputError, match=r"border|stands out"):
            read_picture(save(tmp_path / "crop.png", cropped(picture, truth, sides, share)), "horizontal")


def test_a_core_beside_the_face_is_told_of(tmp_path: Path) -> None:
    face, mask = disc(120)
    path = save(tmp_path / "a.png", np.where(mask[..., None], face, 1.0))
    beside, within = (read_picture(path, "horizontal", Marks(core=core)) for core in ((0.01, 0.5), (0.45, 0.5)))
    assert "beside the cut face" in beside.note and not within.note
    assert np.isfinite(Disc.of(beside).rgb).all()
