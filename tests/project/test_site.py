"""The documentation site is built without a warning, and its page on Python lists the whole package."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import fruitninja
from tests.paths import ROOT


def test_the_site_is_whole(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(tmp_path), strict=True))
    api = (tmp_path / "API/index.html").read_text(encoding="utf-8")
    assert {f"fruitninja.{name}" for name in fruitninja.__all__} <= set(re.findall(r'id="([\w.]+)"', api))
    for page in tmp_path.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for picture in re.findall(r'<img[^>]* src="([^":]+)"', text):
            assert (page.parent / picture).is_file(), (page, picture)
        assert not re.findall(r'(?:src|href)="https?://(?:fonts|cdn|unpkg)[^"]*"', text), page
