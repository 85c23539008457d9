"""Trains in this process: a capture and photographs of cut faces become a solid with an inside."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from engine.errors import InputError
from engine.io.files import locked_folder
from engine.io.trained import load_trained
from engine.threads import one_thread_for_torch
from fruitninja.arguments import PathLike, Progress, Shapes, UpLike, as_detail, as_isolation, as_seed, as_up
from fruitninja.capture import Capture
from fruitninja.solid import Solid, Whole
from training.cli import parse_families
from training.events import Reporter
from training.request import Request

__all__ = ["grow"]

Pictures = PathLike | Sequence[PathLike] | None
"""Pictures of cut faces, or folders of them; a single one needs no list, and None is an empty one."""


def grow(
    capture: Capture | PathLike,
    *,
    horizontal: Pictures = (),
    radial: Pictures = (),
    parallel: Pictures = (),
    detail: str = "standard",
    up: UpLike | None = None,
    keep: Shapes = (),
    same: bool = False,
    seed: int = 0,
    out: PathLike | None = None,
    progress: Progress | None = None,
) -> Solid:
    """Makes a solid with an inside, bit for bit the one that `fruitninja-train` makes.

    `capture`: a file, or a loaded capture, whose file is read again. `horizontal`, `radial`, `parallel`: pictures of
    cut faces of each family, at least one in all. `detail`: draft, standard or high. `up`: x, y, z, -x, -y, -z or a
    vector (3,); None: detected. `keep`: shapes that contain the object; what lies outside all of them is left out.
    `same`: whether all pictures show the very same object. `out`: a folder for the files that the command writes;
    None: no files are kept.

    `progress` may raise an exception to end the run: it is passed on, and no result is written. Warnings of the run are
    issued as Python warnings at its end. Raises Error for unusable input.
    """
    scene = capture.path if isinstance(capture, Capture) else Path(capture)
    if not scene.is_file():
        raise InputError(f"{scene}: no such file")
    given = {"horizontal": horizontal, "radial": radial, "parallel": parallel}
    exemplars = [f"{kind}={os.fspath(path)}" for kind, pictures in given.items() for path in _listed(pictures)]
    if not exemplars:
        raise InputError("no picture of a cut face; give at least one, as in horizontal=['cut.png']")
    request = Request(
        scene,
        parse_families(exemplars, [], []),
        as_detail(detail),
        as_up(up),
        as_seed(seed),
        isolation=as_isolation(keep),
        same=same,
    )
    listener = _Listener(progress)
    try:
        if out is not None:
            return Solid(_trained(request, Path(out), listener))
        with TemporaryDirectory(prefix="fruitninja-") as folder:
            # The solid's file is deleted with the folder: messages name the capture instead.
            return Solid(replace(_trained(request, Path(folder), listener), source=scene))
    finally:
        for message in listener.warnings:
            warnings.warn(message, stacklevel=2)


def _listed(pictures: Pictures) -> Sequence[PathLike]:
    return [pictures] if isinstance(pictures, str | os.PathLike) else pictures or ()


def _trained(request: Request, out: Path, listener: _Listener) -> Whole:
    """The run's result as read from its file, but with the inside in memory: reading that one too takes seconds."""
    from training.pipeline import Pipeline  # imports torch: a second that those who only look at solids need not wait

    with one_thread_for_torch(), locked_folder(out):
        pipeline = Pipeline(request, out, listener, lambda: False)
        path = pipeline.run(resume=False)
        return Whole(*load_trained(path), pipeline.inside, path)


class _Listener(Reporter):
    """Passes the events of a run on to the caller of `grow`."""

    def __init__(self, progress: Progress | None) -> None:
        super().__init__()
        self.listener = progress
        self.warnings: list[str] = []

    def emit(self, event: str, **facts: Any) -> None:
        """Reports a stage's progress, and keeps warnings until the end, when they can point at the caller's line."""
        if event == "warning":
            self.warnings.append(facts["message"])
        elif event in ("stage", "progress") and self.listener is not None:
            self.listener(facts["stage"], float(facts.get("part", 0.0)))
