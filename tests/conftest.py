"""Fixtures that several topics share."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from engine.render.gl import GLMissing, Renderer
from engine.threads import use_cores


def pytest_configure() -> None:
    """Gives each process of a parallel run, with all that it starts, a core of its own: threads that wait for each
    other by spinning would take it from the tests of the others (a fifth of the whole time on two cores).

    The process itself has counted the cores on import, and two threads on one core wait for each other.
    """
    if hasattr(os, "sched_setaffinity") and (worker := os.environ.get("PYTEST_XDIST_WORKER")):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker.removeprefix("gw")) % len(cores)]})
        use_cores(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spreads the slow tests over the processes of a parallel run: all would wait for one that began last.

    The first process begins with them, the others after half of their part: at first kernels are not compiled yet, and
    two that need the same at once compile them twice.
    """
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    slow = [item for item in items if item.get_closest_marker("slow")]
    others = [item for item in items if not item.get_closest_marker("slow")]
    part = -(-len(items) // processes)
    items.clear()
    for n in range(processes):
        some = slow[n::processes]
        begin = max(len(others) - part + len(some), 0) if n < processes - 1 else 0
        # The last part begins with the tests of the window's model, which need few kernels.
        rest, others = others[begin:], others[:begin]
        early = len(rest) // 2 if n else 0
        items += rest[:early] + some + rest[early:]


@pytest.fixture(scope="session")
def offscreen() -> Iterator[Renderer]:
    """The renderer of all tests: compiling its shaders takes longer than drawing."""
    try:
        renderer = Renderer()
    except GLMissing as missing:
        pytest.skip(str(missing))
    yield renderer
    renderer.release()


@pytest.fixture
def renderer(offscreen: Renderer) -> Iterator[Renderer]:
    """The renderer, with no GL error before the test and none after it."""
    assert offscreen.ctx.error == "GL_NO_ERROR"
    yield offscreen
    assert offscreen.ctx.error == "GL_NO_ERROR"
