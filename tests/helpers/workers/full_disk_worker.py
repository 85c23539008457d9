"""Loaded by a worker whose disk is full when it first saves its training, and has room again afterwards."""

from __future__ import annotations

from typing import Any
from unittest import mock

import safetensors.numpy


def dask_setup(_: object) -> None:
    write = safetensors.numpy.serialize_file
    failed: list[str] = []

    def serialize(arrays: Any, path: Any, *more: Any, **named: Any) -> None:
        if ".training." in str(path) and not failed:
            failed.append(str(path))
            raise safetensors.SafetensorError("I/O error: No space left on device (os error 28)")
        write(arrays, path, *more, **named)

    mock.patch.object(safetensors.numpy, "serialize_file", serialize).start()
