"""Folders of photographs with hand-marked masks, and a list of what each shows."""

from __future__ import annotations

import argparse
import csv
import io
from pathlib import Path

from benchmarks.support.options import ROOT, parser_of
from engine.io.files import read_file

__all__ = ["PHOTOGRAPHS", "listed", "parse_options"]

PHOTOGRAPHS = ROOT.parent / "shared/data/photos/fruit"
"""Holds `masks/` and `list.csv`; measured unless another folder is given."""


def listed(folder: Path) -> list[dict[str, str]]:
    """The rows of a folder's list."""
    return list(csv.DictReader(io.StringIO(read_file(folder / "list.csv", 1 << 20).decode())))


def parse_options(text: str | None, arguments: list[str] | None) -> tuple[argparse.Namespace, list[dict[str, str]]]:
    """Options of a benchmark on a folder of photographs, and the rows to measure; `text` is its help."""
    parser = parser_of(text, "four photographs")
    parser.add_argument("photographs", nargs="?", type=Path, default=PHOTOGRAPHS, help="default: photos/fruit")
    options = parser.parse_args(arguments)
    if not (options.photographs / "list.csv").is_file():
        parser.error(f"{options.photographs}: no list.csv")
    return options, listed(options.photographs)[:: 8 if options.quick else 1]
