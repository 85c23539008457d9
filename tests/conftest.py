"""Fixtures shared by several packages."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator

import pytest

from engine.render.gl import GLMissing, Renderer
from engine.threads import one_thread_for_blas, use_cores


def pytest_configure() -> None:
    """Gives each process of a parallel run, with everything that it starts, its own core: otherwise threads that spin
    while waiting would take time from the other processes' tests (a fifth of the whole on two cores).

    The process has already counted the cores on import, and two threads on one core would wait for each other.
    """
    one_thread_for_blas()
    if hasattr(os, "sched_setaffinity") and (worker := os.environ.get("PYTEST_XDIST_WORKER")):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker.removeprefix("gw")) % len(cores)]})
        use_cores(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spreads the slow tests over the processes of a parallel run: all processes would wait for one that began last.

    The first process begins with them, the others after half of their share: kernels are not compiled at first, and two
    tests that need the same kernel at the same time compile it twice.
    """
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    slow = [item for item in items if item.get_closest_marker("slow")]
    others = [item for item in items if not item.get_closest_marker("slow")]
    part = -(-len(items) // processes)
    items.clear()
    for n in range(processes):
        some = slow[n::processes]
        begin = max(len(others) - part + len(some), 0) if n < processes - 1 else 0
        # The last share begins with the tests of the window's model, which need few kernels.
        rest, others = others[begin:], others[:begin]
        early = len(rest) // 2 if n else 0
        items += rest[:early] + some + rest[early:]


def pytest_collection_finish() -> None:
    """Takes all that was imported out of the searches for garbage: each would look through it again."""
    gc.freeze()


@pytest.fixture(scope="session")
def offscreen() -> Iterator[Renderer]:
    """One renderer for all tests: compiling its shaders takes longer than drawing."""
    try:
        renderer = Renderer()
    except GLMissing as missing:
        pytest.skip(str(missing))
    yield renderer
    renderer.release()


@pytest.fixture
def renderer(offscreen: Renderer) -> Iterator[Renderer]:
    """The renderer, checked for GL errors before and after each test."""
    assert offscreen.ctx.error == "GL_NO_ERROR"
    yield offscreen
    assert offscreen.ctx.error == "GL_NO_ERROR"
