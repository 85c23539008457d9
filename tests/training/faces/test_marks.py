"""Training reads the outlines and axes that the user gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from engine.errors import InputError
from tests.helpers.exemplar_faces import FLESH, SEED, UP, ball, disc, quiet, save
from training.faces.marks import UNMARKED, Marks
from training.families import Family
from training.priors.exemplar import ExemplarPrior
from training.priors.exemplar.frames import make_space, scale_to_voxels
from training.priors.exemplar.patches import POLAR, RADIAL
from training.priors.exemplar.pictures import axis_of, find_face, read_picture
from training.priors.exemplar.placement import bend_picture, find_own_plane
from training.priors.exemplar.quilting.disc import Disc
from training.request import Request


def marked(folder: Path, x: float, y: float) -> Path:
    """A plain face with a dark spot at (x, y), in fractions of the picture's sides."""
    picture, mask = disc(200)
    rows, columns = (np.mgrid[:200, :200] + 0.5) / 200
    picture = np.where((mask & (np.hypot(columns - x, rows - y) < 0.03))[..., None], SEED, picture)
    return save(folder / "face.png", picture)


def test_an_outline_wins_over_a_mask_and_over_what_is_found(tmp_path: Path) -> None:
    path = save(tmp_path / "plain.png", np.full((100, 150, 3), 0.5))
    with pytest.raises(InputError):
        find_face(path)
    box = Marks(((0.2, 0.2), (0.6, 0.2), (0.6, 0.9), (0.2, 0.9)))
    expected = np.zeros((100, 150), bool)
    expected[20:90, 30:90] = True
    assert np.array_equal(find_face(path, box)[1].mask, expected)
    Image.fromarray(~expected).save(tmp_path / "plain.mask.png")
    assert np.array_equal(find_face(path, box)[1].mask, expected)


def test_the_core_that_is_given_is_the_middle_of_the_disc(tmp_path: Path) -> None:
    spot = (0.6, 0.42)
    path = marked(tmp_path, *spot)
    for marks, radius in ((Marks(core=spot), 0.0), (UNMARKED, np.hypot(0.1, 0.08) / 0.4)):
        picture = read_picture(path, "horizontal", marks)
        dark = Disc.of(picture).rgb.sum(-1) < 0.5 * FLESH.sum()
        size = dark.shape[0]
        x, y = ((np.argwhere(dark).mean(0) + 0.5) / size * 2 - 1) * 1.1
        assert abs(np.hypot(x, y) - radius) < 0.04  # the spot is stretched towards the farther side of the rim
        assert radius == 0 or (x > 0 and y > 0)
        scaled = scale_to_voxels(picture, make_space(ball(), UP, 24), POLAR, 400.0)
        at_core = scaled.read(np.array([scaled.middle[0]]), np.array([scaled.middle[1]]))[0]
        assert (np.abs(at_core - SEED).max() < 0.1) == (radius == 0)


def test_the_core_that_is_given_lies_on_the_axis_of_the_solved_body(tmp_path: Path) -> None:
    spot = (0.6, 0.42)
    path = marked(tmp_path, *spot)
    for marks, is_dark in (((), False), (((path, Marks(core=spot)),), True)):
        family = Family("horizontal", 3, (path,), marks=marks)
        rgb = ExemplarPrior().solve(ball(32), UP, [family], 32, 0, quiet).rgb
        middle = rgb.shape[0] // 2
        on_axis = rgb[middle - 1 : middle + 1, middle - 1 : middle + 1, middle].mean()
        assert (on_axis < 0.6 * FLESH.mean()) == is_dark


def test_a_radial_cut_is_turned_by_the_line_that_is_given(tmp_path: Path) -> None:
    picture, mask = disc(200)
    rows, columns = (np.mgrid[:200, :200] + 0.5) / 200
    leaning = mask & (np.abs((columns - 0.55) - 0.5 * (0.5 - rows)) < 0.02)  # a dark bar breaks the face's symmetry
    path = save(tmp_path / "bar.png", np.where(leaning[..., None], SEED, picture))
    line = ((0.55 + 0.5 * 0.35, 0.15), (0.55 - 0.5 * 0.35, 0.85))
    read = read_picture(path, "radial", Marks(line=line))
    assert read.core is not None
    dark = ndimage.binary_erosion(read.mask, iterations=8) & (read.rgb.sum(-1) < 0.5 * FLESH.sum())
    found = np.nonzero(dark)[1] + 0.5
    assert found.std() < 4 and abs(found.mean() - read.core[0]) < 1.5
    scaled = scale_to_voxels(read, make_space(ball(), UP, 24), RADIAL, 400.0)
    assert scaled.read(np.array([scaled.middle[0]]), np.array([scaled.middle[1]])).sum() < 0.5


def test_an_axis_file_is_read_where_the_user_says_nothing_else(tmp_path: Path) -> None:
    path = marked(tmp_path, 0.6, 0.42)
    before = Request(path, (Family("horizontal", 1, (path,)),)).fingerprint()
    beside = tmp_path / "face.axis.json"
    beside.write_text('{"core": [0.6, 0.42], "line": [[0.5, 0.1], [0.55, 0.9]]}')
    assert Request(path, (Family("horizontal", 1, (path,)),)).fingerprint() != before
    given = read_picture(path, "horizontal", Marks(core=(0.6, 0.42)))
    assert read_picture(path, "horizontal").core == given.core
    assert read_picture(path, "horizontal", Marks(core=(0.3, 0.5))).core != given.core
    wrong = ("", "[]", "{}", '{"core": [0.5]}', '{"core": [2, 0]}', '{"line": [[0, 0], [0, 0]]}', '{"axis": [0, 0]}')
    for text in wrong:
        beside.write_text(text)
        with pytest.raises(InputError) as caught:
            read_picture(path, "horizontal")
        assert str(caught.value).startswith(str(beside)) and "\n" not in str(caught.value)


def test_a_face_is_placed_by_the_same_law_with_the_axis_that_was_found_for_it(tmp_path: Path) -> None:
    """Training treats an untouched picture as the window shows it."""
    y, x = (np.mgrid[:200, :260] + 0.5) / 200
    turned = np.hypot(0.94 * (x - 0.65) + 0.34 * (y - 0.5), 1.3 * (0.94 * (y - 0.5) - 0.34 * (x - 0.65))) / 0.42
    rgb = np.where((turned < 1)[..., None], np.stack([0.5 + 0.3 * turned, 0.5 * turned, 0.2 + 0 * turned], -1), 1.0)
    path = save(tmp_path / "oval.png", rgb)
    rgb, face = find_face(path)
    for kind in ("horizontal", "radial"):
        plane = find_own_plane(ball(), UP, Family(kind, 1))
        by_itself, with_axis = (
            bend_picture(read_picture(path, kind, marks), plane).astype(int)
            for marks in (UNMARKED, axis_of(rgb, face.mask, kind))
        )
        assert np.abs(by_itself - with_axis).mean() < 0.5
