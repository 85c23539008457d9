"""Whatever is fed to the readers, they give one clear line, or something finite that survives a round trip.

The inputs are always the same few thousand; `python -m benchmarks.readers.fuzz` makes any number of others.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from benchmarks.readers.targets import TARGETS

INPUTS = 2000


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_breaks_a_reader(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)  # files are read at once, and power failures are not tested
    target = TARGETS[name]

    @settings(
        max_examples=int(INPUTS * target.share),
        deadline=5000,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(target.inputs)
    def fuzz(value: object) -> None:
        target.check(value, tmp_path)

    fuzz()
