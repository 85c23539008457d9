"""Opens a page in a real browser that is offline and has no graphics card."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

__all__ = ["BROWSER", "SOFTWARE", "opened"]

SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
"""WebGL without a graphics card."""

BROWSER = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "google-chrome"))), None)


@contextmanager
def opened(page: Path, size: tuple[int, int], *arguments: str) -> Iterator[tuple[Any, list[str]]]:
    """Opens the page in a tab of `size` pixels; yields the tab, and the list of all requests and complaints. Skips the
    test if there is no browser."""
    sync_api = pytest.importorskip("playwright.sync_api")
    if BROWSER is None:
        pytest.skip("no Chromium: install chromium-headless-shell")
    said: list[str] = []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=arguments)
        width, height = size
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme="dark")
        context.set_offline(True)
        tab = context.new_page()
        tab.on("request", lambda request: said.append(request.url))
        tab.on("console", lambda message: said.append(message.text))
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.goto(page.as_uri())
        try:
            yield tab, said
        finally:
            browser.close()
