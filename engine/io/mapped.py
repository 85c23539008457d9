"""Maps the arrays of a safetensors file of our own into memory instead of copying them.

A large capture comes from the preparing process in such a file. Mapped, its pages are those of the system's file cache:
they exist once, however many processes look at them, and are given back when memory is short.
"""

from __future__ import annotations

import json
import math
import mmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.io.files import open_file

__all__ = ["map_arrays"]

TYPES: dict[str, np.dtype[Any]] = {"F32": np.dtype("<f4"), "F64": np.dtype("<f8"), "BOOL": np.dtype(bool)}
"""Types of the arrays that our processes exchange."""


def map_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a safetensors file, which must have been written by this program and must no longer change.

    They may be written to, which does not change the file. Raises InputError if it cannot be opened.
    """
    with open_file(path) as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(length))
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    arrays: dict[str, NDArray[Any]] = {}
    for name, entry in header.items():
        shape, (begin, _) = entry["shape"], entry["data_offsets"]
        kind = TYPES[entry["dtype"]]
        if all(shape):
            arrays[name] = np.frombuffer(data, kind, math.prod(shape), 8 + length + begin).reshape(shape)
        else:
            arrays[name] = np.empty(shape, kind)
    return arrays
