"""Takes the picture of a notebook in docs/API.md, in JupyterLab in a real browser: `pip install jupyterlab` first."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

from playwright.sync_api import Error, Page, sync_playwright

from tests.browser import BROWSER

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs/pictures/notebook.png"
NOTEBOOK = "photographs_to_slices.ipynb"
PORT, TOKEN = 8912, "picture"
SIZE = (860, 1120)
STARTS, ENDS = 60.0, 600.0
"""Seconds to wait for the server, and for the last cell: one of the cells trains a draft."""


def main() -> None:
    """Runs every cell of a copy and takes a picture around the slider."""
    folder = ROOT / "out/notebook"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copy(ROOT / "examples" / NOTEBOOK, folder)
    options = ["--no-browser", "--allow-root", f"--port={PORT}", "--ServerApp.port_retries=0"]
    options += [f"--IdentityProvider.token={TOKEN}", f"--ServerApp.root_dir={folder}"]
    server = subprocess.Popen([sys.executable, "-m", "jupyterlab", *options])
    try:
        (folder.parent / "sample_scenes").unlink(missing_ok=True)
        (folder.parent / "sample_scenes").symlink_to(ROOT / "sample_scenes")
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=BROWSER)
            page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
            _open(page)
            _run(page)
            slider = page.locator(".jp-Cell", has=page.locator(".widget-interact"))
            slider.scroll_into_view_if_needed()
            page.mouse.move(SIZE[0] / 2, SIZE[1] / 2)
            page.mouse.wheel(0, slider.bounding_box()["y"] - 0.55 * SIZE[1])  # type: ignore[index]
            time.sleep(2)  # until it has scrolled
            page.screenshot(path=PICTURE)
            browser.close()
    finally:
        server.terminate()
        server.wait()
    print(PICTURE)


def _open(page: Page) -> None:
    """Opens the notebook without side panels, once the server answers."""
    end = time.monotonic() + STARTS
    while True:
        try:
            page.goto(f"http://localhost:{PORT}/doc/tree/{NOTEBOOK}?token={TOKEN}")
            break
        except Error:
            if time.monotonic() > end:
                raise
            time.sleep(0.5)
    page.wait_for_selector(".jp-Notebook .jp-Cell", timeout=1000 * STARTS)
    page.get_by_text("Kernel", exact=True).first.wait_for()
    time.sleep(3)  # until the kernel is ready and JupyterLab asks whether to show news
    page.get_by_role("button", name="No", exact=True).click()
    page.keyboard.press("Control+b")


def _run(page: Page) -> None:
    """Runs every cell, until the last one has its number."""
    page.get_by_text("Run", exact=True).first.click()
    page.get_by_text("Run All Cells", exact=True).click()
    end = time.monotonic() + ENDS
    while not page.locator(".jp-CodeCell .jp-InputPrompt").last.inner_text().strip("[]: \n").isdigit():
        if time.monotonic() > end:
            raise SystemExit(f"{NOTEBOOK}: its last cell has not run after {ENDS:g} s")
        time.sleep(1)


if __name__ == "__main__":
    main()
