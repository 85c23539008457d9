"""The limits of the method: each case ends in a finite result, a counted warning, or one clear error.

Whole small runs, on shells of closed form with pictures drawn here; the limits of single parts are covered by their own
tests. The sweeps that show how far the method holds are `benchmarks/stability.py`.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import training.optimise.trainer
import training.request
from engine.errors import InputError
from engine.fit.sh_fit import fit_sh
from engine.io.splats.ply import write_ply
from engine.io.trained import load_trained
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane
from engine.solid.fill import Colours
from engine.solid.find_body import find_body
from tests.engine.fit.test_sh_fit import sphere as patches
from tests.engine.fit.test_sh_fit import views_of
from tests.helpers.exemplar_faces import disc, save
from tests.helpers.solids import ball as solid
from tests.helpers.solids import flat_gaussians, joined, sphere
from tests.helpers.workers.batch_worker import SMALL
from training.evaluate.methods.ablations import Looped
from training.events import Reporter
from training.families import Family
from training.labels import back_project
from training.optimise.smoothing import smooth
from training.optimise.trainer import Trainer
from training.pipeline import Pipeline, run
from training.request import Geometry, Request
from training.views import Section, sections, slices

FLESH, RIND = (0.9, 0.4, 0.3), (0.2, 0.6, 0.2)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in SMALL.items():
        monkeypatch.setattr(name, value)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of cut faces: flesh in a rind on white, in colour, in grey, tiny, and far too wide."""
    folder = tmp_path_factory.mktemp("pictures")
    for name, height, width, mode in (("a", 48, 48, "RGB"), ("grey", 48, 48, "L"), ("tiny", 6, 6, "RGB"),
                                      ("wide", 10, 400, "RGB")):  # fmt: skip
        y, x = np.mgrid[:height, :width]
        r = np.hypot((2 * x + 1) / width - 1, (2 * y + 1) / height - 1)[..., None]
        picture = np.where(r < 0.85, np.where(r < 0.82, FLESH, RIND), 1.0)
        Image.fromarray((255 * picture).astype(np.uint8)).convert(mode).save(folder / f"{name}.png")
    return folder


def ball(n: int = 2000, dc: float = 0.3, **other: Any) -> Gaussians:
    scene = sphere(n, **other)
    return replace(scene, sh=np.full((len(scene), 1, 3), dc, np.float32))


def scaled(scene: Gaussians, factor: float) -> Gaussians:
    return replace(scene, means=scene.means * np.float32(factor), scales=scene.scales * np.float32(factor))


def stretched(scene: Gaussians, *factors: float) -> Gaussians:
    return replace(scene, means=scene.means * np.array(factors, np.float32))


def misty(n: int = 300) -> Gaussians:
    """Large faint Gaussians all around."""
    mist = flat_gaussians(np.random.default_rng(0).normal(size=(n, 3)), np.tile([0.0, 0, 1], (n, 1)), 0.6)
    return replace(mist, opacities=np.full(n, 0.04, np.float32))


def sized(scene: Gaussians, size: float) -> Gaussians:
    return replace(scene, scales=np.full((len(scene), 3), size, np.float32))


def trained(
    folder: Path,
    scene: Gaussians,
    families: tuple[Family, ...],
    up: tuple[float, float, float] | None = (0.0, 0.0, 1.0),
) -> tuple[Atoms, list[str]]:
    """Runs a small training: the solid that was saved, and the warnings given."""
    write_ply(folder / "ball.ply", scene)
    events = io.StringIO()
    path = run(
        Request(folder / "ball.ply", families, "draft", up), folder / "out", Reporter(events), False, lambda: False
    )
    atoms, _ = load_trained(path)  # refuses values that are not finite
    report = json.loads((folder / "out/report.json").read_text(), parse_constant=pytest.fail)
    assert np.isfinite(report["losses"]["section"]).all()
    lines = [json.loads(line) for line in events.getvalue().splitlines()]
    return atoms, [line["message"] for line in lines if line["event"] == "warning"]


