"""The page: one file with a solid, what draws it, and nothing that would have to be fetched."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.errors import InputError
from engine.export.colours import Colours
from engine.export.page.skin import Cube, pack_skin
from engine.export.page.volume import Layers, pack_body, pack_inside
from engine.io.files import atomic
from engine.render.culling.drawable import reach_of
from engine.render.culling.groups import MAX_PLANES
from engine.render.defines import CONSTANTS
from engine.scene.camera import equator
from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane
from shaders import text

__all__ = ["PAGES", "PageView", "write_page"]

PAGES = (".html", ".htm")
"""Suffixes of a page."""

SHADERS = (
    "gaps.frag.glsl",
    "limit.frag.glsl",
    "project.vert.glsl",
    "resolve.frag.glsl",
    "screen.vert.glsl",
    "splat.frag.glsl",
    "splat.vert.glsl",
    "upright.frag.glsl",
    "volume_face.frag.glsl",
)

SCRIPTS = ("draw.js", "viewer.js")

BRIGHT = 0.5
"""Brightness of a background from which the page around it is light."""


@dataclass(frozen=True)
class PageView:
    """Where the page looks from at first, in the terms of `engine.scene.camera.orbit`."""

    target: NDArray[np.float64]
    """(3,). World units."""
    radius: float
    """World units around the target that fit the picture at distance 1."""
    azimuth: float
    elevation: float
    distance: float


def write_page(
    path: Path,
    title: str,
    body: Body,
    colours: Colours,
    up: ArrayLike,  # [3]
    planes: Sequence[Plane],
    view: PageView,
    background: tuple[float, float, float] | None,
    progress: Callable[[float], None],
) -> str:
    """Writes a page that shows a solid cut by planes; returns what is in it, in a line.

    The page begins with these planes, one or more, and its reader moves them. `background`: RGB, range [0, 1]; None
    follows the reader's choice of dark or light. `progress` gets the share that is done. Raises InputError if there are
    too many planes, or if the page cannot be written.
    """
    if len(planes) > MAX_PLANES:
        raise InputError(f"{path}: {len(planes)} planes are too many for a page; give at most {MAX_PLANES}")
    atoms = colours.atoms
    cube = Cube.of(atoms.bounds)
    skin, inside = pack_skin(atoms, cube), pack_inside(body, colours, progress)
    low, high = (atoms.bounds.astype(np.float64) - cube.low) / cube.edge
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    first, second = equator(axis)
    record = {
        "edge": cube.edge,
        "pitch": atoms.pitch / cube.edge,
        "reach": reach_of(atoms)[1] / cube.edge,
        "middle": _list((low + high) / 2),
        "half": _list((high - low) / 2),
        "axes": {"up": _list(axis), "first": _list(first), "second": _list(second)},
        "planes": [[*p.normal, float(p.distance(cube.low)) / cube.edge] for p in planes],
        "view": {
            "target": _list((view.target - cube.low) / cube.edge),
            "radius": view.radius / cube.edge,
            "azimuth": view.azimuth,
            "elevation": view.elevation,
            "distance": view.distance,
        },
        "skin": {
            "count": skin.count,
            "degree": skin.degree,
            "vectors": skin.vectors,
            "scales": skin.scales,
            "data": _base64(skin.data),
        },
        "body": {**_placed(body.grid, cube), "shape": body.grid.shape, "data": _base64(pack_body(body, atoms.pitch))},
        "inside": {
            **_placed(inside.grid, cube),
            "luma": _record(inside.luma),
            "blue": _record(inside.blue),
            "red": _record(inside.red),
        },
        "constants": {name: repr(value) for name, value in CONSTANTS.items()},
        "shaders": {name: text(name) for name in SHADERS},
    }
    content = _filled(title, record, len(planes), background).encode()
    with atomic(path) as temporary:
        temporary.write_bytes(content)
    x, y, z = inside.grid.shape
    return f"{len(content) / 1e6:.1f} MB: {skin.count:,} atoms of the skin, the inside in {x} x {y} x {z} cells"


def _filled(title: str, record: dict[str, Any], planes: int, background: tuple[float, float, float] | None) -> str:
    """The page with everything in it."""
    script = "\n".join(['"use strict";', *map(_source, SCRIPTS)])
    style, theme = _source("page.css"), ""
    if background is not None:
        r, g, b = (round(255 * value) for value in background)
        style += f"canvas {{ background: #{r:02x}{g:02x}{b:02x}; }}\n"
        theme = f' data-theme="{"light" if np.mean(background) >= BRIGHT else "dark"}"'
    chip = '<label class="chip"><input type="radio" name="plane"><span>{}</span></label>'
    chips = "".join(chip.format(number) for number in range(1, planes + 1))
    parts = {
        "theme": theme,
        "title": html.escape(title),
        "style": style,
        "style_hash": _hash(style),
        "script": script,
        "script_hash": _hash(script),
        "chips": f'<div class="row chips" role="radiogroup" aria-label="Plane">{chips}</div>\n' if planes > 1 else "",
        "page": json.dumps(record, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _source("page.html"))


def _source(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _hash(source: str) -> str:
    """Hash by which the page's security policy recognises what may run or style it."""
    return f"sha256-{_base64(hashlib.sha256(source.encode()).digest())}"


def _placed(grid: Grid, cube: Cube) -> dict[str, Any]:
    """Factor and shift from the cube to texture coordinates of a grid."""
    extent = grid.cell * np.array(grid.shape)
    return {"scale": _list(cube.edge / extent), "shift": _list((cube.low - grid.origin) / extent)}


def _record(layers: Layers) -> dict[str, Any]:
    return {
        "shape": layers.shape,
        "columns": layers.columns,
        "rows": layers.rows,
        "sheets": [_base64(sheet) for sheet in layers.sheets],
    }


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _list(values: NDArray[np.floating]) -> list[float]:
    return [float(value) for value in values]
