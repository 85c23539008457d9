"""The peak memory of a process."""

from __future__ import annotations

import psutil

from engine.processes import peak_memory


def test_the_peak_is_no_less_than_what_is_used_now_and_in_bytes() -> None:
    used = psutil.Process().memory_info().rss
    assert 0.9 * used < peak_memory() < psutil.virtual_memory().total
