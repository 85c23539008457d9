"""Whatever is fed to the readers: one clear line, or something finite that survives a round trip.

The inputs are always the same few thousand; `python -m benchmarks.fuzz` makes as many others as one likes.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from benchmarks.fuzz_targets import TARGETS

INPUTS = 2000


BROKEN = {
    # TEMPORARY: promises that are not kept yet; each goes with what mends it.
    "foreign": "Pillow opens PostScript and starts Ghostscript for it, and a dozen other formats",
    "pictures": "not all that Pillow raises is turned into words",
    "textures": "not all that Pillow raises is turned into words",
    "job": "a job's note nested too deep ends the window",
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.xfail(reason=BROKEN.get(name))] * (name in BROKEN)) for name in TARGETS],
)
def test_no_input_breaks_a_reader(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)  # what is written is read at once, no power fails here
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
