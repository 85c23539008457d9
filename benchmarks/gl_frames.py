"""Frames of the GL engine: milliseconds against atoms, and against accuracy.

    python -m benchmarks.gl_frames [--quick]

A melon stands in a picture of 1280 x 720, framed as the app frames it: a lattice of interior atoms under a closed skin
of discs (1.5 to a pitch squared, sigma 0.6 of their spacing: 10 of them over each pixel that shows skin). The camera
goes round in steps of a degree, so that no frame can be kept; the cuts stay, or move in the rows that say so. Each mode
is timed beside the floor, the same atoms drawn once as one-pixel GL_POINTS, in the same run. Writes
docs/charts/gl_frames.json and .png.

Seconds are the least of several frames; `busy` is processor time over cores, which a loaded machine disturbs less (it
says nothing where a GPU does the work). Accuracy is measured on a small melon against the float64 references.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import moderngl
import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from reference_classic import picture as classic_reference
from reference_opaque import reference

from engine import sh
from engine.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.camera import Camera, fit_distance, orbit
from engine.gaussians import Gaussians
from engine.gl import Renderer
from engine.piece import Piece
from engine.plane import Plane
from engine.threads import cores

mpl.use("Agg")
from matplotlib import pyplot as plt

FOLDER = Path(__file__).parents[1] / "docs/charts"
SIZE = 1280, 720
FOV = math.radians(35)
AIR = 1.12  # radii that fit the picture, as the app frames an object
CUTS = {
    "uncut": (),
    "one cut": (Plane.of((0.1, 0.05, 1), 0.01),),
    "three cuts": (Plane.of((0.1, 0.05, 1), 0.01), Plane.of((1, 0.1, 0), -0.1), Plane.of((0.1, 1, 0.2), -0.2)),
}
MODES = {
    "opaque": {"exact": False},
    "opaque, exact faces": {"exact": True},
    "opaque, level 1": {"exact": False, "level": 1},
    "opaque, level 2": {"exact": False, "level": 2},
    "opaque, no culling": {"exact": True, "cull": False},
    "classic": {"mode": "classic"},
}
POINTS = """
#version 330
in vec3 mean; in vec3 rgb; uniform mat4 matrix; out vec3 colour;
void main() { gl_Position = matrix * vec4(mean, 1.0); colour = rgb; }
""".strip()
PLAIN = """
#version 330
in vec3 colour; out vec4 pixel;
void main() { pixel = vec4(colour, 1.0); }
""".strip()


def melon(count: int) -> Atoms:
    """`count` atoms: a ball of radius 0.5, its skin striped, its flesh with a rind and a soft grain."""
    radius, density = 0.5, 1.5
    pitch = float(np.cbrt(4 / 3 * np.pi * radius**3 / count))
    for _ in range(20):  # what the skin takes, the lattice does not have
        skin = density * 4 * np.pi * radius**2 / pitch**2
        pitch = float(np.cbrt(4 / 3 * np.pi * radius**3 / (count - skin)))
    rng = np.random.default_rng(0)
    side = np.arange(-int(radius / pitch) - 1, int(radius / pitch) + 2) * pitch
    inner = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
    inner += rng.uniform(-0.2, 0.2, inner.shape) * pitch
    inner = inner[np.linalg.norm(inner, axis=1) < radius - 0.4 * pitch]
    n = count - len(inner)
    spacing = math.sqrt(4 * np.pi * radius**2 / n)
    rank = np.arange(n) + 0.5
    polar, turn = np.arccos(1 - 2 * rank / n), np.pi * (1 + 5**0.5) * rank
    normal = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], 1)
    quats = np.stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], 0 * turn], 1)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    stripe = np.sin(10 * np.arctan2(normal[:, 1], normal[:, 0]) + 2 * np.sin(5 * normal[:, 2])) > 0
    coefficients = 0.05 * rng.normal(size=(n, 4, 3))
    coefficients[:, 0] = sh.rgb_to_sh(np.where(stripe[:, None], [0.2, 0.6, 0.2], [0.05, 0.3, 0.1]))
    scales = np.tile(np.array([0.6, 0.6, 0.15]) * spacing, (n, 1))
    depth = 1 - np.linalg.norm(inner, axis=1, keepdims=True) / radius
    rgb = np.where(depth > 0.14, [0.85, 0.15, 0.2], np.where(depth > 0.08, [0.9, 0.95, 0.75], [0.6, 0.85, 0.4]))
    rgb = np.clip(rgb + 0.1 * np.sin(inner * 60), 0, 1)
    sigmas = np.full(len(inner), pitch / 2)
    surface = SurfaceAtoms(*(a.astype(np.float32) for a in (radius * normal, scales, quats, coefficients)))
    return Atoms(surface, InteriorAtoms(*(a.astype(np.float32) for a in (inner, sigmas, rgb))), pitch)


def as_capture(atoms: Atoms) -> Gaussians:
    """The same atoms for classic mode, nearly opaque, SH of degree 1."""
    s, i = atoms.surface, atoms.interior
    unit = np.tile(np.array([1, 0, 0, 0], np.float32), (len(i), 1))
    coefficients = np.zeros((len(i), s.sh.shape[1], 3), np.float32)
    coefficients[:, 0] = sh.rgb_to_sh(i.rgb)
    return Gaussians(
        np.concatenate([s.means, i.means]),
        np.concatenate([s.scales, np.repeat(i.sigmas[:, None], 3, 1)]),
        np.concatenate([s.quats, unit]),
        np.full(len(atoms), 0.99, np.float32),
        np.concatenate([s.sh, coefficients]),
    )


def view(step: int, width: int = SIZE[0], height: int = SIZE[1]) -> Camera:
    away = fit_distance(0.5 * AIR, FOV, width / height)
    return orbit((0, 0, 0), (0, 0, 1), 30 + step, 35, away, width, height, FOV)


def point_cloud(renderer: Renderer, atoms: Atoms) -> Callable[[int], None]:
    """The floor: all atoms once as points of one pixel, with a depth buffer."""
    ctx = renderer.ctx
    target = ctx.framebuffer([ctx.texture(SIZE, 4)], ctx.depth_texture(SIZE))
    program = ctx.program(vertex_shader=POINTS, fragment_shader=PLAIN)
    rgb = np.concatenate([sh.sh_to_rgb(atoms.surface.sh[:, 0]), atoms.interior.rgb])
    means = np.concatenate([atoms.surface.means, atoms.interior.means])
    array = ctx.vertex_array(program, [(ctx.buffer(np.concatenate([means, rgb], 1)), "3f 3f", "mean", "rgb")])

    def draw(step: int) -> None:
        camera = view(step)
        lens = np.zeros((4, 4))
        lens[0, 0], lens[1, 1] = 2 * camera.fx / camera.width, 2 * camera.fy / camera.height
        lens[2, 2:], lens[3, 2] = (1.002, -0.02), 1
        program["matrix"].write((lens @ camera.viewmat).T.astype(np.float32).tobytes())
        target.use()
        ctx.enable_only(moderngl.DEPTH_TEST)
        target.clear()
        array.render(moderngl.POINTS)

    return draw


def timed(renderer: Renderer, draw: Callable[[int], object], times: int) -> dict[str, float]:
    """Least milliseconds of a frame, wall and busy, after one that is not counted; slow frames are repeated less."""
    draw(0)
    renderer.ctx.finish()
    best, busy, spent = math.inf, math.inf, 0.0
    for step in range(1, times + 1):
        wall, processor = time.perf_counter(), time.process_time()
        draw(step)
        renderer.ctx.finish()
        took = time.perf_counter() - wall
        best, busy = min(best, took), min(busy, (time.process_time() - processor) / cores())
        spent += took
        if spent > 8:
            break
    return {"ms": round(1e3 * best, 2), "busy ms": round(1e3 * busy, 2)}


def speed(renderer: Renderer, count: int, times: int) -> list[dict[str, object]]:
    """A row for each mode and cut."""
    atoms = melon(count)
    renderer.set_atoms(atoms)
    rows: list[dict[str, object]] = []

    def add(mode: str, cut: str, draw: Callable[[int], object]) -> None:
        rows.append({"atoms": count, "mode": mode, "cut": cut, **timed(renderer, draw, times)})
        print(json.dumps(rows[-1]), flush=True)

    floor = point_cloud(renderer, atoms)
    add("points", "uncut", floor)
    for cut, planes in CUTS.items():
        pieces = (Piece(planes),)
        for mode, options in MODES.items():
            if mode != "classic":
                add(mode, cut, lambda step, p=pieces, o=options: renderer.render(view(step), p, **o))
    one = CUTS["one cut"][0]

    def sweep(step: int) -> None:
        moved = Plane(one.normal, one.offset + 0.01 * step)
        renderer.render(view(0), (Piece((moved,)),), exact=False)

    add("opaque", "moving cut", sweep)
    renderer.set_capture(as_capture(atoms))
    add("classic", "uncut", lambda step: renderer.render(view(step), mode="classic"))
    add("points", "uncut again", floor)
    renderer.set_capture(as_capture(melon(200)))
    return rows


def accuracy(renderer: Renderer) -> dict[str, float]:
    """PSNR in dB of each mode on a small melon with one cut, against float64."""
    atoms = melon(6000)
    camera, planes = view(0, 160, 120), CUTS["one cut"]
    truth, _, _ = reference(atoms, camera, planes)
    renderer.set_atoms(atoms)
    figures = {}
    for mode, options in MODES.items():
        if mode != "classic":
            renderer.render(camera, (Piece(planes),), **options)
            figures[mode] = psnr(renderer.read().rgb, truth)
    capture = as_capture(melon(1500))
    renderer.set_capture(capture)
    camera = replace(view(0, 80, 60))
    values = (capture.means, capture.scales, capture.quats, capture.opacities, capture.sh)
    exact = classic_reference(*(torch.as_tensor(v, dtype=torch.float64) for v in values), camera, (1.0, 1.0, 1.0))[0]
    renderer.render(camera, mode="classic")
    figures["classic"] = psnr(renderer.read().rgb, exact.numpy())
    return figures


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return round(float(-10 * np.log10(np.mean((a.astype(np.float64) - b) ** 2) + 1e-20)), 1)


def chart(rows: list[dict], figures: dict[str, float], who: str, path: Path) -> None:
    """Milliseconds against atoms for one cut, and accuracy against milliseconds at the largest common count."""
    key = "ms" if is_gpu(who) else "busy ms"
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 4.6), constrained_layout=True)
    counts = sorted({row["atoms"] for row in rows})
    palette = ["#FF6B4A", "#B8432A", "#F2A38F", "#F7C9BC", "#8F949C", "#303337"]
    for mode, colour in zip(MODES, palette, strict=True):
        cut = "uncut" if mode == "classic" else "one cut"
        times = [
            next((r[key] for r in rows if (r["atoms"], r["mode"], r["cut"]) == (n, mode, cut)), None) for n in counts
        ]
        left.plot(counts, times, "o-", color=colour, label=mode)
        most = next(
            r[key] for r in rows if (r["atoms"], r["mode"], r["cut"]) == (min(counts[-1], 1_000_000), mode, cut)
        )
        right.plot([most], [figures[mode]], "o", color=colour)
        right.annotate(mode, (most, figures[mode]), textcoords="offset points", xytext=(6, 4), fontsize=8)
    floor = [next(r[key] for r in rows if (r["atoms"], r["mode"]) == (n, "points")) for n in counts]
    left.plot(counts, floor, "k:", label="one-pixel points")
    left.set(xscale="log", yscale="log", xlabel="atoms", ylabel=f"{key} a frame, one cut")
    left.legend(fontsize=8)
    right.set(
        xscale="log", xlabel=f"{key} a frame, {min(counts[-1], 1_000_000):,} atoms", ylabel="PSNR, dB, against float64"
    )
    for panel in (left, right):
        panel.grid(alpha=0.3)
    figure.suptitle(f"GL frames, 1280 x 720, {who}, {cores()} cores")
    figure.savefig(path, dpi=130)


def is_gpu(who: str) -> bool:
    """Whether the frames are drawn by something else than the processor."""
    return not any(name in who.lower() for name in ("llvmpipe", "softpipe", "swr"))


def main() -> None:
    """Measures, prints a row a mode and writes numbers and chart."""
    quick = "--quick" in sys.argv[1:]
    with Renderer() as renderer:
        who = str(renderer.ctx.info["GL_RENDERER"])
        figures = accuracy(renderer)
        print(json.dumps(figures), flush=True)
        counts = [100_000, 300_000] if quick else [100_000, 300_000, 1_000_000, 3_000_000]
        if is_gpu(who) and not quick:
            counts.append(10_000_000)
        rows = [row for count in counts for row in speed(renderer, count, 4 if quick else 9)]
    FOLDER.mkdir(exist_ok=True)
    numbers = {"renderer": who, "cores": cores(), "PSNR": figures, "frames": rows}
    (FOLDER / "gl_frames.json").write_text(json.dumps(numbers, indent=1) + "\n")
    chart(rows, figures, who, FOLDER / "gl_frames.png")


if __name__ == "__main__":
    main()
