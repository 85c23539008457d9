"""Bodies and pictures of cut faces with a known inside, and photographs."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.io.picture_file import read_pixels, save_png
from engine.scene.grid import Body, Grid
from tests.paths import SHARED
from training.faces.marks import Marks
from training.faces.polygon import mask_polygon
from training.priors.exemplar.pictures import Picture, read_picture
from training.priors.exemplar.quilting import quilt
from training.priors.exemplar.quilting.disc import Disc
from training.priors.exemplar.quilting.quilt import Quilt

UP = np.array([0.0, 0.0, 1.0])
RIND, FLESH, SEED = np.array([0.1, 0.5, 0.1]), np.array([0.85, 0.15, 0.15]), np.array([0.05, 0.03, 0.02])


def quiet(_: float) -> None:
    """A progress callback that does nothing."""


def coarse_quilt(across: Disc, along: Disc) -> Quilt:
    """The quilt of a horizontal picture and a radial one, with seams on few cells: colours are read at every point."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quilt, "LEVELS", (16, 32))
        return quilt.make_quilt([across], [along], 0, quiet)


def ball(n: int = 24) -> Body:
    """A ball of radius 1."""
    cell = 2 / n
    grid = Grid(np.full(3, -1 - 3 * cell), cell, (n + 6,) * 3)
    return Body(grid, (1 - np.linalg.norm(grid.centres(), axis=-1)).astype(np.float32))


def disc(size: int = 160, seeds: int = 0, radius: float = 0.8) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A melon's face on white: rind a tenth thick, flesh, a ring of round seeds; and its mask."""
    y, x = (np.mgrid[:size, :size] + 0.5) / size * 2 - 1
    r = np.hypot(x, y) / radius
    face = np.where((r > 0.88)[..., None], RIND, FLESH)
    for angle in np.arange(seeds) / max(seeds, 1) * 2 * np.pi:
        at = 0.55 * radius * np.array([np.cos(angle), np.sin(angle)])
        face[np.hypot(x - at[0], y - at[1]) < 0.06 * radius] = SEED
    return np.where((r < 1)[..., None], face, 1.0).astype(np.float32), r < 1


def save(path: Path, picture: NDArray[np.floating]) -> Path:
    """Writes a picture in [0, 1] as a PNG."""
    save_png(path, picture)
    return path


@cache
def picture_of(name: str) -> Picture:
    """A photograph of fruit, whose name gives the kind of cut, with its hand-marked mask, as finding the face takes a
    second; skips the test where the photographs are missing."""
    folder = SHARED / "photos/fruit"
    if not folder.exists():
        pytest.skip("the photographs are not beside the repository")
    face = Marks(outline=mask_polygon(read_pixels(folder / f"masks/{name}.png")[..., 0] > 127))
    return read_picture(folder / f"{name}.png", "horizontal" if "_h" in name else "radial", face)


@cache
def photograph(name: str) -> Disc:
    """The same, stretched to the unit disc."""
    return Disc.of(picture_of(name))
