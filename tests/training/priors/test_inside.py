"""The inside as a function: as fine as its photographs, the same from a file, and kept through a whole run."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.errors import InputError
from engine.io.trained import Meta, inside_path, load_inside_record, save_trained
from tests.helpers.exemplar_faces import UP, ball, save
from tests.helpers.solids import ball as atoms_of_a_ball
from tests.helpers.workers.batch_worker import SMALL
from tests.paths import SAMPLES
from tests.training.priors.quilting.test_grains import drawn, laid_out
from training.events import Reporter
from training.families import Family
from training.pipeline import run
from training.priors.exemplar import ExemplarPrior
from training.priors.exemplar.frames import make_space
from training.priors.exemplar.quilting import quilt
from training.priors.exemplar.quilting.disc import DISC_PIXELS, REACH, BallMap, Disc, disc_grid
from training.priors.exemplar.quilting.inside import QUILT, QuiltInside
from training.priors.exemplar.quilting.quilt import make_quilt
from training.priors.inside_file import read_inside, restore_inside
from training.request import Interrupted, Request

CELLS = 32


@pytest.fixture(autouse=True)
def _coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quilt, "LEVELS", (16, 32))


def striped() -> Disc:
    """A face with stripes four pixels wide, much finer than the cells of the body."""
    x, y = disc_grid()
    waves = np.sin(2 * np.pi * (x + 0.3 * y) * DISC_PIXELS / (2 * REACH) / 8)
    rgb = np.where((waves > 0)[..., None], [0.9, 0.5, 0.2], [0.6, 0.2, 0.1])
    return Disc.of_bytes((rgb * 255).astype(np.uint8))


@pytest.fixture(scope="module")
def inside() -> QuiltInside:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quilt, "LEVELS", (16, 32))
        space = make_space(ball(), UP, CELLS)
        map_ = BallMap.of(space)
        made = make_quilt([striped()], [striped()], 3, lambda part: None, map_.height)
    return QuiltInside.of(space, map_, made, [striped()], [striped()], 3)


def own_plane(inside: QuiltInside, footprint: float) -> np.ndarray:
    """(N, 3). Points in the plane of the horizontal picture, a footprint apart."""
    half = 0.5 * float(inside.ball.skin.mean()) * inside.cell
    side = np.arange(-half, half, footprint)
    u, v = np.meshgrid(side, side)
    return inside.origin + u.reshape(-1, 1) * inside.basis[0] + v.reshape(-1, 1) * inside.basis[1]


def test_its_own_plane_is_the_photograph(inside: QuiltInside) -> None:
    pixel = 2 * REACH / DISC_PIXELS * float(inside.ball.skin.mean()) * inside.cell
    rgb = inside.at(own_plane(inside, 3 * pixel), pixel)
    stripes = np.array([[0.9, 0.5, 0.2], [0.6, 0.2, 0.1]])
    off = np.linalg.norm(rgb[:, None] - stripes, axis=-1).min(1)
    assert np.median(off) < 0.05 and 0.3 < (rgb[:, 0] > 0.75).mean() < 0.7


def test_from_afar_it_is_even_and_not_a_moire(inside: QuiltInside) -> None:
    pixel = 2 * REACH / DISC_PIXELS * float(inside.ball.skin.mean()) * inside.cell
    points = own_plane(inside, 16 * pixel)
    near, far = inside.at(points, pixel), inside.at(points, 16 * pixel)
    assert far.std(0).max() < 0.35 * near.std(0).max()
    assert np.abs(far.mean(0) - near.mean(0)).max() < 0.04


def test_a_record_makes_the_same_bits(inside: QuiltInside) -> None:
    points = own_plane(inside, 0.1) + 0.05 * inside.basis[2]
    again = restore_inside(inside.record())
    assert np.array_equal(again.at(points, 0.01), inside.at(points, 0.01))
    assert sum(array.nbytes for array in inside.record()[0].values()) < 3_000_000  # no grid of colours


@pytest.mark.parametrize("horizontal", [True, False])
def test_one_family_alone_is_kept_and_makes_the_same_bits(inside: QuiltInside, horizontal: bool) -> None:
    families: tuple[list[Disc], list[Disc]] = ([striped()], []) if horizontal else ([], [striped()])
    made = make_quilt(*families, 3, lambda part: None, inside.ball.height)
    alone = replace(inside, quilt=made, horizontal=families[0], radial=families[1], _reduced={})
    points = own_plane(inside, 0.1) + 0.05 * inside.basis[2]
    assert np.array_equal(restore_inside(alone.record()).at(points, 0.01), alone.at(points, 0.01))
    arrays, facts = alone.record()
    del arrays["horizontal" if horizontal else "radial"]
    with pytest.raises(ValueError, match="no pictures"):
        restore_inside((arrays, facts))


def test_a_wrong_record_is_none(inside: QuiltInside, monkeypatch: pytest.MonkeyPatch) -> None:
    arrays, facts = inside.record()
    # Preparing the sources takes seconds, and detects no wrong label.
    sources = [inside.quilt.rinds, *(label.sources for label in inside.quilt.labels[:2])]
    monkeypatch.setattr(quilt, "_make_sources", lambda *_: sources)
    wrong: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (arrays, facts | {"kind": "spell"}),
        (arrays, facts | {"seed": -1}),
        (arrays, facts | {"cell": 0.0}),
        (arrays, facts | {"rise": float("nan")}),
        (arrays, facts | {"cell": True}),
        (arrays | {"chosen": arrays["chosen"][:-1]}, facts),
        (arrays | {"chosen": arrays["chosen"] + np.uint8(100)}, facts),
        (arrays | {"chosen": arrays["chosen"].astype(np.int64)}, facts),
        (arrays | {"skin": -arrays["skin"]}, facts),
        (arrays | {"skin": np.full((4, 4), np.nan)}, facts),
        (arrays | {"basis": np.eye(2)}, facts),
        (arrays | {"radial": arrays["radial"][:, :100]}, facts),
        (arrays | {"radial": np.float32(1)}, facts),
        (arrays | {"horizontal": arrays["horizontal"][:0], "radial": arrays["radial"][:0]}, facts),
        ({}, facts),
        (arrays, {}),
    ]
    for record in wrong:
        with pytest.raises(ValueError, match=r"\w"):
            restore_inside(record)


def test_a_file_is_the_object_s_own(inside: QuiltInside, tmp_path: Path) -> None:
    path, other = tmp_path / "a.ply", tmp_path / "b.ply"
    solid = atoms_of_a_ball(1 / 6, degree=0)
    save_trained(path, solid, Meta(), inside.record())
    points = own_plane(inside, 0.1)
    found = read_inside(path)
    assert found is not None and np.array_equal(found.at(points, 0.01), inside.at(points, 0.01))
    # Other objects have none, whatever lies beside them; without its file an object has only its atoms.
    save_trained(other, solid, Meta(seed=1))
    inside_path(path).rename(inside_path(other))
    assert read_inside(other) is None and read_inside(path) is None
    # Damage, and the leftovers of an older training.
    data = bytearray(inside_path(other).read_bytes())
    data[len(data) // 2] ^= 1
    inside_path(path).write_bytes(data)
    with pytest.raises(InputError, match=r"a\.inside\.safetensors: damaged"):
        load_inside_record(path)
    save_trained(path, solid, Meta())
    assert not inside_path(path).exists()


@pytest.mark.slow
def test_a_run_keeps_it_and_resumes_to_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in SMALL.items():
        monkeypatch.setattr(name, value)
    monkeypatch.setattr("training.priors.exemplar.quilting.quilt.LEVELS", (16,))
    x, y = disc_grid()
    grains = np.where((np.hypot(x, y) < 1)[..., None], drawn(laid_out(0.15), 0.07).rgb, 1)
    families = (Family("radial", 2, (save(tmp_path / "grains.png", grains),)),)
    request = Request(SAMPLES / "watermelon/watermelon.ply", families, "draft", (0.0, 0.0, 1.0))
    once, twice = tmp_path / "once", tmp_path / "twice"
    path = run(request, once, Reporter(), False, lambda: False)
    labels = twice / "checkpoint/labels.safetensors"
    said = io.StringIO()
    solve = ExemplarPrior.solve
    monkeypatch.setattr(ExemplarPrior, "solve", lambda *a: replace(solve(*a), notes=("look at the face",)))
    with pytest.raises(Interrupted):
        run(request, twice, Reporter(), False, labels.exists)
    run(request, twice, Reporter(said), True, lambda: False)
    assert "look at the face" in said.getvalue()
    record = load_inside_record(path)
    assert record is not None and record[1]["kind"] == QUILT
    for file in (path.name, inside_path(path).name, "cuts.png"):
        assert (once / file).read_bytes() == (twice / file).read_bytes(), file
