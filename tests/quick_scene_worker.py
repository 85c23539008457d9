"""The scene worker with coarse solids and a short fit of their skin, for window tests that look at other things."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import app.jobs.scene_loader as scene_loader
import app.jobs.scene_worker as scene_worker
from engine.processes import start_python

__all__ = ["use_quick_worker"]


def use_quick_worker() -> None:
    """Scenes that this process loads from now on are prepared by this module."""

    def start_quick(module: str, **options: Any) -> Any:
        return start_python("tests.quick_scene_worker", **options)

    scene_loader.start_python = start_quick  # type: ignore[assignment]


if __name__ == "__main__":
    from engine.solid import solidify  # here alone: it takes a second to import, and the window does not need it

    solidify.BODY_CELLS = 32
    scene_worker.DRAFT = replace(
        scene_worker.DRAFT, cells=40, skin_views=12, skin_steps=4, skin_size=96, surface_views=8, surface=64
    )
    scene_worker.DETAILS = dict.fromkeys(scene_worker.DETAILS, scene_worker.DRAFT)
    scene_worker.main()
