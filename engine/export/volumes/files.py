"""Writes voxels as NIfTI, NRRD, OME-Zarr, or a stack of pictures for a printer."""

from __future__ import annotations

import gzip
import io
import json
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import nibabel
import nrrd
import numpy as np
import zarr
from numpy.typing import NDArray
from PIL import Image

from engine.errors import InputError
from engine.export.units import INCH, MILLIMETRES
from engine.export.voxels import Voxels, coarsened
from engine.io.files import ZIP_TIME, atomic, atomic_together
from engine.io.scratch import atomic_folder
from engine.scene.inside import KIND_NAMES
from engine.scene.moved import Z_UP, upright

__all__ = ["VOLUMES", "save_volume"]

SMALLEST = 64
"""Voxels along the longest side below which no smaller version is made for OME-Zarr."""

CHUNK = 64
"""Voxels along a side of what OME-Zarr reads at once."""

PACKING = 6
"""Level of gzip: 9 takes three times as long for 1 % less."""

KIND_COLOURS = ((0, 0, 0), (230, 120, 90), (240, 220, 120), (90, 60, 40), (120, 170, 220))
"""Colours of the labels, by `Kind`."""


def _save_nifti(path: Path, voxels: Voxels, affine: NDArray[np.float64]) -> list[Path]:
    labels = _beside(path, ".labels")
    rgb = np.ascontiguousarray(voxels.rgb).view([("R", "u1"), ("G", "u1"), ("B", "u1")])[..., 0]
    packed = path.name.lower().endswith(".gz")
    with atomic_together(path, labels) as (colours, kinds):
        colours.write_bytes(_nifti(rgb, affine, packed))
        kinds.write_bytes(_nifti(voxels.kind, affine, packed))
    return [path, labels]


def _nifti(data: NDArray[Any], affine: NDArray[np.float64], packed: bool) -> bytes:
    """A volume as a file."""
    image = nibabel.Nifti1Image(data, affine)
    image.header.set_xyzt_units("mm")
    if data.dtype == np.uint8:
        image.header["descrip"] = ", ".join(f"{n} {name}" for n, name in enumerate(KIND_NAMES))
    plain = image.to_bytes()
    return gzip.compress(plain, PACKING, mtime=0) if packed else plain


def _save_nrrd(path: Path, voxels: Voxels, affine: NDArray[np.float64]) -> list[Path]:
    labels = _beside(path, ".labels")
    across = affine[:3, :3].T
    of_rgb = {
        "kinds": ["RGB-color", "domain", "domain", "domain"],
        "space directions": np.vstack([np.full(3, np.nan), across]),
    }
    of_kinds = {"kinds": ["domain"] * 3, "space directions": across}
    names = {f"kind {n}": name for n, name in enumerate(KIND_NAMES)}
    with atomic_together(path, labels) as (colours, kinds):
        colours.write_bytes(_nrrd(np.moveaxis(voxels.rgb, -1, 0), of_rgb, affine))
        kinds.write_bytes(_nrrd(voxels.kind, of_kinds | names, affine))
    return [path, labels]


def _nrrd(data: NDArray[np.uint8], header: dict[str, Any], affine: NDArray[np.float64]) -> bytes:
    """A volume as a file; the fastest axis first."""
    space = {"space": "right-anterior-superior", "space origin": affine[:3, 3], "space units": ["mm", "mm", "mm"]}
    out = io.BytesIO()
    nrrd.write(out, np.asfortranarray(data), space | {"encoding": "gzip"} | header, compression_level=PACKING)
    return out.getvalue()


def _save_zarr(path: Path, voxels: Voxels, affine: NDArray[np.float64]) -> list[Path]:
    """OME-Zarr 0.4: axes c, z, y, x of the file, in millimetres; kinds as labels beside the colours."""
    millimetres = float(np.cbrt(np.linalg.det(affine[:3, :3]))) / voxels.grid.cell
    levels = [voxels]
    while max(levels[-1].grid.shape) > SMALLEST:
        levels.append(coarsened(levels[-1]))
    with atomic_folder(path) as temporary:
        root = zarr.create_group(temporary, zarr_format=2)
        kinds = root.create_group("labels").create_group("kinds")
        root["labels"].attrs["labels"] = ["kinds"]
        for n, level in enumerate(levels):
            _array(root, str(n), np.transpose(level.rgb, (3, 2, 1, 0)))
            _array(kinds, str(n), np.transpose(level.kind, (2, 1, 0)))
        colour = [[1.0], [0.0]]
        root.attrs["multiscales"] = [_multiscale(path.name, levels, millimetres, colour)]
        root.attrs["omero"] = {
            "channels": [
                {"label": name, "color": tint, "active": True, "window": {"start": 0, "end": 255, "min": 0, "max": 255}}
                for name, tint in (("red", "FF0000"), ("green", "00FF00"), ("blue", "0000FF"))
            ]
        }
        kinds.attrs["multiscales"] = [_multiscale("kinds", levels, millimetres, [[], []])]
        kinds.attrs["image-label"] = {
            "version": "0.4",
            "colors": [{"label-value": n, "rgba": [*KIND_COLOURS[n], 255 if n else 0]} for n in range(len(KIND_NAMES))],
            "properties": [{"label-value": n, "name": name} for n, name in enumerate(KIND_NAMES)],
        }
    return [path]


