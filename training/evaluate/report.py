"""Writes report.html, which needs no other file, and report.json with the same figures."""

from __future__ import annotations

import base64
import io
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.io.files import atomic, write_json
from engine.io.picture_file import open_picture
from training.evaluate.cuts import CANONICAL
from training.evaluate.grid import Cell
from training.evaluate.methods.all_methods import METHODS
from training.evaluate.tables import ABLATIONS, COLUMNS, Facts, Table, table

__all__ = ["write_report"]

ACCURACY = (
    "psnr_db", "ssim", "patch", "patch_ratio", "sharpness", "disagreement", "fid_random", "kid_random",
    "recognised", "surface_psnr_db",
)  # fmt: skip
COST = (
    "seconds", "busy_seconds", "seconds_per_cut", "peak_mb", "surface_atoms", "interior_atoms", "file_mb", "iterations",
    "refinement_rounds",
)  # fmt: skip
ABLATED = ("psnr_db", "ssim", "patch", "sharpness", "disagreement", "fid_random", "kid_random", "section_loss")
COMPARED = ("physgaussian", "inpainting", "ours", "oracle")

# Figures that the paper gives (its tables 1 and 2), on photographs and with CLIP and Inception features.
PAPER_1 = (
    ("PhysGaussian", "24.6", "520.1", "816.4"),
    ("2D inpainting, fine-tuned", "32.3", "176.2", "224.5"),
    ("2D inpainting", "25.1", "314.2", "536.3"),
    ("FruitNinja", "33.1", "209.2", "323.7"),
)
PAPER_2 = (("PhysGaussian", "23.9", "0.89"), ("2D inpainting", "27.8", "0.87"), ("FruitNinja", "29.1", "0.96"))

QUALITY = 86
"""Quality of JPEG pictures in the page: a strip of six cuts has 60 to 120 kB."""


def write_report(grid: Sequence[Cell], failed: dict[Cell, str], out: Path) -> Path:
    """Writes both into `out` from the stored results; returns the path of the page. Raises InputError if there are
    none."""
    found = {cell: facts for cell in grid if (facts := cell.load_facts()) is not None}
    if not found:
        reasons = "; ".join(f"{cell.name}: {why}" for cell, why in failed.items())
        raise InputError(f"nothing was measured ({reasons or 'no result is kept'})")
    facts = averaged(found)
    scenes = list(dict.fromkeys(cell.scene for cell in found))
    every = list(facts)
    tables = {
        "Accuracy": table(facts, every, ACCURACY, scenes),
        "Cost": table(facts, every, COST, scenes),
        "Table 1": table(facts, COMPARED, ("clip_canonical", "fid_canonical", "kid_canonical"), scenes),
        "Table 2": table(facts, COMPARED, ("clip_random", "cosine_random"), scenes),
        **{name: table(facts, methods, ABLATED, scenes) for name, methods in ABLATIONS.items()},
    }
    first = next(iter(found))
    settings = {
        "detail": first.detail,
        "random_cuts": first.cuts,
        "canonical_cuts": -(-first.cuts // CANONICAL),
        "seeds": len({cell.seed for cell in found}),
        "cores": os.cpu_count(),
        "machine": platform.machine(),
    }
    record = {
        "settings": settings,
        "results": {cell.name: value for cell, value in found.items()},
        "tables": {name: plain(of) for name, of in tables.items()},
        "failed": {cell.name: why for cell, why in failed.items()},
    }
    write_json(out / "report.json", record)
    page = render(facts, tables, settings, scenes, failed, out)
    with atomic(out / "report.html") as temporary:
        temporary.write_text(page, encoding="utf-8")
    return out / "report.html"


def averaged(found: dict[Cell, dict[str, Any]]) -> Facts:
    """Figures by method and scene, averaged over the seeds."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for cell, facts in found.items():
        groups.setdefault((cell.method, cell.scene), []).append(facts)
    result: Facts = {}
    for method in METHODS:
        for (of, scene), runs in groups.items():
            if of == method:
                numbers = {key for key, value in runs[0].items() if isinstance(value, int | float)}
                result.setdefault(method, {})[scene] = {
                    key: float(np.mean([run[key] for run in runs])) if key in numbers else value
                    for key, value in runs[0].items()
                }
    return result


def plain(of: Table) -> dict[str, Any]:
    """A table as JSON."""
    return {"scenes": of.scenes, "columns": [c.key for c in of.columns], "rows": {r.method: r.values for r in of.rows}}


def render(
    facts: Facts,
    tables: dict[str, Table],
    settings: dict[str, Any],
    scenes: list[str],
    failed: dict[Cell, str],
    out: Path,
) -> str:
    """The page as HTML."""
    try:
        import jinja2

        from training.evaluate.charts import bars, scatter
    except ImportError as error:
        raise InputError(f"the report needs {error.name}; install the packages of 'fruitninja[bench]'") from error
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=jinja2.StrictUndefined
    )
    truth = {scene: next(f[scene] for f in facts.values() if scene in f) for scene in scenes}
    return environment.get_template("report.html").render(
        tables=tables,
        settings=settings,
        scenes=scenes,
        failed={cell.name: why for cell, why in failed.items()},
        methods={method: METHODS[method] for method in facts},
        legend=[column for key, column in COLUMNS.items() if column.what and key in ACCURACY + COST + ABLATED],
        per_scene={scene: table(facts, list(facts), ACCURACY, [scene]) for scene in scenes},
        strips={
            scene: [("Truth", strip(out, scene, "truth"))]
            + [(METHODS[m].title, strip(out, scene, f"{m}-0")) for m in facts if scene in facts[m]]
            for scene in scenes
        },
        truth_cosine={scene: truth[scene].get("cosine_random_truth") for scene in scenes},
        truth_disagreement={scene: truth[scene].get("disagreement_truth") for scene in scenes},
        has_network=any("fid_random" in row for of in facts.values() for row in of.values()),
        has_clip=any("clip_random" in row for of in facts.values() for row in of.values()),
        paper_1=PAPER_1,
        paper_2=PAPER_2,
        ablations=list(ABLATIONS),
        charts=[
            ("Closeness to the truth against sharpness", url(scatter(facts, "sharpness", "psnr_db", scenes), "png")),
            ("Patch distance", url(bars(facts, "patch", scenes), "png")),
            ("Time", url(bars(facts, "seconds", scenes), "png")),
        ],
    )


def strip(out: Path, scene: str, name: str) -> str:
    """A strip of cuts as a data URL, empty if it is not there."""
    path = out / "results" / scene / f"{name}.png"
    if not path.is_file():
        return ""
    target = io.BytesIO()
    with open_picture(path) as image:
        image.convert("RGB").save(target, format="JPEG", quality=QUALITY)
    return url(target.getvalue(), "jpeg")


def url(data: bytes, kind: str) -> str:
    """A data URL that puts a picture into the page itself."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
