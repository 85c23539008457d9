"""How far the method holds: larger holes, a wrong axis, small pictures, few planes, long steps, other seeds.

    python -m benchmarks.stability [--quick] [-o docs/charts]

Small solids of known inside, so that the whole takes a few minutes; the curves show where the method breaks and how,
not how good it can be. Writes stability.png and, with the numbers, stability.json.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch

from benchmarks.interior import body_of, cut_planes
from benchmarks.support.charts import ACCENT, QUIET, plt, save_chart
from benchmarks.support.options import out_folder, parser_of
from engine.errors import InputError
from engine.io.files import write_json
from engine.scene.atoms import Atoms
from engine.scene.camera import plane_points, section
from engine.solid.fill import fill
from engine.solid.find_body import find_body
from sample_scenes.exemplars import save_photographs
from sample_scenes.solids import SOLIDS, Solid
from tests.helpers.solids import NO_SURFACE, sphere
from training.evaluate.methods.ablations import UnsmoothedTrainer
from training.evaluate.metrics import face_psnr
from training.families import Family
from training.optimise import trainer
from training.optimise.trainer import Trainer
from training.priors.exemplar import ExemplarPrior
from training.views import sections, slices

VOXELS = 40
CUT_SIZE = 120
SEEDS = range(10)
SEEDED = ("cake", "watermelon", "orange")
"""Solids made with each of the seeds: layers, randomly placed pips, membranes and pulp."""
HOLES = (0, 20, 40, 60, 70, 80, 90, 100, 110, 120, 135)
"""Half angles of the hole in a sphere, degrees. At 90 half of the sphere is gone."""
TILTS = (0, 5, 10, 20, 45, 90)
OFFSETS = (0.0, 0.1, 0.2, 0.4, 0.6)
LABELS = (12, 16, 24, 48, 96, 160)
PLANES = (2, 4, 8, 16, 32)
PIXELS = (32, 48, 64, 96, 160, 320)
FINE = 96
"""Cells of the volume that small pictures have to fill."""
RATES = (0.01, 0.1, 1.0, 10.0, 100.0, 1e4, 1e8)


def holes(angles: Sequence[int]) -> list[dict[str, Any]]:
    """Found volume over that under a flat lid for each hole, or the refusal."""
    rows: list[dict[str, Any]] = []
    for hole in angles:
        h = 1 - np.cos(np.radians(hole))
        truth = 4 / 3 * np.pi - np.pi * h**2 * (3 - h) / 3
        try:
            found = find_body(sphere(8000, hole=hole), cells=64)
            row = {"volume": round(found.body.volume / truth, 4), "notes": list(found.notes)}
        except InputError as error:
            row = {"volume": None, "notes": [str(error)]}
        rows.append({"hole": hole, **row})
    return rows


def core(offset: float) -> Solid:
    """A ball with a dark column along its axis, `offset` away from the middle."""

    def depth(points: np.ndarray) -> np.ndarray:
        return (1 - np.linalg.norm(points, axis=1)).astype(np.float32)

    def colour(points: np.ndarray) -> np.ndarray:
        inner = np.hypot(points[:, 0] - offset, points[:, 1])[:, None] < 0.22
        rind = np.linalg.norm(points, axis=1)[:, None] > 0.9
        return np.where(rind, (0.2, 0.5, 0.2), np.where(inner, (0.3, 0.1, 0.1), (0.9, 0.7, 0.5))).astype(np.float32)

    return Solid.of(f"core {offset}", ("horizontal", "radial"), depth, colour)


def labels_from_volume(
    solid: Solid, tilt: float = 0.0, seed: int = 0, pixels: int = 96, voxels: int = VOXELS
) -> dict[str, float]:
    """Mean PSNR in dB of held-out cuts of a solved volume, and its cells along the longest side.

    The up axis is tilted by `tilt` degrees; the pictures are `pixels` wide.
    """
    body = body_of(solid, voxels)
    up = np.array([np.sin(np.radians(tilt)), 0.0, np.cos(np.radians(tilt))])
    with tempfile.TemporaryDirectory() as folder:
        families = [Family(kind, 10, save_photographs(solid, kind, Path(folder), pixels)) for kind in solid.families]
        volume = ExemplarPrior().solve(body, up, families, voxels, seed, lambda part: None)
    figures = []
    for plane in cut_planes(solid):
        camera = section(plane, solid.up, solid.bounds, CUT_SIZE)
        true, inside = solid.slice(plane, camera)
        made = np.where(inside[..., None], volume.at(plane_points(camera, plane)), np.float32(1))
        figures.append(face_psnr(made, true, inside))
    side = float(np.ptp(body.bounds(), axis=0).max())
    return {"psnr_db": round(float(np.mean(figures)), 3), "cells": round(side / volume.body.grid.cell)}


def of_small_pictures(solid: Solid, pixels: int) -> dict[str, Any]:
    """The figures of `labels_from_volume` for pictures so wide, or the refusal."""
    try:
        return {"pixels": pixels, **labels_from_volume(solid, pixels=pixels, voxels=FINE)}
    except InputError as error:
        reason = str(error).split(": ", 1)[1]  # without the file, which lies in a folder that is gone
        return {"pixels": pixels, "psnr_db": None, "notes": [reason]}


def seeded(name: str, seeds: Sequence[int]) -> dict[str, Any]:
    """The PSNR of one solid with each seed, its mean and its spread."""
    spread = [labels_from_volume(SOLIDS[name](0), seed=seed)["psnr_db"] for seed in seeds]
    return {"solid": name, "psnr_db": spread, "mean_db": round(float(np.mean(spread)), 3),
            "sd_db": round(float(np.std(spread)), 3)}  # fmt: skip


def fitted(size: int = 96, rate: float = 1.0, planes: int = 24, kind: type[Trainer] = Trainer) -> dict[str, float]:
    """PSNR in dB of the atoms' colours after training on true labels of `size` pixels, at `rate` times the usual rates.

    Once over the atoms that a label shows, once over all.
    """
    solid = SOLIDS["watermelon"](0)
    body = body_of(solid, 32)
    pitch = float(np.ptp(body.bounds(), axis=0).max()) / 26
    interior = fill(body, pitch)
    atoms = Atoms(NO_SURFACE, replace(interior, rgb=np.full_like(interior.rgb, 0.5)), pitch)
    up = np.array([0.0, 0.0, 1.0])
    across = round(planes * 14 / 24)
    families = [Family("horizontal", across), Family("radial", planes - across)]
    cuts = sections(atoms, slices(body, up, families, size), lambda part: None)
    labels = [
        torch.from_numpy(np.where(cut.inside[..., None], solid.colour(cut.points), np.float32(1))) for cut in cuts
    ]
    with (
        mock.patch.object(trainer, "INTERIOR_RATE", 10 * trainer.INTERIOR_RATE * rate),  # from grey, so ten times
        mock.patch.object(trainer, "HALF_LIFE_EPOCHS", 20),
    ):
        training = kind(atoms, cuts, [], 0)
        losses = [training.step(labels).section for _ in range(60)]
        training.smooth()
    rgb, truth = training.result().interior.rgb, solid.colour(interior.means)
    error = ((rgb - truth) ** 2).mean(axis=1)
    return {
        "psnr_db": round(-10 * float(np.log10(error[training.trained].mean())), 3),
        "psnr_all_db": round(-10 * float(np.log10(error.mean())), 3),
        "shown": round(float(training.trained.mean()), 4),
        "loss": round(losses[-1], 5),
        "largest": float(np.abs(rgb).max()),
    }


def main(arguments: list[str] | None = None) -> None:
    """Runs all sweeps and draws them."""
    parser = parser_of(__doc__, "the first two points of each curve")
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    figures = sweeps(2 if options.quick else None)
    print(json.dumps(figures, indent=1))
    if folder:
        target = folder / "stability.json"
        known = json.loads(target.read_text()) if target.exists() else {}
        write_json(target, known | figures)
        draw(figures, folder / "stability.png")


def sweeps(points: int | None) -> dict[str, Any]:
    """Every curve, or only the first points of each."""
    cake, orange = SOLIDS["cake"](0), SOLIDS["orange"](0)
    figures: dict[str, Any] = {"cores": os.cpu_count(), "voxels": VOXELS, "holes": holes(HOLES[:points])}
    figures["labels"] = [{"pixels": size, **fitted(size=size)} for size in LABELS[:points]]
    figures["rates"] = [{"times": rate, **fitted(rate=rate)} for rate in RATES[:points]]
    figures["planes"] = [
        {"planes": count, "smoothed": name, **fitted(planes=count, kind=of)}
        for name, of in ((True, Trainer), (False, UnsmoothedTrainer))
        for count in PLANES[:points]
    ]
    figures["pictures"] = [of_small_pictures(orange, size) for size in PIXELS[:points]]
    figures["tilts"] = [{"degrees": tilt, **labels_from_volume(cake, tilt)} for tilt in TILTS[:points]]
    figures["offsets"] = [{"radii": offset, **labels_from_volume(core(offset))} for offset in OFFSETS[:points]]
    figures["seeds"] = [seeded(name, SEEDS[:points]) for name in SEEDED]
    return figures


def draw(figures: dict[str, Any], path: Path) -> None:
    """Small multiples, one for each way to fail."""
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": 10})
    figure, axes = plt.subplots(2, 4, figsize=(14, 6), layout="constrained")

    def line(at: int, title: str, x: Sequence[float], y: Sequence[Any], xlabel: str, ylabel: str) -> Any:
        axis = axes.flat[at]
        axis.plot(x, [np.nan if value is None else value for value in y], "o-", color=ACCENT, markersize=4)
        axis.set(title=title, xlabel=xlabel, ylabel=ylabel)
        return axis

    def of(name: str, key: str) -> list[Any]:
        return [row[key] for row in figures[name]]

    axis = line(0, "A hole in the shell", of("holes", "hole"), of("holes", "volume"), "half angle, degrees",
                "volume found / under a flat lid")  # fmt: skip
    axis.axhspan(0.97, 1.03, color=QUIET, alpha=0.2, linewidth=0)
    axis.set_ylim(0.4, 1.2)
    mark_refused(axis, [row["hole"] for row in figures["holes"] if row["volume"] is None], 0.5, "right")
    psnr = "PSNR of untrained cuts, dB"
    line(1, "A wrong up axis (layer cake)", of("tilts", "degrees"), of("tilts", "psnr_db"), "tilt, degrees", psnr)
    line(2, "A core away from the axis", of("offsets", "radii"), of("offsets", "psnr_db"), "offset, radii", psnr)
    atoms = "PSNR of atoms on true labels, dB"
    axis = line(3, "Coarse labels", of("labels", "pixels"), of("labels", "psnr_db"), "pixels of a label", atoms)
    axis = line(4, "Long steps", of("rates", "times"), of("rates", "psnr_db"), "times the learning rate", atoms)
    axis.set_xscale("log")
    axis = axes.flat[5]
    for smoothed, colour in ((True, ACCENT), (False, "#5B6270")):
        rows = [row for row in figures["planes"] if row["smoothed"] == smoothed]
        axis.plot([row["planes"] for row in rows], [row["psnr_all_db"] for row in rows], "o-", color=colour,
                  markersize=4, label="smoothed" if smoothed else "not smoothed")  # fmt: skip
    axis.set(title="Few planes", xlabel="planes with true labels", ylabel="PSNR of all atoms, dB", xscale="log")
    axis.set_xticks(PLANES, [str(count) for count in PLANES])
    axis.minorticks_off()
    axis.legend(frameon=False, fontsize=8)
    axis = line(6, "Small pictures (orange)", of("pictures", "pixels"), of("pictures", "psnr_db"),
                f"pixels of a picture; cells beside it, of {FINE}", psnr)  # fmt: skip
    axis.margins(0.12)
    taken = [row for row in figures["pictures"] if row["psnr_db"] is not None]
    refused = [row["pixels"] for row in figures["pictures"] if row["psnr_db"] is None]
    mark_refused(axis, refused, max((row["psnr_db"] for row in taken), default=0.0), "left")
    for row in taken:
        axis.annotate(str(row["cells"]), (row["pixels"], row["psnr_db"]), (4, -11), textcoords="offset points",
                      fontsize=8, color=QUIET)  # fmt: skip
    axis = axes.flat[7]
    for row, colour in zip(figures["seeds"], (ACCENT, "#4C9F70", "#5B6270"), strict=True):
        label = f"{row['solid']}: {row['mean_db']:.2f} ± {row['sd_db']:.3f} dB"
        axis.plot(range(len(row["psnr_db"])), row["psnr_db"], "o-", color=colour, markersize=4, label=label)
    axis.set(title="Ten seeds", xlabel="seed", ylabel=psnr)
    axis.legend(frameon=False, fontsize=8, loc="upper right")
    axis.margins(y=0.7)
    save_chart(figure, path)


def mark_refused(axis: Any, places: Sequence[float], height: float, side: str) -> None:
    """Crosses at these places along the axis, with a word at the last one, aligned to this side of it."""
    axis.plot(places, [height] * len(places), "x", color=QUIET)
    if places:
        text, at = "refused in one line", (places[-1], height)
        axis.annotate(text, at, (6, 8), textcoords="offset points", ha=side, color=QUIET)


if __name__ == "__main__":
    main()
