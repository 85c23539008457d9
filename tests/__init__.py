"""Tests, by room. Each process of a parallel run, with all that it starts, keeps to one core: threads of several
processes that wait for each other on the same cores take a fifth of the time of all tests."""

import os

if "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "sched_setaffinity"):
    _cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {_cores[int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw")) % len(_cores)]})
