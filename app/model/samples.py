"""The sample scenes that the window can open, so that a first start is not empty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import app
from app.model.document import Document
from app.model.settings import state_folder
from engine.io.splats.ply import write_ply
from engine.scene.gaussians import Gaussians
from engine.scene.rotations import facing
from engine.scene.sh import rgb_to_sh
from training.families import Family, Kind

__all__ = ["sample_document"]


def sample_document(name: str = "watermelon") -> Document:
    """A document for a sample scene with its pictures. If the samples are not installed, a small melon is generated."""
    scene = Path(app.__file__).parents[1] / "sample_scenes" / name / f"{name}.ply"
    if not scene.is_file():
        return Document(scene=_small_melon())
    document = Document(scene=scene)
    planes: dict[Kind, int] = {"horizontal": 40, "radial": 30, "parallel": 60}
    for kind, count in planes.items():
        picture = scene.with_name(f"{kind}_1.png")
        if picture.is_file():
            document = document.with_family(Family(kind, count, (picture,)))
    out = scene.parent / f"{name}-inside"
    home = out if (out / f"{name}.ply").is_file() else state_folder() / "results" / f"{name}-inside"
    return replace(document, training=replace(document.training, out=home))


def _small_melon() -> Path:
    """A hollow striped ellipsoid of flat Gaussians, generated once and saved in the app's state folder."""
    path = state_folder() / "melon.ply"
    if path.is_file():
        return path
    count = 16_000
    index = np.arange(count) + 0.5
    z, turn = 1 - 2 * index / count, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    unit = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], 1)
    means = unit * (0.85, 0.85, 1.0)
    wave = np.arctan2(unit[:, 1], unit[:, 0]) * 9 + 0.8 * np.sin(7 * z) + 0.5 * np.sin(3 * turn)
    dark = (0.5 + 0.5 * np.tanh(2.5 * np.sin(wave)))[:, None]
    rgb = (1 - dark) * (0.55, 0.68, 0.34) + dark * (0.13, 0.33, 0.16)
    normals = unit / (0.85, 0.85, 1.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    size = 1.1 * (4 * np.pi * 0.8 / count) ** 0.5
    scales = np.tile(np.array([size, size, size / 6], np.float32), (count, 1))
    gaussians = Gaussians(
        means.astype(np.float32),
        scales,
        facing(normals).astype(np.float32),
        np.full(count, 0.98, np.float32),
        rgb_to_sh(rgb).astype(np.float32)[:, None],
    )
    write_ply(path, gaussians, ["FruitNinja"])
    return path
