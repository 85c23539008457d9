"""Everything that the pages name exists."""

from __future__ import annotations

import re

import pytest

from tests.paths import ROOT

PAGES = ("CONTRIBUTING.md", "README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))
PATH = re.compile(
    r"(?:app|benchmarks|docs|engine|examples|fruitninja|sample_scenes|shaders|tests|tools|training)/[\w./]*"
)


@pytest.mark.parametrize("page", PAGES)
def test_every_path_on_a_page_exists(page: str) -> None:
    named = set(PATH.findall((ROOT / page).read_text(encoding="utf-8")))
    assert not sorted(name for name in named if not (ROOT / name.rstrip(".")).exists())


def test_every_test_named_on_a_page_exists() -> None:
    files = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
    assert set(re.findall(r"`(test_\w+)`", (ROOT / "docs/TRUST.md").read_text(encoding="utf-8"))) <= files
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for path, name in re.findall(r"(tests/[\w./]+\.py)::(\w+)", text):
        assert f"def {name}(" in (ROOT / path).read_text(encoding="utf-8")
    for module, name in re.findall(r"`benchmarks\.(\w+)|-m benchmarks\.(\w+)", text):
        assert (ROOT / f"benchmarks/{module or name}.py").is_file()
