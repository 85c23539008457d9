"""Command-line options that all benchmarks share, and where they write their results."""

from __future__ import annotations

import argparse
from pathlib import Path

__all__ = ["CHARTS", "ROOT", "out_folder", "parser_of"]

ROOT = Path(__file__).parents[2]
"""Folder of the project."""

CHARTS = ROOT / "docs/charts"
"""Where a full run writes by default: the charts of docs/MEASURED.md."""


def parser_of(text: str | None, quick: str) -> argparse.ArgumentParser:
    """A parser with `--quick` and `-o/--out`.

    `text`: the benchmark's docstring, shown as its help; `quick`: what a quick run leaves out.
    """
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"measure little: {quick}; write only with --out")
    parser.add_argument(
        "-o", "--out", type=Path, metavar="FOLDER", help="folder of the charts and numbers (a full run: docs/charts)"
    )
    return parser


def out_folder(options: argparse.Namespace) -> Path | None:
    """The folder to write to. None for a quick run, which only prints and never replaces the figures of a full one."""
    if options.out is None:
        return None if options.quick else CHARTS
    folder = Path(options.out)
    folder.mkdir(parents=True, exist_ok=True)
    return folder
