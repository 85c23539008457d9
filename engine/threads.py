"""How many cores are used, and one way to use them.

numba's own parallel loops and torch both keep a pool of threads; each would take all the cores. Here numba kernels run
without the interpreter lock on this module's pool, which sleeps when it has nothing to do: no spinning beside torch's
threads, no trouble after a fork, and any number of threads of the app may render at once.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
import torch

__all__ = ["cores", "for_each", "use_cores"]


class _Pool:
    """The threads beside the calling one; made on first use, made anew in a forked child."""

    def __init__(self) -> None:
        self.count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self.executor: ThreadPoolExecutor | None = None

    def helpers(self) -> ThreadPoolExecutor:
        if self.executor is None:
            self.executor = ThreadPoolExecutor(max(1, self.count - 1), thread_name_prefix="render")
        return self.executor

    def forget(self) -> None:
        self.executor = None


_pool = _Pool()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.forget)


def cores() -> int:
    """How many cores the renderers use."""
    return _pool.count


def use_cores(count: int) -> None:
    """Sets the number of threads of this pool, of numba's parallel loops and of torch, at least 1.

    They never run at the same time, so each may have them all.
    """
    count = max(1, count)
    numba.set_num_threads(min(count, vars(numba.config)["NUMBA_NUM_THREADS"]))
    torch.set_num_threads(count)
    if count != _pool.count:
        _pool.count = count
        _pool.forget()


def for_each(kernel: Callable[..., Any], count: int, *args: Any) -> None:
    """Runs kernel(i, *args) for every i in 0..count-1, spread over the cores; returns when all are done.

    The kernel must release the interpreter lock (`nogil=True`) to gain from it, and its calls must not depend on each
    other. The first error is raised.
    """
    threads = min(_pool.count, count)
    if threads <= 1:
        for i in range(count):
            kernel(i, *args)
        return
    counter = itertools.count()  # next() on it is one step under the interpreter lock

    def work() -> None:
        while (i := next(counter)) < count:
            kernel(i, *args)

    helpers = [_pool.helpers().submit(work) for _ in range(threads - 1)]
    work()
    for helper in helpers:
        if not helper.cancel():  # one that has not begun has nothing left to do
            helper.result()
