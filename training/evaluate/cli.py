"""`fruitninja-evaluate`: how good the insides are, as figures, pictures and tables."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, cast, get_args

import typer

from engine.command import FAILED, print_result, run_command
from engine.errors import InputError
from engine.io.files import locked_folder, remove_leftovers
from training.evaluate.grid import Cell, cells, run_locally, run_on_cluster
from training.evaluate.methods.all_methods import METHODS
from training.evaluate.report import write_report
from training.evaluate.scenes import SCENES
from training.settings import DetailName

__all__ = ["main"]


def evaluate(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for report.html, report.json and what they need.")],
    scenes: Annotated[
        str, typer.Option(help=f"With commas between: {','.join(SCENES)}.")
    ] = "watermelon_others,orange_others,watermelon,orange,bread",
    methods: Annotated[str, typer.Option(help=f"With commas between: {','.join(METHODS)}.")] = ",".join(METHODS),
    detail: Annotated[str, typer.Option(help="draft, standard or high.")] = "draft",
    cuts: Annotated[int, typer.Option(min=6, help="Random cuts of each scene, the paper's 120 for its table 2.")] = 120,
    seeds: Annotated[int, typer.Option(min=1, help="Repeats of each method, with seeds 0, 1, ...")] = 1,
    clip: Annotated[Path | None, typer.Option(help="Local folder of a CLIP model, for CLIP scores.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="A running Dask cluster, as tcp://host:8786. Its workers share these files.")
    ] = None,
) -> None:
    """Measure the insides of scenes whose inside is known; started again, it resumes where it was stopped."""
    if detail not in get_args(DetailName):
        raise InputError(f"--detail {detail}: unknown; choose {', '.join(get_args(DetailName))}")
    if clip is not None and not clip.is_dir():
        raise InputError(f"--clip {clip}: no such folder")
    grid = cells(
        parse_names(scenes, SCENES, "--scenes"),
        parse_names(methods, tuple(METHODS), "--methods"),
        range(seeds),
        cast(DetailName, detail),
        cuts,
        clip,
        out.absolute(),
    )
    with locked_folder(out):
        below = (path for name in ("results", "scenes", "truth") for path in (out / name, *(out / name).rglob("*/")))
        remove_leftovers(out, *below)  # a run clears its own folder
        failed = run_locally(grid, on_change) if scheduler is None else run_on_cluster(scheduler, grid, on_change)
        page = write_report(grid, failed, out)
    print_result(str(page))
    if failed:
        raise typer.Exit(FAILED)


def parse_names(text: str, known: tuple[str, ...], option: str) -> list[str]:
    """The names in a list with commas, each once, all of them known."""
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    for name in names:
        if name not in known:
            raise InputError(f"{option} {name}: unknown; choose {', '.join(known)}")
    if not names:
        raise InputError(f"{option}: none given; choose {', '.join(known)}")
    return names


def on_change(cell: Cell, what: str) -> None:
    """One line to the terminal."""
    print(f"{cell.name}: {what}", file=sys.stderr, flush=True)


def main() -> None:
    """Entry point: one clear line and status 2 for bad input, 1 if a part of the grid failed, 130 or 143 if the user
    stopped it."""
    run_command("fruitninja-evaluate", evaluate, stopped="stopped; the same command goes on from here")


if __name__ == "__main__":
    main()
