"""Rows of the tables in docs/MEASURED.md, from docs/charts: `python -m tools.figures` prints them, held by a test."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["ON_THE_FRONT_PAGE", "rows"]

ROOT = Path(__file__).resolve().parents[1]

CAPTURES = ("donut_mipsplatting.ply", "plant.splat", "guitar.compressed.ply", "tarot_box_capture.ply")

METHODS = {
    "ours": "ours",
    "nearest surface colour (PhysGaussian)": "physgaussian",
    "each cut drawn by itself (2D inpainting)": "inpainting",
    "without atomic clipping": "no_clipping",
    "without opacification": "no_opacity",
    "without smoothing, or without refinement": "no_refinement",
    "uniform fill, three times the atoms": "uniform",
    "ours given the true slices as labels": "oracle",
}

KNOWN = ("watermelon", "orange", "bread", "apple", "pomegranate", "cake", "thigh")
"""Scenes whose pictures show the object itself."""


def chart(name: str) -> Any:
    """The numbers of a chart."""
    return json.loads((ROOT / f"docs/charts/{name}.json").read_text(encoding="utf-8"))


def row(*cells: str) -> str:
    """Of a table."""
    return f"| {' | '.join(cells)} |"


def of_photographs() -> list[str]:
    """Pairs of real photographs, means over the seeds."""
    lines = []
    for pair, seeds in chart("photographs")["pairs"].items():
        f = {key: float(np.mean([one[key] for one in seeds])) for key in seeds[0]}
        both = [
            f"{f[f'{key}_horizontal']:.{digits}f} / {f[f'{key}_radial']:.{digits}f}"
            for key, digits in (("own", 2), ("features", 1), ("patches", 1))
        ]
        known = "not known"
        if "recognised_horizontal" in f:
            ours, theirs = (
                " / ".join(f"{f[f'{key}_{family}']:.2f}" for family in ("horizontal", "radial"))
                for key in ("recognised", "recognised_photographs")
            )
            known = f"{ours} ({theirs})"
        lines.append(row(pair.replace("_", " "), *both, f"{f['rings']:.1f}", f"{f['steps']:.1f}", known))
    return lines


def of_drawn() -> list[str]:
    """Kinds that are drawn: how far insides and other individuals are from one, and with how much spread."""
    lines = []
    for kind, seeds in chart("drawn_kinds")["kinds"].items():
        ours = [one["ours"] for one in seeds]
        lines.append(row(kind, f"{np.mean(ours):.3f} ± {np.std(ours):.3f}", f"{seeds[0]['another']:.3f}"))
    return lines


def of_captures() -> list[str]:
    """Solids beside captures."""
    found = chart("fidelity")["captures"]
    cells = [found[name]["standard"] for name in CAPTURES]
    return [
        row(
            "dB / IoU / seconds",
            *(
                " / ".join((f"{c['union_db']:.1f}", f"{c['silhouette_iou']:.3f}".lstrip("0"), f"{c['seconds']:.0f} s"))
                for c in cells
            ),
        ),
        row("four times as near: dB / outline", *(f"{c['closer_db']:.1f} / {c['outline']:.2f}" for c in cells)),
    ]


def of_others() -> list[str]:
    """Pictures of other individuals."""
    scenes = chart("oblique_cuts")["scenes"]
    found = [scenes[f"{name}_others"] for name in ("watermelon", "orange", "apple", "pomegranate")]
    ours = [f["ours"] for f in found]
    psnr = [f"{f['ours']['psnr_db']:.1f} ({f['another']['psnr_db']:.1f})" for f in found]
    return [
        row("PSNR dB (another true one)", *psnr),
        row("sharpness (truth 1)", *(f"{f['sharpness']:.2f}" for f in ours)),
        row("patches", *(f"{f['patch_ratio']:.1f}" for f in ours)),
    ]


def of_samples() -> list[str]:
    """The three samples, by three methods."""
    scenes = [chart("oblique_cuts")["scenes"][name] for name in ("watermelon", "orange", "bread")]
    names = ("ours", "nearest surface colour (PhysGaussian)", "ours given the true slices as labels")
    return [
        row(
            name,
            *(f"{f['psnr_db']:.1f} / {f['sharpness']:.2f}" for f in (scene[METHODS[name]] for scene in scenes)),
        )
        for name in names
    ]


def of_methods() -> list[str]:
    """Means of all scenes whose pictures show the object itself, in draft."""
    results = chart("evaluation_scenes")["results"]
    lines = []
    for name, method in METHODS.items():
        found = [results[f"{scene}/{method}"] for scene in KNOWN]
        psnr, sharp, fid, differ = (
            np.mean([f[key] for f in found]) for key in ("psnr_db", "sharpness", "fid_random", "disagreement")
        )
        lines.append(row(name, f"{psnr:.1f}", f"{sharp:.2f}", f"{fid:.0f}", f"{differ:.3f}"))
    return lines


def of_seeds() -> list[str]:
    """Many cuts of solids with pictures of others: means of the seeds and their standard deviation."""
    results = chart("evaluation_seeds")["results"]
    scenes: dict[str, list[dict[str, Any]]] = {}
    for name, facts in results.items():
        scenes.setdefault(name.split("/")[0], []).append(facts)
    lines = []
    for scene, seeds in scenes.items():
        cells = [scene.removesuffix("_others")]
        for key, digits in (
            ("psnr_db", 1),
            ("patch_ratio", 1),
            ("sharpness", 2),
            ("fid_random", 0),
            ("fid_canonical", 0),
        ):
            found = [f[key] for f in seeds]
            cells.append(f"{np.mean(found):.{digits}f} ± {np.std(found):.{digits}f}")
        lines.append(row(*cells))
    return lines


def of_faces() -> list[str]:
    """Faces read from the inside beside faces of atoms."""
    scenes = chart("face_detail")["scenes"]
    found = [scenes[f"{name}_others"] for name in ("watermelon", "orange", "apple")]
    times = {"at the size of the picture": "1.0", "three times as large": "3.0", "eight times as large": "8.0"}
    lines = [
        row(name, *("{:.2f} / {:.2f}".format(*f["sharpness_over_the_picture"][size]) for f in found))
        for name, size in times.items()
    ]
    ssim = [f["ssim_at_768"] for f in found]
    return [*lines, row("SSIM at 768 pixels", *(f"{s['atoms']:.2f} / {s['inside']:.2f}" for s in ssim))]


def of_threads() -> list[str]:
    """Seconds of a draft's longest stages, by the number of threads."""
    drafts = [found["seconds"] for found in chart("threads")["rows"] if found["part"] == "draft"]
    return [
        row(stage, *(f"{seconds[stage]:.0f}" for seconds in drafts)) for stage in ("labels", "refit", "cuts", "whole")
    ]


def of_batches() -> list[str]:
    """Scenes an hour by the number of workers, on two machines, and what the larger one could do."""
    small, large = chart("batch_scaling"), chart("batch_scaling_16")
    found = sorted([*small["rows"], *large["rows"]], key=lambda one: one["workers"])
    return [
        row("scenes an hour", *(f"{one['scenes_per_hour']:.0f}" for one in found)),
        f"Sixteen cores that were always busy would do {large['bound_scenes_per_hour_of_all_cores']:.0f}.",
    ]


TABLES: tuple[Callable[[], list[str]], ...] = (
    of_photographs,
    of_drawn,
    of_captures,
    of_others,
    of_seeds,
    of_faces,
    of_samples,
    of_methods,
    of_threads,
    of_batches,
)

ON_THE_FRONT_PAGE = (of_photographs, of_captures)
"""Tables that the README repeats: real inputs."""


def rows() -> list[str]:
    """All of them."""
    return [line for table in TABLES for line in table()]


if __name__ == "__main__":
    print("\n".join(rows()))
