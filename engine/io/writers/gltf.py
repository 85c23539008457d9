"""glTF 2.0 with `KHR_gaussian_splatting`, in one .glb. `engine.io.splats.gltf` reads it."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.io.files import atomic
from engine.io.gltf_tree import BINARY_CHUNK, GAUSSIANS, JSON_CHUNK, MAGIC
from engine.io.writers.provenance import Provenance
from engine.scene.gaussians import Gaussians
from engine.scene.moved import moved, upright
from engine.scene.sh import sh_to_rgb

__all__ = ["write_glb"]

TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
COMPONENTS = {"float32": 5126, "uint8": 5121}

VERTICES = 34962
"""Target of a buffer view: vertex attributes."""


def write_glb(path: Path, gaussians: Gaussians, about: Provenance) -> None:
    """Writes Gaussians as points of one mesh, upright: glTF's y is up. Raises InputError if writing fails.

    All values are floats, as in the ratified extension: sizes are standard deviations, opacities range from 0 to 1,
    colours are display-referred sRGB. Programs without the extension show points of the same colours.
    """
    attributes = _attributes(moved(gaussians, upright(about.up)))
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    size = 0
    for name, values in attributes.items():
        views.append({"buffer": 0, "byteOffset": size, "byteLength": values.nbytes, "target": VERTICES})
        accessor = {
            "bufferView": len(accessors),
            "componentType": COMPONENTS[values.dtype.name],
            "count": len(values),
            "type": TYPES[values.shape[1]],
        }
        if values.dtype == np.uint8:
            accessor["normalized"] = True
        if name == "POSITION":
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        accessors.append(accessor)
        size += values.nbytes  # all are multiples of four
    look = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    look |= {"sortingMethod": "cameraDistance", "projection": "perspective"}
    primitive = {
        "attributes": {name: k for k, name in enumerate(attributes)},
        "mode": 0,
        "extensions": {GAUSSIANS: look},
    }
    tree = {
        "asset": {"version": "2.0", "generator": "FruitNinja", "extras": {"comments": list(about.lines)}},
        "extensionsUsed": [GAUSSIANS],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": size}],
    }
    text = json.dumps(tree, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    head = MAGIC + struct.pack("<4I", 2, 12 + 8 + len(text) + 8 + size, len(text), JSON_CHUNK) + text
    parts = [head + struct.pack("<2I", size, BINARY_CHUNK), *(values.tobytes() for values in attributes.values())]
    with atomic(path) as temporary:
        temporary.write_bytes(b"".join(parts))


def _attributes(g: Gaussians) -> dict[str, NDArray[Any]]:
    """(N, k) each. The attributes of the extension, and the colour that other programs show."""
    rgba = np.concatenate([sh_to_rgb(g.sh[:, 0]), g.opacities[:, None]], axis=1)
    attributes: dict[str, NDArray[Any]] = {
        "POSITION": g.means,
        "COLOR_0": np.rint(255 * np.clip(rgba, 0, 1)).astype(np.uint8),
        f"{GAUSSIANS}:ROTATION": g.quats[:, [1, 2, 3, 0]],
        f"{GAUSSIANS}:SCALE": g.scales,
        f"{GAUSSIANS}:OPACITY": g.opacities[:, None],
    }
    for degree in range(g.sh_degree + 1):
        for k in range(2 * degree + 1):
            attributes[f"{GAUSSIANS}:SH_DEGREE_{degree}_COEF_{k}"] = g.sh[:, degree**2 + k]
    return attributes
