"""Every benchmark explains its use, has a quick run, and measures nothing just to show its help."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

from benchmarks.support.options import CHARTS, out_folder, parser_of
from tests.paths import ROOT

COMMANDS = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py") if path.stem != "__init__")
FOLDERS = sorted(path.parent.name for path in (ROOT / "benchmarks").glob("*/__main__.py"))
PHOTOGRAPHS = ["photographs.changed", "photographs.faces", "photographs.insides", "photographs.kinds"]
READERS = ["readers.corpus", "readers.formats", "readers.fuzz"]
NO_CHARTS = {"readers.corpus", "readers.fuzz"}
"""The first writes a table to a given file, the second prints."""


@pytest.mark.parametrize("name", [*COMMANDS, *FOLDERS, *PHOTOGRAPHS, *READERS])
def test_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    main = importlib.import_module(f"benchmarks.{name}" + (".__main__" if name in FOLDERS else "")).main
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["--help"])
    said = capsys.readouterr().out
    assert f"python -m benchmarks.{name}" in said and "--quick" in said
    assert ("-o FOLDER" in said) == (name not in NO_CHARTS)


def test_what_is_replaced_for_a_measurement_is_there() -> None:
    """A constant's name in a string is not renamed with it, and is looked up only in a full run."""
    replaced = 0
    for path in sorted((ROOT / "benchmarks").rglob("*.py")):
        text = path.read_text()
        if "mock.patch" not in text:
            continue
        names = vars(importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts)))
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "mock.patch.object":
                owner, attribute = node.args[:2]
                assert hasattr(eval(ast.unparse(owner), names), ast.literal_eval(attribute)), ast.unparse(node)
                replaced += 1
    assert replaced


def test_a_quick_run_never_replaces_the_figures_of_a_full_one(tmp_path: Path) -> None:
    parser = parser_of("text", "nothing")
    assert out_folder(parser.parse_args([])) == CHARTS
    assert out_folder(parser.parse_args(["--quick"])) is None
    asked = tmp_path / "charts"
    assert out_folder(parser.parse_args(["--quick", "-o", str(asked)])) == asked and asked.is_dir()
