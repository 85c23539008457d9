"""Writes the results of a run: the trained solid, a contact sheet of untrained cuts, and a report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from engine.io.files import write_json
from engine.io.trained import Meta, save_trained
from engine.isolate.record import isolation_record
from engine.render.classic import rasterizer as classic
from engine.render.cpu import opaque
from engine.scene.atoms import Atoms
from engine.scene.image import psnr
from engine.scene.inside import Inside
from training.contact_sheet import save_contact_sheet
from training.events import Reporter, to_json
from training.optimise.trainer import Trainer
from training.request import Geometry, Request
from training.settings import DETAILS
from training.views import BACKGROUND, surface_cameras

__all__ = ["save_results"]

HELD_OUT_VIEWS = 8
"""Number of surface views that training never uses, for the surface figures of the report."""


def save_results(
    request: Request,
    geometry: Geometry,
    start: Atoms,
    trainer: Trainer,
    facts: dict[str, Any],
    history: dict[str, Any],
    out: Path,
    reporter: Reporter,
    inside: Inside | None = None,
) -> Path:
    """Writes the trained solid, the contact sheet and the report; returns the solid's path.

    `start` is the solid before training.
    """
    atoms = trainer.result()
    path = out / request.result_name
    with reporter.stage("save"):
        families = tuple(
            {
                "kind": family.kind,
                "count": family.count,
                "prompt": family.prompt,
                "axis": family.axis,
                "span": family.span,
            }
            for family in request.families
        )
        up = (float(geometry.up[0]), float(geometry.up[1]), float(geometry.up[2]))
        origin = geometry.gaussians.origin
        left_out = tuple(isolation_record(request.isolation))
        meta = Meta(up, families, request.seed, request.prior, request.scene.name, origin, left_out)
        save_trained(path, atoms, meta, None if inside is None else inside.record())
    with reporter.stage("cuts"):
        save_contact_sheet(out / "cuts.png", atoms, geometry.body, geometry.up, inside)
    with reporter.stage("measure"):
        before, after = (surface_psnr(geometry, version) for version in (start, atoms))
    report = {
        **facts,
        "iterations": trainer.iteration,
        "refinement_rounds": len(history["disagreeing"]),
        "ended": history["ended"],
        "surface_psnr_db": after,
        "surface_psnr_before_training_db": before,
        "losses": {"section": history["section"], "surface": history["surface"]},
        "seconds": {name: round(spent, 2) for name, spent in reporter.timings.items()},
    }
    write_json(out / "report.json", to_json(report))
    reporter.emit("done", scene=path, sheet=out / "cuts.png", report=out / "report.json")
    return path


def surface_psnr(geometry: Geometry, atoms: Atoms) -> float:
    """Mean PSNR in dB of the opaque object against the capture without haze (merged if it is very large), on held-out
    views.

    Measured on entire pictures over white: sharper edges count as errors.
    """
    size = DETAILS["standard"].surface
    figures = []
    for camera in surface_cameras(geometry.gaussians, geometry.up, HELD_OUT_VIEWS, size, turn=61.0):
        target = np.clip(classic.render(geometry.gaussians, camera, BACKGROUND).rgb, 0, 1)
        figures.append(psnr(np.clip(opaque.render(atoms, camera, background=BACKGROUND).rgb, 0, 1), target))
    return float(np.mean(figures))
