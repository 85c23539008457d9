"""Insides grown from photographs of two different fruits, beside other photographs of the kind.

    python -m benchmarks.photographs.insides [--detail standard] [--seeds 0,1,2] [--pairs apple_1,...] [--quick]
        [-o docs/charts]

There is no truth, so this measures how far held-out cuts are from photographs that were not used, in units of the
distance from photograph to photograph:

  own         SSIM of the cut in a picture's own plane with the picture, both brought to a disc (1: reproduced)
  features    of a trained network, cosine distance
  patches     sliced Wasserstein distance of 7 x 7 patches
  rings       contrast across the radius over that around it, in horizontal cuts, over the same of the photographs
  steps       the strongest level line of radial cuts over that of the photographs: a seam
  recognised  the network's probability of the right class, and for photographs

Needs ../shared/data. Writes photographs.json, a row for each seed, and sheets of cuts into out/photographs, where
trained objects are kept: started again after an interruption it goes on; delete them to measure anew.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import fruitninja
from benchmarks.photographs.listed import PHOTOGRAPHS, listed
from benchmarks.support.options import ROOT, out_folder, parser_of
from engine.io.files import read_file, write_json
from engine.io.picture_file import read_pixels, save_png
from training.evaluate.features import CLASSES, Network
from training.evaluate.metrics import face_ssim, patch_distance

SHARED = ROOT.parent / "shared/data"

BODIES = {
    "apple": SHARED / "splats/meshgs_apple_30k.ply",
    "orange": SHARED / "splats/meshgs_orange_30k.ply",
    "watermelon": ROOT / "sample_scenes/watermelon/watermelon.ply",
    "pomegranate": SHARED / "splats/meshgs_apple_30k.ply",
}
"""The body cut for each kind: no pomegranate was scanned, and an apple is as round."""

PAIRS = {
    "apple_1": ("apple_h1", "apple_v1"),
    "apple_2": ("apple_h2", "apple_v2"),
    "orange_1": ("orange_h1", "orange_v6"),
    "orange_6": ("orange_h6", "orange_v4"),
    "watermelon_10": ("watermelon_h10", "watermelon_v11"),
    "watermelon_8": ("watermelon_h8", "watermelon_v1"),
    "pomegranate_3": ("pomegranate_h3", "pomegranate_v1"),
    "pomegranate_1": ("pomegranate_h1", "pomegranate_v4"),
}

SIDE = 224
"""Side of all faces in pixels: what the network sees."""

MARGIN = 0.04
"""White margin around a face, as a fraction of its size."""

HEIGHTS, TURNS = np.delete(np.linspace(-0.35, 0.35, 11), 5), np.linspace(0.13, 3.0, 10)
"""Heights of horizontal cuts in the largest half width, without the picture's plane; radial angles in radians."""

OBLIQUE = 12
"""Random cuts on the sheet."""

CORE, RIM = 0.1, 0.85
"""Fractions of the radius between which rings are looked for: without the core, and without the rind, itself a ring."""

Rgb: TypeAlias = NDArray[np.float32]
Mask: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True)
class Face:
    """A cut face that fills the picture's width or height, white around it."""

    rgb: Rgb
    """(SIDE, SIDE, 3)."""
    mask: Mask
    """(SIDE, SIDE)."""


def framed(rgb: Rgb, mask: Mask) -> Face:
    """Crops a face (H, W, 3) to its mask (H, W) and resamples it."""
    rows, columns = np.nonzero(mask)
    middle = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2
    half = max(np.ptp(rows), np.ptp(columns)) / 2 * (1 + MARGIN)
    smooth = ndimage.gaussian_filter(np.where(mask[..., None], rgb, 1), (*[max(half / SIDE - 0.5, 0) * 0.8] * 2, 0))
    at = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    x, y = (a.astype(np.float32) for a in np.meshgrid(middle[0] + half * at, middle[1] + half * at))
    white = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": (1.0, 1.0, 1.0)}
    shown = cv2.remap(smooth.astype(np.float32), x, y, cv2.INTER_LINEAR, **white)  # type: ignore[call-overload]
    inside = cv2.remap(mask.astype(np.float32), x, y, cv2.INTER_LINEAR) > 0.5
    return Face(shown, inside)


def photograph(name: str) -> Face:
    """A photograph, framed by its hand-marked mask."""
    pixels, mask = read_pixels(PHOTOGRAPHS / f"{name}.png"), read_pixels(PHOTOGRAPHS / f"masks/{name}.png")
    return framed((pixels / 255).astype(np.float32), mask[..., 0] > 127)


