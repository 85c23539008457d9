"""The inside from pictures of one object as a function: finer than its grid, and the same from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.exemplar_faces import SEED, UP, ball, disc, quiet, save
from training.families import Family
from training.priors.exemplar import ExemplarPrior
from training.priors.inside_file import restore_inside
from training.priors.prior import Volume

KINDS = ("horizontal alone", "radial alone", "both", "slices")


@pytest.fixture(scope="module", params=KINDS)
def volume(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Volume:
    """The volume of a melon with seeds."""
    folder = tmp_path_factory.mktemp("faces")
    faces = [save(folder / f"{n}.png", disc(seeds=8, radius=0.8 - 0.01 * n)[0]) for n in range(3)]
    both = [Family("horizontal", 8, (faces[0],)), Family("radial", 8, (faces[1],))]
    families = {
        "horizontal alone": both[:1],
        "radial alone": both[1:],
        "both": both,
        "slices": [Family("horizontal", 8, tuple(faces))],
    }
    return ExemplarPrior(same=True).solve(ball(), UP, families[request.param], 48, 0, quiet)


def on_an_oblique_plane(step: float) -> np.ndarray:
    """(N, 3). Points of an oblique cut through the ball, `step` apart."""
    normal = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    right = np.cross(normal, UP) / np.linalg.norm(np.cross(normal, UP))
    u, v = np.meshgrid(*2 * [np.arange(-0.85, 0.85, step)])
    points = u.reshape(-1, 1) * right + v.reshape(-1, 1) * np.cross(normal, right) + 0.1 * normal
    return points[np.linalg.norm(points, axis=1) < 0.82]


def test_it_is_the_grid_but_finer(volume: Volume) -> None:
    assert volume.inside is not None
    points = on_an_oblique_plane(0.02)
    fine, coarse = volume.inside.at(points, 0.001), volume.at(points)
    # Sharper everywhere, so different at edges; but no thing is missing or misplaced.
    assert np.median(np.abs(fine - coarse)) < 0.02
    assert np.abs(fine - coarse).mean() < 0.05
    dark = [np.linalg.norm(rgb - SEED, axis=1) < 0.3 for rgb in (fine, coarse)]
    assert (dark[0] & dark[1]).sum() > 0.6 * max(d.sum() for d in dark) > 0


def test_from_afar_it_is_the_mean(volume: Volume) -> None:
    assert volume.inside is not None
    points = on_an_oblique_plane(0.04)
    near, far = volume.inside.at(points, 0.001), volume.inside.at(points, 0.2)
    assert np.abs(far.mean(0) - near.mean(0)).max() < 0.06
    assert far.std(0).max() < near.std(0).max()


def test_a_record_makes_the_same_bits(volume: Volume) -> None:
    assert volume.inside is not None
    record = volume.inside.record()
    points = on_an_oblique_plane(0.01)
    for footprint in (0.001, 0.1):
        assert np.array_equal(restore_inside(record).at(points, footprint), volume.inside.at(points, footprint))


def test_a_wrong_record_is_none(volume: Volume) -> None:
    assert volume.inside is not None
    arrays, facts = volume.inside.record()
    wrong: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (arrays, facts | {"kind": "spell"}),
        (arrays, facts | {"way": ["extrusion"]}),
        (arrays, facts | {"cell": float("nan")}),
        (arrays, facts | {"shape": facts["shape"] | {"inradius": -1.0}}),
        (arrays, facts | {"course": None}),
        (arrays, {key: value for key, value in facts.items() if key != "course"}),
    ]
    for name, array in arrays.items():
        wrong += [
            ({key: kept for key, kept in arrays.items() if key != name}, facts),
            (arrays | {name: array[..., :0]}, facts),
            (arrays | {name: array.astype(np.float32 if array.dtype == np.float64 else np.float64)}, facts),
        ]
        if array.dtype.kind == "f":
            wrong.append((arrays | {name: np.full_like(array, np.nan)}, facts))
    for record in wrong:
        with pytest.raises(ValueError, match=r"\w"):
            restore_inside(record)


def test_details_out_of_their_pictures_are_refused(tmp_path: Path) -> None:
    family = Family("horizontal", 8, (save(tmp_path / "melon.png", disc(seeds=8)[0]),))
    inside = ExemplarPrior().solve(ball(), UP, [family], 32, 0, quiet).inside
    assert inside is not None
    arrays, facts = inside.record()
    rows = arrays["stamps.rows"]
    for change in (
        {"stamps.crop": arrays["stamps.crop"] + np.int32(10**6)},
        {"stamps.crop": arrays["stamps.crop"] - np.int32(10**6)},
        {"stamps.boxes": arrays["stamps.boxes"] * np.int32(2)},
        {"stamps.boxes": arrays["stamps.boxes"] - np.int32(10**6)},
        {"stamps.texels": arrays["stamps.texels"][1:]},
        {"stamps.rows": rows * np.float32(1e6)},
        {"stamps.rows": np.where(np.arange(rows.shape[1]) == 16, np.float32(0), rows)},
    ):
        with pytest.raises(ValueError, match=r"\w"):
            restore_inside((arrays | change, facts))
