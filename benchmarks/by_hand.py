"""Handwritten code against its plain form or the library's: it stays only while these figures justify it.

    python -m benchmarks.by_hand [--quick] [-o docs/charts]

Eight kinds of row: the distance transforms of a grid and of a picture, splines, linear values between cells,
sharpening, and the errors of an octree's leaves against SciPy's, the thread loop against the standard library's pool on
the short loops of a frame, and the vector lanes of the classic renderer against plain loops.
Both sides of a row run in turns; figures are medians of wall time, and of processor time over cores, which a loaded
machine disturbs least. Writes by_hand.json and .png.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.cpu_renderer import scene, view
from benchmarks.support.charts import ACCENT, plt, save_chart
from benchmarks.support.options import out_folder, parser_of
from benchmarks.support.timing import timed
from engine.io.files import write_json
from engine.render.classic import rasterizer as classic
from engine.render.classic.blend import BLOCK, UNTOUCHED, start_tile
from engine.render.classic.differentiable import rasterize
from engine.render.classic.records import Frame, Slice
from engine.render.classic.tiles import BLOCKS, SIDE, TAIL_BITS
from engine.scene.constants import MAX_ALPHA, MIN_TRANSMITTANCE
from engine.scene.grid import read_cells
from engine.solid.distance_transform import depth_in, nearest
from engine.solid.octree import approximation_error
from engine.threads import cores, for_each
from tests.reference import octree as plain
from training.priors.cubic import read_cubic, spline_coefficients
from training.priors.exemplar.sharpen import sharpen_layer

LOOPS, TASKS = 12, 16
"""Loops per frame, and tasks per loop."""

WORK = 4000
"""Steps of a task: about twenty microseconds."""


@njit(cache=True, nogil=True)
def spend(task: int, out: np.ndarray) -> None:
    """A short task."""
    total = 0.0
    for k in range(WORK):
        total += (k * 7919 + task) % 13
    out[task] = total


@njit(cache=True, nogil=True, error_model="numpy")
def plain_blend(
    task: int,
    tiles_per_task: int,
    part: Slice,
    frame: Frame,
    open_tiles: NDArray[np.uint8],  # in out [tiles_y, tiles_x]
) -> None:
    """`engine.render.classic.blend.blend` pixel by pixel, as a first version would be written."""
    tiles, tile_starts, pair_codes = part.tiles, part.tile_starts, part.pair_codes
    records, states, lasts, tile_lasts = frame.records, frame.states, frame.lasts, frame.tile_lasts
    tiles_x = open_tiles.shape[1]
    for index in range(task * tiles_per_task, min((task + 1) * tiles_per_task, len(tiles))):
        tile = tiles[index]
        ty, tx = tile // tiles_x, tile % tiles_x
        if tile_lasts[tile] == UNTOUCHED:
            start_tile(states[tile], lasts[tile], tx * SIDE, ty * SIDE, frame.width, frame.height)
        alive = 0
        for block in range(BLOCKS):
            s = states[tile, block]
            for i in range(BLOCK):
                x, y = tx * SIDE + i % SIDE + 0.5, ty * SIDE + 2 * block + i // SIDE + 0.5
                left = s[i]
                for at in range(tile_starts[tile], tile_starts[tile + 1]):
                    if left <= 0:
                        break
                    if not (pair_codes[at] >> block) & 1:
                        continue
                    slot = pair_codes[at] >> BLOCKS
                    r = records[slot]
                    m = r[4] * ((x - r[0]) - r[1])
                    n = r[5] * ((x - r[0]) - r[1]) + r[6] * ((y - r[2]) - r[3])
                    power = r[7] - m * m - n * n
                    if power < -TAIL_BITS:
                        continue
                    alpha = min(2.0**power, MAX_ALPHA)
                    after = left * (1 - alpha)
                    if after < MIN_TRANSMITTANCE:
                        left = -left
                        break
                    w = alpha * left
                    for c in range(3):
                        s[(1 + c) * BLOCK + i] += w * r[8 + c]
                    s[4 * BLOCK + i] += w * r[11]
                    lasts[tile, block, i] = slot
                    left = after
                s[i] = left
                alive += left > 0
        if not alive:
            open_tiles[ty, tx] = 0
        tile_lasts[tile] = lasts[tile].max()


def in_turns(ours: Callable[[], Any], other: Callable[[], Any], rounds: int) -> dict[str, dict[str, float]]:
    """Milliseconds of both, as medians of wall and busy time."""
    spent: dict[str, list[tuple[float, float]]] = {"ours": [], "other": []}
    for run in (ours, other):
        run()  # compiles, and brings the data into the cache
    for _ in range(rounds):
        for name, run in (("ours", ours), ("other", other)):
            spent[name].append(timed(run))
    medians = {name: np.median(np.array(times), axis=0) * [1e3, 1e3 / cores()] for name, times in spent.items()}
    return {name: {"wall_ms": round(float(w), 3), "busy_ms": round(float(b), 3)} for name, (w, b) in medians.items()}


def distance_row(cells: int, rounds: int) -> dict[str, Any]:
    """Distance and nearest cell to a shell, as finding the body needs them."""
    axis = np.linspace(-1.1, 1.1, cells)
    radius = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij")), axis=0)
    shell = np.abs(radius - 0.9) < 1.5 * 2.2 / cells

    def scipy() -> None:
        ndimage.distance_transform_edt(~shell, return_distances=True, return_indices=True)

    return in_turns(lambda: nearest(shell), scipy, rounds)


def picture_row(side: int, rounds: int) -> dict[str, Any]:
    """Distances in a picture to what is outside of a disc."""
    x, y = np.indices((side, side)) - side / 2
    disc = np.hypot(x, y) < 0.45 * side
    return in_turns(lambda: depth_in(disc), lambda: ndimage.distance_transform_edt(disc), rounds)


def spline_row(cells: int, rounds: int) -> dict[str, Any]:
    """Colours between the cells of a grid, where atoms are."""
    rng = np.random.default_rng(0)
    rgb, at = rng.random((cells, cells, cells, 3), np.float32), rng.uniform(0, cells - 1, (200_000, 3))
    splines = spline_coefficients(rgb)

    def scipy() -> None:
        for c in range(3):
            ndimage.map_coordinates(splines[..., c], at.T, order=3, mode="nearest", output=np.float32, prefilter=False)

    return in_turns(lambda: read_cubic(splines, at), scipy, rounds)


def cell_row(cells: int, rounds: int) -> dict[str, Any]:
    """Colours between the cells of a grid, linear, where pixels of cuts are."""
    rng = np.random.default_rng(0)
    rgb, at = rng.random((cells, cells, cells, 3), np.float32), rng.uniform(0, cells - 1, (200_000, 3))

    def scipy() -> None:
        for c in range(3):
            ndimage.map_coordinates(rgb[..., c], at.T, order=1, mode="nearest", output=np.float32)

    return in_turns(lambda: read_cells(rgb, at), scipy, rounds)


def sharpen_row(cells: int, rounds: int) -> dict[str, Any]:
    """One channel of a volume, sharpened within the range of its neighbours."""
    values, edge = np.random.default_rng(0).random((2, cells, cells, cells), np.float32)
    out = np.empty_like(values)

    def scipy() -> None:
        low, high = ndimage.minimum_filter(values, 3), ndimage.maximum_filter(values, 3)
        np.clip(np.clip(values + 2 * edge, low, high), 0, 1)

    return in_turns(lambda: for_each(sharpen_layer, cells, values, edge, np.float32(2), out), scipy, rounds)


def leaf_row(cells: int, rounds: int) -> dict[str, Any]:
    """How far atoms of four cells are from the colours they stand for."""
    rgb = np.random.default_rng(0).random((cells, cells, cells, 3), np.float32)
    return in_turns(lambda: approximation_error(rgb, 4), lambda: plain.approximation_error(rgb, 4), rounds)


def thread_row(rounds: int) -> dict[str, Any]:
    """A frame's worth of short loops."""
    out = np.zeros(TASKS)
    with ThreadPoolExecutor(cores()) as pool:

        def library() -> None:
            for _ in range(LOOPS):
                list(pool.map(spend, range(TASKS), [out] * TASKS))

        def ours() -> None:
            for _ in range(LOOPS):
                for_each(spend, TASKS, out)

        return in_turns(ours, library, rounds)


