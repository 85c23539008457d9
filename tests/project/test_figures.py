"""The figures of the pages are those that were measured."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.paths import ROOT
from tools.figures import ON_THE_FRONT_PAGE, rows


def test_the_tables_of_the_report_say_what_the_charts_say() -> None:
    report = (ROOT / "docs/MEASURED.md").read_text(encoding="utf-8")
    assert not [line for line in rows() if line not in report]


@pytest.mark.parametrize("table", ON_THE_FRONT_PAGE)
def test_the_front_page_repeats_its_tables_word_for_word(table: Callable[[], list[str]]) -> None:
    front = (ROOT / "README.md").read_text(encoding="utf-8")
    assert not [line for line in table() if line not in front]
