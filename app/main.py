"""`fruitninja`: the desktop app."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from pathlib import Path

__all__ = ["main"]

REFUSED = 2
"""The same exit status as in `engine.command`, which takes a second to import: a wrong path is reported at once."""


def main() -> None:
    """Entry point: `fruitninja [SCENE | PROJECT.fruitninja]`."""
    parser = argparse.ArgumentParser(
        prog="fruitninja", description="Slice a 3DGS capture anywhere, and give it an inside."
    )
    kinds = ".ply, .splat, .spz, .sog, .obj, .glb, ..."
    parser.add_argument("path", nargs="?", type=Path, help=f"a scene ({kinds}) or a .fruitninja project")
    path: Path | None = parser.parse_args().path
    if path is not None and not path.is_file():
        print(f"fruitninja: {path}: no such file", file=sys.stderr)
        sys.exit(REFUSED)
    # Imported only now: the window's libraries take a second to load, and a wrong path is reported at once.
    path = None if path is None else path.absolute()
    folder = leave_current_folder()
    from app.model.project import Viewing
    from app.model.samples import sample_document
    from app.session.recovered_jobs import recovered_jobs
    from app.session.session import Session
    from app.ui.window import Window
    from engine.threads import one_thread_for_blas

    one_thread_for_blas()

    def start(session: Session) -> None:
        running = [job for job in recovered_jobs(session) if not job.ended]
        if path is not None:
            session.files.open(path)
        elif running or not session.settings.recent:
            document = running[0].document if running else sample_document()
            session.files.open_document(document, Viewing(mode="capture"))

    if not can_show():
        print(
            "fruitninja: there is no display to open a window on; fruitninja-train and fruitninja-render need none",
            file=sys.stderr,
        )
        sys.exit(REFUSED)
    Window(Session(folder=folder), start).run()


def leave_current_folder() -> Path:
    """Makes the program's own folder the current one, and returns the previous one.

    The window's libraries search the current folder for settings, pictures, shared libraries and programs, and the user
    may have unpacked a stranger's archive there.
    """
    from engine.processes import HOME

    try:
        here = Path.cwd()
    except FileNotFoundError:  # it has been removed
        here = Path.home()
    if home := os.environ.get("FRUITNINJA_HOME"):
        os.environ["FRUITNINJA_HOME"] = str(here / home)
    os.chdir(HOME)
    return here


def can_show() -> bool:
    """Whether there is a display, checked first because the window itself would fail with an assertion in C++."""
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bool(glfw.init())


if __name__ == "__main__":
    main()
