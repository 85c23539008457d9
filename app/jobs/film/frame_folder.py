"""Saves a film as a folder of pictures; a film that was stopped is continued where it was."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import locked_folder, read_file, remove_leftovers, write_json
from engine.io.picture_file import save_png
from engine.io.strict_json import parse

__all__ = ["save_frames"]

SETTINGS = "film.json"

LIMIT = 4 << 20
"""Bytes of the largest settings that are read: a film with as many keyframes and planes as a file may have."""


def save_frames(folder: Path, settings: dict[str, Any], frames: Iterable[Callable[[], NDArray[np.uint8]]]) -> int:
    """Saves each frame (H, W, 3 or 4) as a PNG of its own in a folder; returns how many of them had to be drawn.

    `settings`: JSON of all that decides what frames look like; frames that are there already with the same settings are
    not drawn again. Raises InputError if the folder has other frames, or if it cannot be written.
    """
    with locked_folder(folder):
        _claim(folder, settings)
        remove_leftovers(folder)
        drawn = 0
        for number, draw in enumerate(frames):
            path = folder / f"frame_{number:05d}.png"
            if not path.exists():
                save_png(path, draw())
                drawn += 1
    return drawn


def _claim(folder: Path, settings: dict[str, Any]) -> None:
    """Records in the folder which frames it holds. Raises InputError if it holds others."""
    path = folder / SETTINGS
    if path.exists():
        try:
            same = parse(read_file(path, LIMIT)) == settings
        except InputError:
            raise
        except ValueError:
            same = False
        if not same:
            raise InputError(f"{folder}: holds the frames of another film; give another folder, or remove them")
    elif any(folder.glob("frame_*.png")):
        raise InputError(f"{folder}: holds frames without {SETTINGS}, which says of what; give another folder")
    else:
        write_json(path, settings)
