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


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_replaced_for_a_measurement_is_there(name: str) -> None:
    """A constant's name in a string is not renamed with it, and is looked up only in a full run."""
    module = importlib.import_module(f"benchmarks.{name}")
    assert module.__file__ is not None
    for node in ast.walk(ast.parse(Path(module.__file__).read_text())):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "mock.patch.object":
            owner, attribute = node.args[:2]
            assert hasattr(eval(ast.unparse(owner), vars(module)), ast.literal_eval(attribute)), ast.unparse(node)


def test_a_quick_run_never_replaces_the_figures_of_a_full_one(tmp_path: Path) -> None:
    parser = parser_of("text", "nothing")
    assert out_folder(parser.parse_args([])) == CHARTS
    assert out_folder(parser.parse_args(["--quick"])) is None
    asked = tmp_path / "charts"
    assert out_folder(parser.parse_args(["--quick", "-o", str(asked)])) == asked and asked.is_dir()