def cut(solid: fruitninja.Solid, normal: NDArray[np.float64], share: float) -> Face:
    """The face of a solid in a plane at distance `share` of its largest half width from its middle."""
    low, high = solid.bounds
    normal = normal / np.linalg.norm(normal)
    offset = -normal @ (low + high) / 2 - share * (high - low).max() / 2
    rgba = solid.section((*normal, offset), size=2 * SIDE)
    return framed((rgba[..., :3] / 255).astype(np.float32), rgba[..., 3] > 127)


def on_circles(face: Face, count: int) -> Rgb:
    """(count, 360, 3). Colours from the middle to the edge in every direction, by fractions of the radius there."""
    rows, columns = np.nonzero(face.mask)
    middle = np.array([columns.mean(), rows.mean()])
    turns = np.radians(np.arange(360))
    rays = np.stack([np.cos(turns), -np.sin(turns)], -1)
    steps = np.arange(0, SIDE, 0.5)
    places = np.round(middle + rays[:, None] * steps[:, None]).astype(int)
    x, y = np.moveaxis(np.clip(places, 0, SIDE - 1), -1, 0)
    reach = (face.mask[y, x] * steps).max(1)
    reach = ndimage.median_filter(reach, 7, mode="wrap")
    shares = (np.arange(count) + 0.5) / count
    x, y = np.moveaxis(middle + (shares[:, None] * reach)[..., None] * rays, -1, 0).astype(np.float32)
    return np.asarray(cv2.remap(face.rgb, x, y, cv2.INTER_LINEAR))


def on_disc(circles: Rgb, turn: int = 0) -> Rgb:
    """(160, 160, 3). The disc made of circles (N, 360, 3), turned by whole degrees."""
    at = (np.arange(160) + 0.5) / 80 - 1
    x, y = np.meshgrid(at, -at)
    rows = np.hypot(x, y) * len(circles) - 0.5
    columns = (np.degrees(np.arctan2(y, x)) - turn) % 360
    wrapped = np.concatenate([circles, circles[:, :1]], 1)
    return np.asarray(cv2.remap(wrapped, columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR))


def likeness(cuts: list[Face], own: Face, turns: range) -> float:
    """Best SSIM of the cuts with a picture, over turns and mirroring: the picture's orientation is unknown."""
    at = (np.arange(160) + 0.5) / 80 - 1
    inside = np.hypot(*np.meshgrid(at, at)) < 0.97
    truth = on_disc(on_circles(own, 80))
    best = 0.0
    for face in cuts:
        circles = on_circles(face, 80)
        for shown in (circles, np.roll(circles[:, ::-1], 1 if len(turns) > 1 else 181, 1)):
            best = max(best, *(face_ssim(on_disc(shown, turn), truth, inside) for turn in turns))
    return best


def rings(face: Face) -> float:
    """Contrast between the means of circles over that along the circles."""
    circles = on_circles(face, 80)[int(80 * CORE) : int(80 * RIM)]
    across, along = np.diff(circles.mean(1), axis=0), np.diff(circles, axis=1)
    return float(np.square(across).mean() / np.square(along).mean())


def steps(face: Face) -> float:
    """The strongest mean change from one row of pixels to the next, over the RMS change of a pixel."""
    core = ndimage.binary_erosion(face.mask, iterations=10)
    change, both = np.diff(face.rgb.mean(-1), axis=0), core[1:] & core[:-1]
    count = both.sum(1)
    rows = np.where(count > 40, (change * both).sum(1) / np.maximum(count, 1), 0)
    return float(np.abs(rows).max() / np.sqrt(np.square(change[both]).mean()))


def patches(a: Face, b: Face) -> float:
    """Distance of the patches of two faces, as a length."""
    return float(np.sqrt(patch_distance(a.rgb, a.mask, b.rgb, b.mask)))


def compared(cuts: list[Face], photographs: dict[str, Face], own: str, network: Network, kind: str) -> dict[str, float]:
    """Cuts of a family compared with its photographs, of which `own` was used for training."""
    unseen = [face for name, face in photographs.items() if name != own]
    known = unseen if len(unseen) > 1 else list(photographs.values())
    pairs = [(i, j) for i in range(len(known)) for j in range(i)]
    features = [network.features([face.rgb for face in faces]) for faces in (cuts, unseen, known)]
    ours, theirs, base = (f / np.linalg.norm(f, axis=1, keepdims=True) for f in features)
    usual = np.mean([1 - base[i] @ base[j] for i, j in pairs])
    usual_patches = np.mean([patches(known[i], known[j]) for i, j in pairs])
    facts = {
        "features": float((1 - ours @ theirs.T).mean() / usual),
        "patches": float(np.mean([patches(a, b) for a in cuts for b in unseen]) / usual_patches),
    }
    if kind in CLASSES:
        facts["recognised"] = float(network.probabilities(features[0], kind).mean())
        facts["recognised_photographs"] = float(network.probabilities(features[1], kind).mean())
    return facts


