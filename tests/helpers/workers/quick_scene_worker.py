"""The scene worker with coarse solids whose skin is not fitted, for window tests of other features."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import app.jobs.scene_loader as scene_loader
import app.jobs.scene_worker as scene_worker
from engine.processes import start_python
from engine.solid import solidify
from training.settings import DETAILS

__all__ = ["BODY_CELLS", "QUICK", "main", "use_quick_worker"]


QUICK = replace(DETAILS["draft"], cells=40, skin_views=12, skin_steps=4, skin_size=96, surface_views=8, surface=64)
BODY_CELLS = 32
"""QUICK stands in for every level of detail; BODY_CELLS sets the grid on which the body is found."""


start: Callable[..., Any] = start_python
"""Starts this module in another process."""


def use_quick_worker() -> None:
    """Makes this process prepare all further scenes with this module."""

    def start_quick(module: str, **options: Any) -> Any:
        return start("tests.helpers.workers.quick_scene_worker", **options)

    scene_loader.start_python = start_quick  # type: ignore[assignment]


def main() -> None:
    """Serves one request."""
    solidify.BODY_CELLS = BODY_CELLS
    scene_worker.DRAFT = QUICK
    scene_worker.DETAILS = dict.fromkeys(DETAILS, scene_worker.DRAFT)
    scene_worker.load_torch = lambda: None
    scene_worker.matched = lambda atoms, *_: atoms
    scene_worker.main()


if __name__ == "__main__":
    main()