CAPTURES: dict[str, tuple[Callable[[], Gaussians], str]] = {
    "plain": (ball, ""),
    "micrometres": (lambda: scaled(ball(), 1e-6), ""),
    "megametres": (lambda: scaled(ball(), 1e6), ""),
    "coincident": (lambda: joined(ball(1200), ball(1200), ball(1200)), ""),
    "sizes of 1e-20 and 1e6": (lambda: joined(ball(), sized(ball(60), 1e-20), sized(ball(60), 1e6)), "120 of 2,120"),
    "flat": (lambda: stretched(ball(4000), 1, 1, 0.12), ""),
    "open and hazy": (lambda: joined(ball(hole=50), misty()), "the shell is open"),
    "under black": (lambda: ball(dc=-9.0), ""),
    "over white": (lambda: ball(dc=900.0), ""),
}


@pytest.mark.parametrize("case", CAPTURES)
def test_captures_at_the_limit_become_solids(case: str, tmp_path: Path, pictures: Path) -> None:
    scene, told = CAPTURES[case]
    families = (Family("horizontal", 4, (pictures / "a.png",)), Family("radial", 3, (pictures / "a.png",)))
    atoms, warnings = trained(tmp_path, scene(), families)
    assert told in "\n".join(warnings)
    extent = np.ptp(scene().means, axis=0).max()
    assert len(atoms.interior) > 200
    assert np.abs(atoms.interior.means).max() < extent  # no atom has flown off
    assert np.abs(np.median(atoms.interior.rgb, axis=0) - FLESH).max() < 0.15


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (lambda: ball()[:10], "10 Gaussians are too few"),
        (lambda: replace(ball(), opacities=np.full(2000, 0.03, np.float32)), "too thin"),
        (lambda: replace(ball(), scales=ball().scales * np.array([12, 0.02, 0.02], np.float32)), "too large"),
    ],
    ids=["ten", "faint", "needles longer than a quarter of it"],
)
def test_captures_beyond_it_get_one_line(
    scene: Callable[[], Gaussians], said: str, tmp_path: Path, pictures: Path
) -> None:
    with pytest.raises(InputError, match=f"^ball.ply: no closed body found.*{said}"):
        trained(tmp_path, scene(), (Family("horizontal", 4, (pictures / "a.png",)),))


def test_needles_shorter_than_that_are_a_skin() -> None:
    scene = ball(6000)
    needles = replace(scene, scales=scene.scales * np.array([3, 0.5, 0.1], np.float32))
    body = find_body(needles, cells=48).body
    assert abs(body.volume / (4 / 3 * np.pi) - 1) < 0.05


def test_a_stick_twenty_times_as_long_as_thick_is_found() -> None:
    body = find_body(stretched(ball(8000), 1, 1, 20), cells=160).body
    assert abs(body.volume / (4 / 3 * np.pi * 20) - 1) < 0.1


PLANE = Plane.of((0, 0, 1), 0.1)
FAR = Plane.of((0, 0, 1), 50)
FAMILIES: dict[str, tuple[Callable[[Path], tuple[Family, ...]], str]] = {
    "one plane": (lambda p: (Family("horizontal", 1, (p / "a.png",)),), ""),
    "one plane, five times": (lambda p: (Family("custom", 5, (p / "a.png",), custom=(PLANE,) * 5),), ""),
    "some miss": (lambda p: (Family("custom", 2, (p / "a.png",), custom=(PLANE, FAR)),), "1 of 2 planes miss"),
    "a family without pictures": (lambda p: (Family("horizontal", 3, (p / "a.png",)), Family("radial", 3)), ""),
    "grey": (lambda p: (Family("horizontal", 3, (p / "grey.png",)), Family("radial", 3, (p / "grey.png",))), ""),
}


