"""Insides of kinds that are drawn (`drawn`), grown from cuts of two individuals, beside other cuts of the first one.

    python -m benchmarks.photographs.kinds [--kinds avocado,...] [--seeds 0,1,2] [--quick] [-o docs/charts]

The horizontal picture shows one individual, the radial one another in warmer light. In random cuts, colours blurred by
a twentieth of the radius are compared with the first individual's: `ours` is the mean RGB distance of the inside, and
`another` that of the second individual, which is what nobody can know better. Writes drawn_kinds.json, and the cuts,
true ones above ours, into out/drawn_kinds.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.photographs.drawn import KINDS, Kind
from benchmarks.support.options import ROOT, out_folder, parser_of
from engine.io.files import write_json
from engine.io.picture_file import save_png
from training.priors.exemplar.quilting.disc import Disc, disc_grid
from training.priors.exemplar.quilting.quilt import make_quilt

__all__ = ["main"]

WARMER = (0.97, 0.93, 0.8)
"""Light of the radial picture over that of the horizontal one."""

RIM = 0.985
"""Radius beyond which pictures have the colour of the rim, as photographs have when they become discs."""

SIDE, CUTS, MOST = 160, 12, 0.5
"""Pixels across a cut through the middle; random cuts; and their largest distance from the middle, in radii."""

BLUR = 0.05
"""Standard deviation in radii of the blur under which colours are compared: no two individuals have the same seeds."""


def pictures(kind: Kind) -> tuple[Disc, Disc]:
    """The horizontal cut of the first individual and the radial one of the second."""
    x, y = disc_grid()
    inwards = np.minimum(1, RIM / np.maximum(np.hypot(x, y), 1e-9))
    x, y = x * inwards, y * inwards
    across = kind(np.stack([x, y, 0 * x], -1), 1)
    along = kind(np.stack([x, 0 * x, y], -1), 2) * WARMER
    return Disc(np.clip(across, 0, 1).astype(np.float32)), Disc(np.clip(along, 0, 1).astype(np.float32))


def planes() -> list[NDArray[np.float64]]:
    """(SIDE, SIDE, 3) each. Places of the pixels of random cuts."""
    rng = np.random.default_rng(0)
    at = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    u, v = np.meshgrid(at, -at)
    found = []
    for _ in range(CUTS):
        frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        found.append(u[..., None] * frame[0] + v[..., None] * frame[1] + rng.uniform(-MOST, MOST) * frame[2])
    return found


def shown(rgb: NDArray[np.floating], inside: NDArray[np.bool_]) -> NDArray[np.floating]:
    """(SIDE, SIDE, 3). Blurred colours (M, 3) of the pixels inside (SIDE, SIDE), of these alone."""
    sigma = BLUR * SIDE / 2
    full = np.zeros((*inside.shape, 3))
    full[inside] = rgb
    weight = ndimage.gaussian_filter(inside.astype(float), sigma)
    return np.asarray(ndimage.gaussian_filter(full, (sigma, sigma, 0)) / np.maximum(weight, 1e-6)[..., None])


def measured(kind: Kind, seed: int) -> tuple[dict[str, float], NDArray[np.uint8]]:
    """The figures of a kind, and its sheet of cuts."""
    across, along = pictures(kind)
    quilt = make_quilt([across], [along], seed, lambda part: None)
    rows: list[list[NDArray[np.floating]]] = [[], []]
    apart = []
    for at in planes():
        inside = np.linalg.norm(at, axis=-1) < RIM
        ours = quilt.read(at[inside].astype(np.float32), 2 / SIDE)
        first, second = (np.clip(kind(at[inside], number), 0, 1) for number in (1, 2))
        truth = shown(first, inside)
        apart.append([np.linalg.norm(shown(rgb, inside) - truth, axis=-1)[inside].mean() for rgb in (ours, second)])
        for row, rgb in zip(rows, (first, np.asarray(ours, float)), strict=True):
            tile = np.ones((SIDE, SIDE, 3))
            tile[inside] = rgb
            row.append(tile)
    sheet = np.concatenate([np.concatenate(row, 1) for row in rows])
    ours_apart, another = np.mean(apart, axis=0)
    return {"ours": float(ours_apart), "another": float(another)}, np.round(sheet * 255).astype(np.uint8)


def main(args: list[str] | None = None) -> None:
    parser = parser_of(__doc__, "one kind and one seed")
    parser.add_argument("--kinds", default=",".join(KINDS), help="kinds (default: all)")
    parser.add_argument("--seeds", default="0,1,2", help="seeds of the insides (default: 0,1,2)")
    options = parser.parse_args(args)
    kinds = ["avocado"] if options.quick else options.kinds.split(",")
    seeds = [0] if options.quick else [int(seed) for seed in options.seeds.split(",")]
    if not set(kinds) <= set(KINDS):
        parser.error(f"--kinds: give some of {', '.join(KINDS)}")
    sheets = ROOT / "out/drawn_kinds"
    sheets.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[dict[str, float]]] = {kind: [] for kind in kinds}
    for kind, seed in product(kinds, seeds):
        facts, sheet = measured(KINDS[kind], seed)
        save_png(sheets / f"{kind.replace(' ', '_')}_{seed}.png", sheet)
        found[kind].append({key: round(value, 4) for key, value in facts.items()} | {"seed": seed})
        print(kind, seed, " ".join(f"{key} {value:.3f}" for key, value in facts.items()), flush=True)
    out = out_folder(options)
    if out is not None:
        write_json(out / "drawn_kinds.json", {"kinds": found})


if __name__ == "__main__":
    main()