def measured(solid: fruitninja.Solid, pair: str, network: Network) -> tuple[dict[str, float], NDArray[np.uint8]]:
    """The figures of an object grown from a pair, and a sheet of its cuts."""
    kind = pair.split("_")[0]
    up = np.array([0.0, 0.0, 1.0])
    around = [np.array([np.cos(turn), np.sin(turn), 0]) for turn in TURNS]
    cuts = {
        "horizontal": [cut(solid, up, height) for height in HEIGHTS],
        "radial": [cut(solid, normal, 0) for normal in around],
    }
    names: dict[str, list[str]] = {family: [] for family in cuts}
    for row in listed(PHOTOGRAPHS):
        if row["kind"] == kind and row["usable_as_exemplar"].startswith("yes") and not row["duplicate_of"]:
            names[row["family"]].append(Path(row["path"]).stem)
    facts: dict[str, float] = {}
    for family, own in zip(cuts, PAIRS[pair], strict=True):
        photographs = {name: photograph(name) for name in {*names[family], own}}
        for key, value in compared(cuts[family], dict(sorted(photographs.items())), own, network, kind).items():
            facts[f"{key}_{family}"] = value
        measure, key = (rings, "rings") if family == "horizontal" else (steps, "steps")
        usual = np.median([measure(face) for name, face in photographs.items() if name != own])
        facts[key] = float(np.median([measure(face) for face in cuts[family]]) / usual)
    turned = [cut(solid, np.array([np.cos(turn), np.sin(turn), 0]), 0) for turn in np.arange(24) / 24 * np.pi]
    facts["own_horizontal"] = likeness([cut(solid, up, 0)], photograph(PAIRS[pair][0]), range(0, 360, 4))
    facts["own_radial"] = likeness(turned, photograph(PAIRS[pair][1]), range(1))
    rng = np.random.default_rng(3)
    oblique = [cut(solid, rng.standard_normal(3), rng.uniform(-0.3, 0.3)) for _ in range(OBLIQUE)]
    shown = [*cuts["horizontal"][::3], *cuts["radial"][:2], *oblique]
    sheet = [np.concatenate([face.rgb for face in shown[i : i + 6]], 1) for i in range(0, 18, 6)]
    return facts, np.round(255 * np.concatenate(sheet)).astype(np.uint8)


def main(arguments: list[str] | None = None) -> None:
    """Trains and measures the pairs asked for."""
    parser = parser_of(__doc__, "one pair in draft")
    parser.add_argument("--detail", default="standard", help="default: standard")
    parser.add_argument("--seeds", default="0,1,2", help="default: 0,1,2")
    parser.add_argument("--pairs", default=",".join(PAIRS), help="default: all")
    options = parser.parse_args(arguments)
    if not PHOTOGRAPHS.is_dir():
        parser.error(f"{PHOTOGRAPHS}: no such folder")
    pairs, detail = (["orange_6"], "draft") if options.quick else (options.pairs.split(","), options.detail)
    seeds = [0] if options.quick else [int(seed) for seed in options.seeds.split(",")]
    if not set(pairs) <= set(PAIRS):
        parser.error(f"--pairs: give some of {', '.join(PAIRS)}")
    network, kept = Network(), ROOT / "out/photographs"
    found: dict[str, list[dict[str, float]]] = {pair: [] for pair in pairs}
    for seed, pair in product(seeds, pairs):
        folder = kept / f"{pair}_{detail}_{seed}"
        body = BODIES[pair.split("_")[0]]
        trained = folder / body.name
        if not trained.is_file():
            horizontal, radial = (PHOTOGRAPHS / f"{name}.png" for name in PAIRS[pair])
            grow = partial(fruitninja.grow, body, horizontal=horizontal, radial=radial, up="z")
            grow(detail=detail, seed=seed, out=folder)
        stages = json.loads(read_file(folder / "report.json", 1 << 20))["seconds"]
        facts, sheet = measured(fruitninja.open(trained), pair, network)
        save_png(folder / "sheet.png", sheet)
        row = {key: round(value, 3) for key, value in facts.items()}
        found[pair].append(row | {"seed": seed, "seconds": round(sum(stages.values()), 1)})
        print(pair, seed, " ".join(f"{key} {value}" for key, value in row.items()), flush=True)
    out = out_folder(options)
    if out is not None:
        write_json(out / "photographs.json", {"detail": detail, "pairs": found})


if __name__ == "__main__":
    main()
