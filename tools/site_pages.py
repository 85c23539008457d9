"""Adds the root's pages to the documentation site: the README and its like stay where they are."""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

PAGES = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md", "changes.md": "CHANGELOG.md"}
"""Names on the site, and the files at the root."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages, with their links as seen from `docs`."""
    root = Path(config.config_file_path).parent
    for name, source in PAGES.items():
        text = (root / source).read_text(encoding="utf-8").replace("](docs/", "](")
        for other, its_source in PAGES.items():
            text = text.replace(f"]({its_source})", f"]({other})")
        files.append(File.generated(config, name, content=text))
    return files