def _array(group: Any, name: str, data: NDArray[np.uint8]) -> None:
    chunks = tuple(min(CHUNK if side > 3 else side, side) for side in data.shape)
    array = group.create_array(
        name, shape=data.shape, chunks=chunks, dtype=data.dtype, chunk_key_encoding={"name": "v2", "separator": "/"}
    )
    array[:] = data


def _multiscale(name: str, levels: Sequence[Voxels], millimetres: float, channel: list[list[float]]) -> dict[str, Any]:
    """The metadata of OME-NGFF 0.4; `channel`: scale and shift along the axis of channels, if there is one."""
    scale, shift = channel
    axes = [{"name": "c", "type": "channel"}] if scale else []
    axes += [{"name": axis, "type": "space", "unit": "millimeter"} for axis in "zyx"]
    datasets = []
    for n, level in enumerate(levels):
        cell = level.grid.cell * millimetres
        first = (np.asarray(level.grid.origin)[::-1] * millimetres + cell / 2).tolist()
        transforms = [
            {"type": "scale", "scale": [*scale, cell, cell, cell]},
            {"type": "translation", "translation": [*shift, *first]},
        ]
        datasets.append({"path": str(n), "coordinateTransformations": transforms})
    return {"version": "0.4", "name": name, "axes": axes, "datasets": datasets}


def _save_stack(path: Path, voxels: Voxels, affine: NDArray[np.float64]) -> list[Path]:
    """An archive of pictures with transparency, lowest first, for printers that place coloured drops. Layers lie across
    the file's third axis."""
    side = float(np.cbrt(np.linalg.det(affine[:3, :3]))) / MILLIMETRES
    dpi = INCH / side
    alpha = np.where(voxels.kind > 0, 255, 0).astype(np.uint8)
    note = {"dots_per_inch": dpi, "layer_millimetres": side * MILLIMETRES, "layers": voxels.grid.shape[2]}
    with atomic(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for z in range(voxels.grid.shape[2]):
            rgba = np.concatenate([voxels.rgb[:, :, z], alpha[:, :, z, None]], axis=-1)
            out = io.BytesIO()
            Image.fromarray(np.ascontiguousarray(rgba.transpose(1, 0, 2)[::-1])).save(out, "PNG", dpi=(dpi, dpi))
            archive.writestr(zipfile.ZipInfo(f"layer_{z:05d}.png", ZIP_TIME), out.getvalue())
        archive.writestr(zipfile.ZipInfo("stack.json", ZIP_TIME), json.dumps(note, indent=1) + "\n")
    return [path]


def _beside(path: Path, word: str) -> Path:
    """The path with a word before its suffix; .nii.gz counts as one."""
    name = path.name
    end = next((end for end in (".nii.gz",) if name.lower().endswith(end)), path.suffix)
    return path.with_name(name[: -len(end)] + word + name[-len(end) :])


VOLUMES: dict[str, Callable[[Path, Voxels, NDArray[np.float64]], list[Path]]] = {
    ".nii": _save_nifti,
    ".gz": _save_nifti,
    ".nrrd": _save_nrrd,
    ".zarr": _save_zarr,
    ".zip": _save_stack,
}
"""The writer of each suffix; .gz stands for .nii.gz."""


def save_volume(path: Path, voxels: Voxels, up: Sequence[float], metres: float) -> list[Path]:
    """Writes voxels by the path's suffix, and returns what was written.

    `up` (3,) is the object's up axis, `metres` the length of a world unit. Voxels keep the file's axes; NIfTI and NRRD
    say in their matrix how to turn them so that the third axis of their space is up. Raises InputError for any other
    suffix, if there is an OME-Zarr already, and if writing fails.
    """
    suffix = path.suffix.lower()
    if suffix not in VOLUMES or (suffix == ".gz" and not path.name.lower().endswith(".nii.gz")):
        raise InputError(f"{path}: volumes are written as .nii.gz, .nrrd, .zarr or .zip; give a name that ends so")
    if path.is_dir() and any(path.iterdir()):
        raise InputError(f"{path}: is there already; give another name")
    turn = Z_UP @ upright(up) * metres * MILLIMETRES
    affine = np.eye(4)
    affine[:3, :3] = turn * voxels.grid.cell
    affine[:3, 3] = turn @ (np.asarray(voxels.grid.origin) + voxels.grid.cell / 2)
    return VOLUMES[suffix](path, voxels, affine)