def lane_row(size: int, rounds: int) -> dict[str, Any]:
    """Compositing of one picture, everything else the same."""
    means, scales, quats, opacities, colours = scene(20_000)
    camera = view(size)

    def draw() -> None:
        rasterize(means, scales, quats, opacities, colours, camera)

    def without_lanes() -> None:
        with mock.patch.object(classic, "blend", plain_blend):
            draw()

    return in_turns(draw, without_lanes, rounds)


def chart(rows: dict[str, dict[str, Any]], path: Path) -> None:
    """A bar for each row: how many times longer the alternative takes."""
    names = list(rows)
    ratios = [rows[name]["other"]["wall_ms"] / rows[name]["ours"]["wall_ms"] for name in names]
    figure, axes = plt.subplots(figsize=(8, 0.7 * len(names) + 1.2), layout="constrained")
    axes.barh(names[::-1], ratios[::-1], color=ACCENT, height=0.55)
    axes.axvline(1.0, color="#303337", linewidth=1)
    for place, (name, ratio) in enumerate(zip(names[::-1], ratios[::-1], strict=True)):
        ours, other = rows[name]["ours"]["wall_ms"], rows[name]["other"]["wall_ms"]
        axes.text(ratio, place, f"  {ratio:.1f}x  ({ours:.2f} against {other:.2f} ms)", va="center", fontsize=9)
    axes.set(xlim=(0, 1.8 * max(ratios)), xlabel="times longer by the plain form or the library")
    axes.spines[["top", "right"]].set_visible(False)
    save_chart(figure, path)


def main(arguments: list[str] | None = None) -> None:
    """Measures all rows and writes them."""
    options = parser_of(__doc__, "few rounds on small inputs").parse_args(arguments)
    folder, quick = out_folder(options), options.quick
    rounds = 3 if quick else 15
    rows = {
        "distance transform, 128^3 (SciPy)": distance_row(64 if quick else 128, rounds),
        "distance transform, 192^3 (SciPy)": distance_row(64 if quick else 192, rounds),
        "distances in a picture, 1,400^2 (SciPy)": picture_row(350 if quick else 1400, rounds),
        "splines at 200,000 points (SciPy)": spline_row(16 if quick else 128, rounds),
        "cells at 200,000 points (SciPy)": cell_row(16 if quick else 128, rounds),
        "sharpening, 128^3 (SciPy)": sharpen_row(32 if quick else 128, rounds),
        "errors of leaves, 128^3 (SciPy)": leaf_row(32 if quick else 128, rounds),
        f"{LOOPS} short loops (ThreadPoolExecutor)": thread_row(20 * rounds),
        "classic, 20 k, 512^2 (plain loops)": lane_row(256 if quick else 512, rounds),
    }
    for name, row in rows.items():
        print(f"{name}: {row}")
    if folder:
        write_json(folder / "by_hand.json", {"cores": cores(), "rows": rows})
        chart(rows, folder / "by_hand.png")


if __name__ == "__main__":
    main()
