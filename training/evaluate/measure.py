"""One cell of the grid: a method on a scene, measured."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file
from scipy import ndimage

from engine.io.files import atomic
from engine.io.picture_file import save_png
from engine.io.trained import sidecar_path
from engine.processes import peak_memory
from engine.threads import cores
from training.evaluate.cuts import Cut, Truth, intersection_points, load_truth, make_cuts
from training.evaluate.features import CLASSES, Clip, Features, load_network
from training.evaluate.methods.all_methods import METHODS
from training.evaluate.methods.method import MethodResult
from training.evaluate.metrics import (
    face_psnr,
    face_ssim,
    frechet_distance,
    kernel_distance,
    mean_cosine,
    patch_distance,
    sharpness,
)
from training.evaluate.scenes import OTHERS, EvaluationScene, load_scene
from training.settings import DETAILS, DetailName

__all__ = ["STRIP_CUTS", "fingerprint", "measure"]

Float = NDArray[np.float32]

STRIP_CUTS = 6
"""Number of cuts in the report's strips."""

FORMAT = 2
"""Version of results, raised with every change of what a figure means."""


def fingerprint(scene: str, method: str, seed: int, detail: DetailName, cuts: int, clip: Path | None) -> str:
    """Equal for equal figures; a result with another fingerprint is computed again."""
    settings = [FORMAT, scene, method, seed, asdict(DETAILS[detail]), cuts, str(clip) if clip else None]
    return hashlib.sha256(json.dumps(settings).encode()).hexdigest()[:16]


def measure(
    scene: str, method: str, seed: int, detail: DetailName, cuts: int, clip: Path | None, out: Path
) -> dict[str, Any]:
    """Figures of a method on a scene as JSON facts; also writes out/results/<scene>/<method>-<seed>.png.

    The peak memory is the process's, so each call needs a process of its own. Raises InputError for bad input.
    """
    scene_data = load_scene(scene, out / "scenes")
    chosen = make_cuts(scene_data.solid, scene_data.families, cuts)
    start, busy = time.perf_counter(), time.process_time()
    result = METHODS[method].run(
        scene_data, scene_data.request(DETAILS[detail], seed), out / "runs" / scene / f"{method}-{seed}"
    )
    seconds, busy = time.perf_counter() - start, (time.process_time() - busy) / cores()
    facts = result.facts | {
        "seconds": round(seconds, 2),
        "busy_seconds": round(busy, 2),
        "peak_mb": round(peak_memory() / 2**20),
        "surface_atoms": len(result.atoms.surface),
        "interior_atoms": len(result.atoms.interior),
        "file_mb": round(sum(p.stat().st_size for p in (result.path, sidecar_path(result.path))) / 1e6, 2),
    }
    truth = load_truth(scene_data.solid, chosen, out / "truth" / f"{scene}.safetensors")
    start = time.perf_counter()
    pictures = render_cuts(result, chosen, truth)
    facts["seconds_per_cut"] = round((time.perf_counter() - start) / len(chosen), 3)
    facts |= accuracy(
        pictures, chosen, truth, other_solid_distance(scene_data, chosen, truth, out / "truth" / f"{scene}_another")
    )
    facts |= consistency(pictures, chosen, scene_data, truth)
    facts |= distances(pictures, chosen, truth, out / "truth" / f"{scene}_features.safetensors", clip, scene)
    save_strip(out / "results" / scene / f"{method}-{seed}.png", pictures[:STRIP_CUTS])
    save_strip(out / "results" / scene / "truth.png", truth.pictures[:STRIP_CUTS])
    return facts


def render_cuts(result: MethodResult, cuts: Sequence[Cut], truth: Truth) -> Float:
    """(C, H, W, 3). The faces as the method shows them, white outside of them."""
    pictures = [result.show(number, cut) for number, cut in enumerate(cuts)]
    return np.where(truth.inside[..., None], np.stack(pictures), np.float32(1))


def other_solid_distance(scene_data: EvaluationScene, cuts: Sequence[Cut], truth: Truth, path: Path) -> float | None:
    """Patch distance between the cuts of two true solids of the kind, mean over random cuts; None without another."""
    if scene_data.another is None:
        return None
    other = load_truth(scene_data.another, [cut for cut in cuts if not cut.canonical], path.with_suffix(".safetensors"))
    both = zip(other.pictures, other.inside, truth.pictures, truth.inside, strict=False)
    return float(np.mean([patch_distance(a, i, b, j) for a, i, b, j in both]))