@pytest.mark.parametrize("case", FAMILIES)
def test_odd_families_give_colours_all_over(case: str, tmp_path: Path, pictures: Path) -> None:
    families, told = FAMILIES[case]
    atoms, warnings = trained(tmp_path, ball(), families(pictures))
    assert told in "\n".join(warnings)
    rgb = atoms.interior.rgb
    wanted = np.full(3, np.dot(FLESH, (0.299, 0.587, 0.114))) if case == "grey" else np.array(FLESH)
    assert np.abs(np.median(rgb, axis=0) - wanted).max() < 0.15
    if case == "grey":
        assert np.ptp(rgb, axis=1).max() < 0.05


def test_atoms_are_no_finer_than_the_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fine = {name: replace(detail, voxels=96, fine=96) for name, detail in training.request.DETAILS.items()}
    monkeypatch.setattr("training.request.DETAILS", fine)
    write_ply(tmp_path / "ball.ply", ball())
    across = []

    class Measured(Pipeline):
        def fill_interior(self, geometry: Geometry, pitch: float, colours: Colours) -> InteriorAtoms:
            across.append(float(np.ptp(geometry.body.bounds(), axis=0).max()) / pitch)
            return super().fill_interior(geometry, pitch, colours)

    picture = save(tmp_path / "small.png", disc(40, seeds=6)[0])  # the cut face is 32 pixels across
    request = Request(tmp_path / "ball.ply", (Family("horizontal", 2, (picture,)),), "draft", (0.0, 0.0, 1.0))
    events = io.StringIO()
    Measured(request, tmp_path / "out", Reporter(events), lambda: False).run(resume=False)
    assert across == [pytest.approx(2 * 32, rel=0.05)]
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["cells"] == round(across[0])
    assert f"an inside {report['cells']} atoms across, not 96" in events.getvalue()


def test_every_step_of_a_pipeline_can_be_overridden(tmp_path: Path, pictures: Path) -> None:
    """Plane by plane, in the pipeline that uses all of the steps."""
    write_ply(tmp_path / "ball.ply", ball())
    steps = {"make_prior", "fill_interior", "draw_label", "smooth_interior", "make_trainer"}
    called: set[str] = set()

    class Recorded(Looped):
        def __getattribute__(self, name: str) -> object:
            if name in steps:
                called.add(name)
            return super().__getattribute__(name)

    request = Request(
        tmp_path / "ball.ply", (Family("horizontal", 2, (pictures / "a.png",)),), "draft", (0.0, 0.0, 1.0)
    )
    Recorded(request, tmp_path / "out", Reporter(), lambda: False).run(resume=False)
    assert called == steps


@pytest.mark.parametrize(
    ("families", "said"),
    [
        (lambda p: (Family("custom", 1, (p / "a.png",), custom=(FAR,)),), "none of the 1 planes meets the object"),
        (lambda p: (Family("custom", 1, custom=(PLANE,)),), "no exemplar pictures"),
        (lambda p: (Family("horizontal", 3, (p / "tiny.png",)),), "only 6x6 pixels"),
        (lambda p: (Family("horizontal", 3, (p / "wide.png",)),), "only 400x10 pixels"),
    ],
    ids=["all miss", "no picture", "tiny", "wide"],
)
def test_families_that_cannot_be_get_one_line(
    families: Callable[[Path], tuple[Family, ...]], said: str, tmp_path: Path, pictures: Path
) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        trained(tmp_path, ball(), families(pictures))


def test_a_wrong_axis_still_fills_the_whole(tmp_path: Path, pictures: Path) -> None:
    families = (Family("horizontal", 4, (pictures / "a.png",)), Family("radial", 3, (pictures / "a.png",)))
    atoms, _ = trained(tmp_path, stretched(ball(3000), 1, 1, 0.6), families, (0.6, 0.0, 0.8))
    assert np.abs(np.median(atoms.interior.rgb, axis=0) - FLESH).max() < 0.15


# Training at its limits.


