"""Reads the inside of a trained object from the file beside it."""

from __future__ import annotations

from pathlib import Path

from engine.errors import InputError
from engine.io.trained import inside_path, load_inside_record
from engine.scene.inside import Inside, InsideRecord
from training.priors.exemplar.layering.inside import LAYERS, LayeredInside
from training.priors.exemplar.quilting.inside import QUILT, QuiltInside
from training.priors.exemplar.record import RecordReader

__all__ = ["read_inside", "restore_inside"]

KINDS: dict[str, type[LayeredInside] | type[QuiltInside]] = {LAYERS: LayeredInside, QUILT: QuiltInside}


def restore_inside(record: InsideRecord) -> Inside:
    """The inside in a record, bit for bit. Raises ValueError if the record is not valid."""
    arrays, facts = record
    kind = facts.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise ValueError("another kind of inside")
    return KINDS[kind].restored(RecordReader(arrays, facts))


def read_inside(path: str | Path) -> Inside | None:
    """The inside of a trained .ply; None if it has only its atoms. Raises InputError if the file is damaged."""
    record = load_inside_record(path)
    if record is None:
        return None
    try:
        return restore_inside(record)
    except ValueError as error:
        raise InputError(
            f"{inside_path(path)}: not an inside of this version ({error}); delete it, or train again"
        ) from error
