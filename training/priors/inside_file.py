"""The inside of a trained object from the file beside it."""

from __future__ import annotations

from pathlib import Path

from engine.errors import InputError
from engine.io.trained import inside_path, load_inside_record
from engine.scene.inside import Inside, InsideRecord
from training.priors.exemplar.inside import QuiltInside

__all__ = ["read_inside", "restore_inside"]


def restore_inside(record: InsideRecord) -> Inside:
    """The inside of a record, with the same bits. Raises ValueError if it is none."""
    return QuiltInside.restored(*record)


def read_inside(path: str | Path) -> Inside | None:
    """The inside of a trained .ply; None if its atoms are all there is. Raises InputError if the file is damaged."""
    record = load_inside_record(path)
    if record is None:
        return None
    try:
        return restore_inside(record)
    except ValueError as error:
        raise InputError(
            f"{inside_path(path)}: not the inside of a trained object ({error}); delete it, or train again"
        ) from error
