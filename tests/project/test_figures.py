"""The figures of the README are the measured ones."""

from __future__ import annotations

from tests.paths import ROOT
from tools.figures import rows


def test_the_tables_of_the_readme_say_what_the_charts_say() -> None:
    said = (ROOT / "README.md").read_text(encoding="utf-8")
    assert not [line for line in rows() if line not in said]
