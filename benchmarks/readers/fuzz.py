"""Fuzzes every reader with any number of inputs, with limited memory and time.

    python -m benchmarks.readers.fuzz [--quick] [--inputs 50000] [--seed 0] [--only TARGET]

Prints one JSON line for each target: inputs, how many were accepted, the slowest, and what broke, if anything.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
from hypothesis import HealthCheck, Phase, given, seed, settings

from benchmarks.readers.targets import TARGETS, Target

QUICK = 500
"""Number of inputs in a quick run."""

HANG = 5.0
"""Seconds that reading one input may take."""

MEMORY = 1 << 30
"""Bytes that readers may allocate beyond what the imports took: one that trusts a header asks for more."""


def main(arguments: list[str] | None = None) -> None:
    """Runs all targets; exit status 1 if one broke."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"under a minute: {QUICK} inputs")
    parser.add_argument("--inputs", type=int, default=50_000, help="over all targets")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(TARGETS), metavar="TARGET", help=f"of {', '.join(TARGETS)}")
    options = parser.parse_args(arguments)
    count = QUICK if options.quick else options.inputs
    os.fsync = lambda _: None  # type: ignore[assignment]  # power failures are not tested here
    used = psutil.Process().memory_info().vms
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    broke = False
    with tempfile.TemporaryDirectory() as folder:
        for name, target in TARGETS.items():
            if options.only in (None, name):
                result = fuzz(target, int(count * target.share), options.seed, Path(folder))
                broke |= result["broke"] is not None
                print(json.dumps({"target": name, **result}), flush=True)
    sys.exit(1 if broke else 0)


def fuzz(target: Target, inputs: int, start: int, folder: Path) -> dict[str, Any]:
    """Counts and times, and the smallest input that broke the target, in words, if one did."""
    counts = {"inputs": 0, "accepted": 0}
    slowest = 0.0

    @seed(start)
    @settings(
        max_examples=inputs,
        deadline=None,
        database=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(target.inputs)
    def run(value: Any) -> None:
        nonlocal slowest
        begun = time.perf_counter()
        with watched():
            accepted = target.check(value, folder)
        counts["inputs"] += 1
        counts["accepted"] += accepted
        slowest = max(slowest, time.perf_counter() - begun)

    begun = time.perf_counter()
    broke = None
    try:
        run()
    except BaseException as error:  # of any kind: this is what fuzzing looks for; the next target still runs
        if isinstance(error, KeyboardInterrupt):
            raise
        inner = error.exceptions[0] if isinstance(error, BaseExceptionGroup) else error
        broke = f"{type(inner).__name__}: {str(inner)[:500]} {' '.join(getattr(inner, '__notes__', []))[:1500]}"
    return counts | {"seconds": round(time.perf_counter() - begun, 1), "slowest": round(slowest, 3), "broke": broke}


@contextmanager
def watched() -> Iterator[None]:
    """Interrupts the block with TimeoutError after HANG seconds."""

    def late(*_: object) -> None:
        raise TimeoutError(f"over {HANG} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, HANG)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


if __name__ == "__main__":
    main()