def crossed(atoms: Atoms) -> list[Section]:
    """A cut face along each of two planes that cross."""
    low, high = atoms.bounds
    cell = float((high - low).max()) / 24
    x, y, z = (int(n) for n in np.ceil((high - low) / cell) + 4)
    grid = Grid((low - 2 * cell).astype(np.float64), cell, (x, y, z))
    middle = (low + high) / 2
    depth = float((high - low).max()) / 2 - np.linalg.norm(grid.centres() - middle, axis=-1)
    body = Body(grid, depth.astype(np.float32))
    up = np.array([0.0, 0.0, 1.0])
    families = [Family("horizontal", 1), Family("radial", 1)]
    return sections(atoms, slices(body, up, families, 48), lambda _: None)


@pytest.fixture(scope="module")
def atoms() -> Atoms:
    return solid(0.08)


def test_labels_that_contradict_each_other_meet_in_between(atoms: Atoms) -> None:
    grey = np.full_like(atoms.interior.rgb, 0.5)
    atoms = replace(atoms, interior=replace(atoms.interior, rgb=grey))
    cuts = crossed(atoms)
    assert len(cuts) == 2
    labels = [torch.full((48, 48, 3), value) for value in (0.0, 1.0)]  # a seed in one family, none in the other
    trainer = Trainer(atoms, cuts, [], 0)
    losses = [trainer.step(labels).section for _ in range(40)]
    assert losses[-1] < losses[0]
    rgb = trainer.result().interior.rgb
    assert np.isfinite(rgb).all()
    assert rgb.min() >= 0 and rgb.max() <= 1
    shown = [cut.weights.used - len(atoms.surface) for cut in cuts]
    first, second = (np.isin(np.arange(len(rgb)), rows) for rows in shown)
    dark, between, light = (rgb[rows].mean() for rows in (first & ~second, first & second, second & ~first))
    assert dark < between < light
    assert dark < 0.49 and light > 0.51


def test_what_no_label_shows_is_smoothed_unless_smoothing_is_left_out(atoms: Atoms) -> None:
    atoms = replace(atoms, interior=replace(atoms.interior, rgb=np.full_like(atoms.interior.rgb, 0.5)))
    cuts = crossed(atoms)
    white = [np.ones((48, 48, 3), np.float32)] * len(cuts)
    kept, shown = back_project(atoms, cuts, white)
    smoothed = smooth(atoms.interior.means, atoms.interior.rgb, kept, shown)
    assert np.allclose(smoothed, 1, atol=1e-5)
    assert 0.1 < (kept == 0.5).all(axis=1).mean() < 0.9
    assert np.isin(np.round(kept, 5), np.array([0.5, 1], np.float32)).all()


@pytest.mark.parametrize("rate", [1.0, 1e6, 1e30])
def test_a_large_learning_rate_stays_bounded(atoms: Atoms, rate: float, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("INTERIOR_RATE", "SURFACE_RATE", "BANDS_RATE"):
        monkeypatch.setattr(training.optimise.trainer, name, rate)
    cuts = crossed(atoms)
    labels = [torch.full((48, 48, 3), 0.5)] * 2
    trainer = Trainer(atoms, cuts, [], 0)
    for _ in range(8):
        losses = trainer.step(labels)
        assert np.isfinite(losses.section)
    result = trainer.result()
    assert np.abs(result.surface.sh).max() <= 10
    assert result.interior.rgb.min() >= 0 and result.interior.rgb.max() <= 1


@pytest.mark.parametrize("dark", [-3.0, -9.0])
def test_colours_under_black_come_back_to_light(dark: float) -> None:
    """The clamp at 0 has no gradient: a fit that starts below it must not get stuck."""
    truth = patches(1, 1)
    start = replace(truth, surface=replace(truth.surface, sh=np.full_like(truth.surface.sh, dark)))
    result = fit_sh(start, views_of(truth, 12))
    assert result.held_out[1] > 20
