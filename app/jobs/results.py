"""Where the results of an object's training are, and whether they belong to the part of the capture that it keeps."""

from __future__ import annotations

import os
from pathlib import Path

from app.model.document import Document
from app.model.settings import state_folder
from engine.errors import InputError
from engine.io.trained import find_trained, trained_isolation
from engine.isolate.record import isolation_record

__all__ = ["default_out", "find_result", "result_folder"]


def default_out(scene: Path, number: int = 0) -> Path:
    """The default result folder: beside the scene, or in the app's state folder if the scene's folder is read-only.

    `number`: as in Document, for one of several objects.
    """
    folder = scene.parent
    if not os.access(folder, os.W_OK):
        folder = state_folder() / "results"
    return folder / (f"{scene.stem}-inside" + (f"-{number}" if number else ""))


def result_folder(document: Document) -> Path | None:
    """The folder for the result of a document; None if it has no scene."""
    if document.scene is None:
        return None
    return document.training.out or default_out(document.scene, document.number)


def find_result(document: Document) -> Path | None:
    """The object that was trained from the part of the scene that a document keeps; None if there is none."""
    folder = result_folder(document)
    path = None if folder is None or document.scene is None else find_trained(folder, document.scene.stem)
    if path is None:
        return None
    try:
        same = list(trained_isolation(path)) == isolation_record(document.isolation)
    except InputError:
        same = True  # loading it will say what is wrong
    return path if same else None
