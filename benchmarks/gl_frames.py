"""Frames of the GL engine: milliseconds against atoms, and against accuracy.

    python -m benchmarks.gl_frames [--quick] [-o docs/charts]

A melon stands in a picture of 1280 x 720, framed as the app frames it: a lattice of interior atoms under a closed skin
of discs, as many and as large as captures of an orange and an apple give (16 of them over each pixel that shows skin).
The camera goes round in steps of a degree, so that no frame can be reused; the cuts stay, except in the rows for a
moving cut. Each mode is timed beside the floor, the same atoms drawn once as one-pixel GL_POINTS, in the same run.
Writes gl_frames.json and .png.

Where GL is software, the solid is drawn by kernels on the CPU; `opaque, by shaders` is the time that GLSL takes there.
The coarser rows are what a moving view may fall back to: fewer pixels along a side, fewer atoms.

Times are those of the fastest of several frames; `busy` is processor time over cores, which a loaded machine disturbs
less (it means nothing where a GPU does the work). Accuracy is measured against float64: for the melon of a million
atoms in windows on the face, across its rim and on the skin; for classic mode on a small melon. On a graphics card the
files are gl_frames_card.json and .png, so that they stand beside those of software GL.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import torch

from benchmarks.support.charts import ACCENT, QUIET, front, plt, save_chart
from benchmarks.support.options import out_folder, parser_of
from benchmarks.support.timing import timed
from engine.io.files import write_json
from engine.render.cpu.software import is_software
from engine.render.gl import Renderer
from engine.scene import sh
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.camera import Camera, fit_distance, orbit
from engine.scene.image import psnr
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.threads import cores
from tests.helpers.solids import rows_of
from tests.reference.classic import picture as classic_reference
from tests.reference.opaque import reference

SIZE = 1280, 720
FOV = math.radians(35)
AIR = 1.12  # radii that fit into the picture, as the app frames an object
DENSITY, SIGMA = 0.9, 0.75  # discs per pitch squared, sigma in spacings: as captures of an orange and an apple give
CUTS = {
    "uncut": (),
    "one cut": (Plane.of((0.1, 0.05, 1), 0.01),),
    "three cuts": (Plane.of((0.1, 0.05, 1), 0.01), Plane.of((1, 0.1, 0), -0.1), Plane.of((0.1, 1, 0.2), -0.2)),
}
MODES: dict[str, dict[str, Any]] = {
    "opaque": {"exact": False},
    "opaque, exact faces": {"exact": True},
    "opaque, no culling": {"exact": True, "cull": False},
}
CLASSIC = {"classic": False, "classic, full floats": True}
SHADERS = "opaque, by shaders"
COARSER: dict[str, tuple[float, int]] = {  # fraction of the pixels along a side, level of detail
    "coarser: 3/4 of the side, level 1": (0.75, 1),
    "coarser: 1/2, level 1": (0.5, 1),
    "coarser: 1/2, level 2": (0.5, 2),
    "coarser: 1/3, level 3": (0.35, 3),
}
WINDOWS = {"face": (560, 300), "near rim": (600, 560), "far rim": (800, 175), "silhouette": (780, 585)}
WINDOW = 96  # pixels along a side
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
    """A ball of radius 0.5 of `count` atoms: its skin striped, its flesh with a rind and a soft grain."""
    radius, under = 0.5, 0.4  # pitches from the skin to the lattice
    pitch = float(np.cbrt(4 / 3 * np.pi * radius**3 / count))
    for _ in range(50):  # skin and lattice share `count` atoms
        skin = DENSITY * 4 * np.pi * radius**2 / pitch**2
        pitch = float(np.cbrt(4 / 3 * np.pi * (radius - under * pitch) ** 3 / (count - skin)))
    rng = np.random.default_rng(0)
    side = np.arange(-int(radius / pitch) - 1, int(radius / pitch) + 2) * pitch
    inner = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
    inner += rng.uniform(-0.2, 0.2, inner.shape) * pitch
    inner = inner[np.linalg.norm(inner, axis=1) < radius - under * pitch]
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
    scales = np.tile(np.array([SIGMA, SIGMA, 0.15]) * spacing, (n, 1))
    depth = 1 - np.linalg.norm(inner, axis=1, keepdims=True) / radius
    rgb = np.where(depth > 0.14, [0.85, 0.15, 0.2], np.where(depth > 0.08, [0.9, 0.95, 0.75], [0.6, 0.85, 0.4]))
    rgb = np.clip(rgb + 0.1 * np.sin(inner * 60), 0, 1)
    sigmas = np.full(len(inner), pitch / 2)
    surface = SurfaceAtoms(*(a.astype(np.float32) for a in (radius * normal, scales, quats, coefficients)))
    interior = InteriorAtoms(inner.astype(np.float32), sigmas.astype(np.float32), rgb.astype(np.float32))
    return Atoms(surface, interior, pitch)


def view(step: int, width: int = SIZE[0], height: int = SIZE[1]) -> Camera:
    away = fit_distance(0.5 * AIR, FOV, width / height)
    return orbit((0, 0, 0), (0, 0, 1), 30 + step, 35, away, width, height, FOV)


def point_cloud(renderer: Renderer, atoms: Atoms) -> Callable[[int], None]:
    """The floor: all atoms drawn once as points of one pixel, with a depth buffer."""
    ctx = renderer.ctx
    target = ctx.framebuffer([ctx.texture(SIZE, 4)], ctx.depth_texture(SIZE))
    program = ctx.program(vertex_shader=POINTS, fragment_shader=PLAIN)
    rgb = np.concatenate([sh.sh_to_rgb(atoms.surface.sh[:, 0]), atoms.interior.rgb])
    means = np.concatenate([atoms.surface.means, atoms.interior.means])
    array = ctx.vertex_array(program, [(ctx.buffer(np.concatenate([means, rgb], 1)), "3f 3f", "mean", "rgb")])

    matrix = program["matrix"]
    assert isinstance(matrix, moderngl.Uniform)

    def draw(step: int) -> None:
        camera = view(step)
        lens = np.zeros((4, 4))
        lens[0, 0], lens[1, 1] = 2 * camera.fx / camera.width, 2 * camera.fy / camera.height
        lens[2, 2:], lens[3, 2] = (1.002, -0.02), 1
        matrix.write((lens @ camera.viewmat).T.astype(np.float32).tobytes())
        target.use()
        ctx.enable_only(moderngl.DEPTH_TEST)
        target.clear()
        array.render(moderngl.POINTS)

    return draw


def frame_times(renderer: Renderer, draw: Callable[[int], object], times: int) -> dict[str, float]:
    """Least milliseconds of a frame, wall and busy, after a warm-up; slow frames are repeated less often."""

    def frame(step: int) -> None:
        draw(step)
        renderer.ctx.finish()

    frame(0)
    spent: list[tuple[float, float]] = []
    while len(spent) < times and sum(wall for wall, _ in spent) < 8:
        spent.append(timed(partial(frame, len(spent) + 1)))
    wall, busy = np.min(spent, axis=0)
    return {"ms": round(1e3 * wall, 2), "busy ms": round(1e3 * busy / cores(), 2)}


def speed(renderer: Renderer, shaders: Renderer, count: int, times: int) -> list[dict[str, object]]:
    """A row for each mode and cut."""
    atoms = melon(count)
    renderer.set_atoms(atoms)
    rows: list[dict[str, object]] = []

    def add(mode: str, cut: str, draw: Callable[[int], object]) -> None:
        rows.append({"atoms": count, "mode": mode, "cut": cut, **frame_times(renderer, draw, times)})
        print(json.dumps(rows[-1]), flush=True)

    floor = point_cloud(renderer, atoms)
    add("points", "uncut", floor)
    for cut, planes in CUTS.items():
        pieces = (Piece(planes),)
        for mode, options in MODES.items():
            for _ in range(2):
                renderer.render(view(0), pieces, **options)  # the grid of a plane is made when the plane is seen again

            def draw(step: int, pieces: tuple[Piece, ...] = pieces, options: dict[str, Any] = options) -> None:
                renderer.render(view(step), pieces, **options)

            add(mode, cut, draw)
    pieces = (Piece(CUTS["one cut"]),)
    for mode, (part, level) in COARSER.items():

        def coarse(step: int, part: float = part, level: int = level) -> None:
            renderer.render(view(step).scaled(part), pieces, exact=False, level=level)

        coarse(0)
        add(mode, "one cut", coarse)
    one = CUTS["one cut"][0]

    def sweep(step: int) -> None:
        moved = Plane(one.normal, one.offset + 0.01 * step)
        renderer.render(view(0), (Piece((moved,)),), exact=False)

    add("opaque", "moving cut", sweep)
    if shaders is not renderer:
        shaders.set_atoms(atoms)
        add(SHADERS, "one cut", lambda step: shaders.render(view(step), pieces, exact=False))
        shaders.set_atoms(melon(200))
    renderer.set_capture(atoms.as_gaussians(0.99))

    def classic(exact: bool, step: int) -> None:
        renderer.render(view(step), mode="classic", exact=exact)

    for mode, exact in CLASSIC.items():
        add(mode, "uncut", partial(classic, exact))
    add("points", "uncut again", floor)
    renderer.set_capture(melon(200).as_gaussians(0.99))
    return rows


def accuracy(renderer: Renderer, shaders: Renderer, count: int) -> dict[str, float]:
    """PSNR in dB of each mode against float64, in windows: `count` atoms with one cut."""
    atoms, planes, camera = melon(count), CUTS["one cut"], view(0)
    truths = [true_window(atoms, camera, planes, *corner) for corner in WINDOWS.values()]

    def compared(rgb: np.ndarray) -> float:
        parts = [rgb[y : y + WINDOW, x : x + WINDOW] for x, y in WINDOWS.values()]
        return round(psnr(np.stack(parts), np.stack(truths)), 1)

    renderer.set_atoms(atoms)
    figures, pieces = {}, (Piece(planes),)
    for mode, options in MODES.items():
        for _ in range(3):
            renderer.render(camera, pieces, **options)
        figures[mode] = compared(renderer.read().rgb)
    for mode, (part, level) in COARSER.items():
        for _ in range(3):
            renderer.render(camera.scaled(part), pieces, exact=False, level=level)
        small = torch.as_tensor(renderer.read().rgb).permute(2, 0, 1)[None]
        large = torch.nn.functional.interpolate(small, (camera.height, camera.width), mode="bilinear")
        figures[mode] = compared(large[0].permute(1, 2, 0).numpy())
    if shaders is not renderer:
        shaders.set_atoms(atoms)
        shaders.render(camera, pieces, exact=False)
        figures[SHADERS] = compared(shaders.read().rgb)
    capture = melon(1500).as_gaussians(0.99)
    renderer.set_capture(capture)
    camera = view(0, 80, 60)
    values = (capture.means, capture.scales, capture.quats, capture.opacities, capture.sh)
    means, scales, quats, opacities, coefficients = (torch.as_tensor(v, dtype=torch.float64) for v in values)
    exact = classic_reference(means, scales, quats, opacities, coefficients, camera, (1.0, 1.0, 1.0))[0]
    for mode, full_floats in CLASSIC.items():
        renderer.render(camera, mode="classic", exact=full_floats)
        figures[mode] = round(psnr(renderer.read().rgb, exact.numpy()), 1)
    return figures


def true_window(atoms: Atoms, camera: Camera, planes: Sequence[Plane], x: int, y: int) -> np.ndarray:
    """RGB (WINDOW, WINDOW, 3) of the float64 reference in the window with this corner, from the atoms that reach it."""
    part = replace(camera, cx=camera.cx - x, cy=camera.cy - y, width=WINDOW, height=WINDOW)

    def near(means: np.ndarray, reach: float) -> np.ndarray:
        c = means @ part.viewmat[:3, :3].T + part.viewmat[:3, 3]
        at = c[:, :2] / c[:, 2:] * [part.fx, part.fy] + [part.cx, part.cy]
        return np.all(np.abs(at - WINDOW / 2) < WINDOW / 2 + reach * part.fx / c[:, 2:], axis=1)

    s, i = atoms.surface, atoms.interior
    a, b = near(s.means, 4 * float(s.scales.max())), near(i.means, 4 * float(i.sigmas.max()))
    b &= np.min([np.abs(p.distance(i.means)) for p in planes], axis=0) < 3.1 * i.sigmas.max()
    return reference(rows_of(atoms, a, b), part, planes)[0]


def chart(rows: list[dict], figures: dict[str, float], who: str, path: Path) -> None:
    """Milliseconds against atoms for one cut, and accuracy against milliseconds for a million atoms."""
    key = "busy ms" if is_software(who) else "ms"
    counts = sorted({row["atoms"] for row in rows})
    most = min(counts[-1], 1_000_000)
    figure, (left, right) = plt.subplots(1, 2, figsize=(16, 5.6), constrained_layout=True)

    def of(mode: str, count: int) -> float | None:
        cut = "uncut" if mode in (*CLASSIC, "points") else "one cut"
        return next((r[key] for r in rows if (r["atoms"], r["mode"], r["cut"]) == (count, mode, cut)), None)

    shades = plt.get_cmap("Greens")(np.linspace(0.75, 0.4, len(COARSER)))
    colours = {"opaque": ACCENT, "opaque, exact faces": "#B8432A", "opaque, no culling": "#F2A38F"}
    colours |= {SHADERS: "#3C78D8", "classic": "#303337", "classic, full floats": QUIET}
    colours |= dict(zip(COARSER, shades, strict=True))
    for mode, colour in colours.items():
        if mode in figures:
            left.plot(counts, [of(mode, n) for n in counts], "o-", ms=4, color=colour, label=mode)
            right.plot([of(mode, most)], [figures[mode]], "o", ms=8, color=colour, label=mode)
    left.plot(counts, [of("points", n) for n in counts], "k:")
    times, decibels = [of(mode, most) or math.inf for mode in figures], list(figures.values())
    line = front(times, decibels)
    right.step(
        [times[i] for i in line], [decibels[i] for i in line],
        where="post", color=QUIET, lw=1.2, label="Pareto front", zorder=0,
    )  # fmt: skip
    floor = of("points", most)
    assert floor is not None
    right.axvline(floor, color="k", ls=":", label="one-pixel GL_POINTS (the floor)")
    if is_software(who):
        right.axvline(floor / 5, color="k", ls="--", lw=0.8, label="a fifth of that: the target")
    left.set(xscale="log", yscale="log", xlabel="atoms", ylabel=f"{key} a frame", title="One cut (classic: uncut)")
    right.set(
        xscale="log", xlabel=f"{key} a frame", ylabel="PSNR against float64, dB", title=f"{most:,} atoms, one cut"
    )
    ticks = [t for t in (2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000) if 0.4 < t / min(times) < 1000]
    right.set_xticks(ticks, [str(t) for t in ticks])
    right.minorticks_off()
    left.set_xticks(counts, [f"{n / 1e6:g} M" for n in counts])
    left.minorticks_off()
    figure.legend(*right.get_legend_handles_labels(), fontsize=9, loc="outside right center")
    for panel in (left, right):
        panel.grid(alpha=0.3)
    figure.suptitle(f"GL frames, 1280 x 720, {who}, {cores()} cores")
    save_chart(figure, path)


def main(arguments: list[str] | None = None) -> None:
    """Measures, prints a row for each mode, and writes numbers and chart."""
    options = parser_of(__doc__, "a hundred thousand atoms, few frames").parse_args(arguments)
    folder, quick = out_folder(options), options.quick
    with Renderer() as renderer:
        who = str(renderer.ctx.info["GL_RENDERER"])
        shaders = Renderer(renderer.ctx, shaders=True) if is_software(who) else renderer
        counts = [100_000] if quick else [100_000, 300_000, 1_000_000, 3_000_000]
        if not (quick or is_software(who)):
            counts.append(10_000_000)
        rows = [row for count in counts for row in speed(renderer, shaders, count, 2 if quick else 9)]
        figures = accuracy(renderer, shaders, 100_000 if quick else 1_000_000)
        print(json.dumps(figures), flush=True)
        if shaders is not renderer:
            shaders.release()
    numbers = {"renderer": who, "cores": cores(), "PSNR": figures, "frames": rows}
    if folder:
        name = "gl_frames" if is_software(who) else "gl_frames_card"
        write_json(folder / f"{name}.json", numbers)
        chart(rows, figures, who, folder / f"{name}.png")


if __name__ == "__main__":
    main()
