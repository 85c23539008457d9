"""Rows of the README's tables, from docs/charts: `python -m tools.figures` prints them, and a test looks for them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["rows"]

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
    """A table row of these cells."""
    return f"| {' | '.join(cells)} |"


def of_photographs() -> list[str]:
    """Rows on pairs of real photographs, means over the seeds."""
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


def of_captures() -> list[str]:
    """The row that compares solids with their captures."""
    found = chart("fidelity")["captures"]
    cells = [found[name]["standard"] for name in CAPTURES]
    return [
        row(
            *(
                " / ".join((f"{c['union_db']:.1f}", f"{c['silhouette_iou']:.3f}".lstrip("0"), f"{c['seconds']:.0f} s"))
                for c in cells
            )
        )
    ]


def of_others() -> list[str]:
    """Rows on pictures of other individuals."""
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
    """Rows on the three samples, by three methods."""
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
    """Rows on the methods, means over all scenes whose pictures show the object itself, in draft."""
    results = chart("evaluation_scenes")["results"]
    lines = []
    for name, method in METHODS.items():
        found = [results[f"{scene}/{method}"] for scene in KNOWN]
        psnr, sharp, fid, differ = (
            np.mean([f[key] for f in found]) for key in ("psnr_db", "sharpness", "fid_random", "disagreement")
        )
        lines.append(row(name, f"{psnr:.1f}", f"{sharp:.2f}", f"{fid:.0f}", f"{differ:.3f}"))
    return lines


def of_faces() -> list[str]:
    """Rows that compare faces read from the inside with faces of atoms."""
    scenes = chart("face_detail")["scenes"]
    found = [scenes[f"{name}_others"] for name in ("watermelon", "orange", "apple")]
    times = {"at the size of the picture": "1.0", "three times as large": "3.0", "eight times as large": "8.0"}
    lines = [
        row(name, *("{:.2f} / {:.2f}".format(*f["sharpness_over_the_picture"][size]) for f in found))
        for name, size in times.items()
    ]
    ssim = [f["ssim_at_768"] for f in found]
    return [*lines, row("SSIM at 768 pixels", *(f"{s['atoms']:.2f} / {s['inside']:.2f}" for s in ssim))]


TABLES: tuple[Callable[[], list[str]], ...] = (
    of_photographs,
    of_captures,
    of_others,
    of_faces,
    of_samples,
    of_methods,
)


def rows() -> list[str]:
    """All rows of all tables."""
    return [line for table in TABLES for line in table()]


if __name__ == "__main__":
    print("\n".join(rows()))