def accuracy(pictures: Float, cuts: Sequence[Cut], truth: Truth, another: float | None) -> dict[str, Any]:
    """Mean figures over the random cuts that compare a face with the true one."""
    random = [number for number, cut in enumerate(cuts) if not cut.canonical]
    rows = []
    for number in random:
        result, true, inside = pictures[number], truth.pictures[number], truth.inside[number]
        rows.append(
            (
                face_psnr(result, true, inside),
                face_ssim(result, true, inside),
                patch_distance(result, inside, true, inside),
                sharpness(result, inside) / max(sharpness(true, inside), 1e-9),
            )
        )
    psnr, ssim, patch, sharp = np.mean(rows, axis=0)
    return {
        "psnr_db": round(float(psnr), 3),
        "ssim": round(float(ssim), 4),
        "patch": round(float(patch), 4),
        "patch_ratio": None if another is None else round(float(patch) / another, 2),
        "sharpness": round(float(sharp), 3),
    }


def consistency(pictures: Float, cuts: Sequence[Cut], scene_data: EvaluationScene, truth: Truth) -> dict[str, Any]:
    """RMS colour difference of the same points in two cuts; that of the truth is the error of sampling pixels."""
    result = {}
    for name, of in (("disagreement", pictures), ("disagreement_truth", truth.pictures)):
        squares = [
            (
                sample_bilinear(of[a], cuts[a].pixel_position(points))
                - sample_bilinear(of[b], cuts[b].pixel_position(points))
            )
            ** 2
            for a, b, points in intersection_points(scene_data.solid, list(cuts))
        ]
        result[name] = round(float(np.sqrt(np.concatenate(squares).mean())), 4) if squares else None
    return result


def sample_bilinear(picture: Float, places: NDArray[np.float64]) -> Float:
    """(M, 3). Bilinear colours at columns and rows (M, 2)."""
    at = places.T[::-1]
    return np.stack([ndimage.map_coordinates(picture[..., c], at, order=1, mode="nearest") for c in range(3)], -1)


def distances(
    pictures: Float, cuts: Sequence[Cut], truth: Truth, kept: Path, clip: Path | None, scene: str
) -> dict[str, Any]:
    """Figures from features: of canonical cuts as in the paper's table 1, of random ones as in its table 2."""
    facts: dict[str, Any] = {}
    sets = {
        "canonical": [number for number, cut in enumerate(cuts) if cut.canonical],
        "random": [number for number, cut in enumerate(cuts) if not cut.canonical],
    }
    network_model = load_network()
    if network_model is not None:
        true = truth_features(truth, network_model.features, kept)
        features = network_model.features(list(pictures))
        for name, numbers in sets.items():
            a, b = features[numbers], true[numbers]
            facts[f"fid_{name}"] = round(frechet_distance(a, b), 3)
            facts[f"kid_{name}"] = round(kernel_distance(a, b), 5)
            facts[f"cosine_{name}"] = round(mean_cosine(a), 4)
            facts[f"cosine_{name}_truth"] = round(mean_cosine(b), 4)
        kind = scene.removesuffix(OTHERS)
        if kind in CLASSES:
            for name, of in (("recognised", features), ("recognised_truth", true)):
                facts[name] = round(float(network_model.probabilities(of[sets["random"]], kind).mean()), 3)
    if clip is not None:
        clip_model = Clip(clip)
        unit = clip_model.features(list(pictures))
        thing = "red velvet cake" if scene == "cake" else scene.removesuffix(OTHERS)
        facts["clip_random"] = round(clip_model.score(unit[sets["random"]], f"the cross-section of a {thing}"), 2)
        facts["clip_cosine_random"] = round(mean_cosine(unit[sets["random"]]), 4)
        kinds = sorted({cuts[number].canonical for number in sets["canonical"]})
        scores = [
            clip_model.score(
                unit[[n for n in sets["canonical"] if cuts[n].canonical == kind]], clip_prompt(kind, thing)
            )
            for kind in kinds
        ]
        facts["clip_canonical"] = round(float(np.mean(scores)), 2)
    return facts


def clip_prompt(kind: str, thing: str) -> str:
    """The paper's prompt for a canonical cut."""
    return f"the {'horizontal' if kind == 'horizontal' else 'vertical'} cross-section of a {thing}"


def truth_features(truth: Truth, of: Callable[[Sequence[Float]], Features], path: Path) -> Features:
    """Features of the true pictures, cached in a file for the other methods; the file says of which pictures."""
    digest = np.frombuffer(hashlib.blake2b(truth.pictures.tobytes()).digest(), np.uint8)
    if path.is_file() and np.array_equal((kept := load_file(path)).get("pictures", []), digest):
        return kept["features"]
    features = of(list(truth.pictures))
    with atomic(path) as temporary:
        save_file({"features": features, "pictures": digest}, temporary)
    return features


def save_strip(path: Path, pictures: Float) -> None:
    """Pictures (N, H, W, 3) side by side."""
    save_png(path, np.concatenate(list(pictures), axis=1), optimize=True)
