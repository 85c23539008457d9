"""The number of cores in use, and a thread pool for numba kernels.

Kernels run without the interpreter lock on this module's threads. numba's own parallel loops take two to three times as
long to compile, and no two of them may run at the same time. A frame is a dozen short loops, and waking a sleeping
thread takes as long as one of them, so an idle thread polls for a fifth of a millisecond before it sleeps.

Written by hand because the standard library's pool is slower on such loops; benchmarks/by_hand.py measures both,
figures in docs/charts/by_hand.json.
"""

from __future__ import annotations

import itertools
import math
import os
import platform
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic
from threadpoolctl import threadpool_limits

__all__ = ["cores", "for_each", "for_spans", "one_thread_for_blas", "one_thread_for_torch", "side_by_side", "use_cores"]

Item = TypeVar("Item")
Result = TypeVar("Result")

SPAN = 2048
"""Rows that a kernel handles at a time: 90 us of work in the quickest of four that were measured, 1 us for the call."""

PATIENCE = 10_000
"""Looks before a thread goes to sleep, about 20 ns each: longer than the caller takes from one loop to the next."""

SETTLE = 500
"""Pauses after work was seen: by then the caller has left the interpreter for its own part, and the lock is free."""

NEWEST, JOINED = 0, 8
"""Places on the board, on cache lines of their own: number of the newest loop, and of the threads at work on it."""

NAP = 2e-4
"""Seconds between looks at a thread that takes longer than PATIENCE for its last part."""

IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


class _Loop:
    """One call of for_each."""

    def __init__(self, kernel: Callable[..., Any], count: int, args: tuple[Any, ...]) -> None:
        self.kernel, self.count, self.args = kernel, count, args
        self.counter = itertools.count()  # next() on it is one step under the interpreter lock
        self.error: BaseException | None = None

    def work(self) -> None:
        """Runs the iterations that no other thread has begun."""
        try:
            while self.error is None and (i := next(self.counter)) < self.count:
                self.kernel(i, *self.args)
        except BaseException as error:
            self.error = self.error or error


class _Team:
    """Threads that take part in the calling thread's loops, one loop at a time."""

    def __init__(self, helpers: int) -> None:
        self.busy = threading.Lock()
        self.board = np.zeros(16, np.int64)
        self.gate = threading.Condition()
        self.loop: _Loop | None = None
        self.closed = False
        for k in range(helpers):
            threading.Thread(target=self._serve, name=f"render-{k}", daemon=True).start()

    def run(self, loop: _Loop) -> None:
        """Runs a loop and returns when all of it is done; `busy` must be held."""
        with self.gate:
            self.loop = loop
            self.board[NEWEST] += 1
            self.gate.notify_all()
        loop.work()
        with self.gate:
            self.loop = None  # whoever has not begun has nothing left to do
        while not becomes(self.board, JOINED, 0, True, PATIENCE, 0):
            time.sleep(NAP)

    def close(self) -> None:
        with self.gate:
            self.closed = True
            self.board[NEWEST] += 1
            self.gate.notify_all()

    def _serve(self) -> None:
        seen = 0
        while True:
            if not becomes(self.board, NEWEST, seen, False, PATIENCE, SETTLE):
                with self.gate:
                    while self.board[NEWEST] == seen:
                        self.gate.wait()
            with self.gate:
                seen, loop = int(self.board[NEWEST]), self.loop
                self.board[JOINED] += loop is not None
            if self.closed:
                return
            if loop is not None:
                loop.work()
                with self.gate:
                    self.board[JOINED] -= 1


class _Pool:
    """The team, made on first use, and anew in a forked child."""

    def __init__(self) -> None:
        self.count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self.lock = threading.Lock()
        self.apart = 0
        """Functions that run side by side now."""
        self._team: _Team | None = None

    def team(self) -> _Team:
        with self.lock:
            if self._team is None:
                self._team = _Team(self.count - 1)
            return self._team

    def resize(self, count: int) -> None:
        with self.lock:
            if self._team is not None:
                self._team.close()
            self.count, self._team = count, None

    def reset(self) -> None:
        self.lock, self.apart, self._team = threading.Lock(), 0, None

    def run_apart(self, function: Callable[[Item], Result], item: Item) -> Result:
        """The function's result for an item, on a core of its own."""
        with self.lock:
            self.apart += 1
        try:
            return function(item)
        finally:
            with self.lock:
                self.apart -= 1

    def is_free(self) -> bool:
        """Whether functions that run side by side leave a core for a loop."""
        return self.apart < self.count


_pool = _Pool()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.reset)


def cores() -> int:
    """The number of cores that the renderers use."""
    return _pool.count


def use_cores(count: int) -> None:
    """Sets the number of threads of this module and of torch, at least 1."""
    import torch  # takes longer than all else that the window needs to open, and only training needs it

    count = max(1, count)
    torch.set_num_threads(count)
    if count != _pool.count:
        _pool.resize(count)


def one_thread_for_blas() -> None:
    """Keeps matrix products on the thread that asks for them, in this process and in those it starts.

    Ours have long arrays of a few columns, which memory bounds. OpenBLAS' own threads then mostly wait in a loop, on
    cores that this module's threads need: a twelfth of a training's processor time on two cores. Whoever sets
    OPENBLAS_NUM_THREADS has another number.
    """
    if "OPENBLAS_NUM_THREADS" not in os.environ:
        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # for libraries that are loaded from now on
        threadpool_limits(1, "blas")


@contextmanager
def one_thread_for_torch() -> Iterator[None]:
    """Keeps torch's operations in this block on the thread that asks for them, as this module's threads need all cores;
    afterwards torch has as many threads as before."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def for_each(kernel: Callable[..., Any], count: int, *args: Any) -> None:
    """Runs kernel(i, *args) for every i in 0..count-1, spread over the cores; returns when all are done.

    The kernel must release the interpreter lock (`nogil=True`) to gain from it, and its calls must not depend on each
    other. An error is raised once all have ended. If other threads are using the cores, the calling one works alone.
    """
    loop = _Loop(kernel, count, args)
    if min(_pool.count, count) > 1 and _pool.is_free() and (team := _pool.team()).busy.acquire(blocking=False):
        try:
            team.run(loop)
        finally:
            team.busy.release()
    else:
        loop.work()
    if loop.error is not None:
        raise loop.error


def for_spans(kernel: Callable[..., Any], count: int, *args: Any, span: int = SPAN) -> None:
    """Runs kernel(start, stop, *args) on spans of the rows 0..count-1, as `for_each` does.

    Raises what the kernel raises.
    """

    def run(index: int, *args: Any) -> None:
        kernel(index * span, min((index + 1) * span, count), *args)

    for_each(run, math.ceil(count / span), *args)


def side_by_side(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """The function's results for all items, in order, by as many threads as there are cores.

    For functions of large arrays, which spend most of their time in NumPy, SciPy or OpenCV without the interpreter
    lock. Raises the error of the first item that has one.
    """
    if min(len(items), _pool.count) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(_pool.count) as pool:
        return list(pool.map(partial(_pool.run_apart, function), items))


def _read(typingctx, board, place):
    """A number of an int64 array as it is in memory now, after a pause that lets the core's other thread go on."""

    def codegen(context, builder, sig, values):
        array = context.make_array(sig.args[0])(context, builder, values[0])
        if IS_X86:
            pause = builder.module.declare_intrinsic("llvm.x86.sse2.pause", (), ir.FunctionType(ir.VoidType(), ()))
            builder.call(pause, ())
        return builder.load_atomic(builder.gep(array.data, [values[1]]), ordering="acquire", align=8)

    return types.int64(board, place), codegen


_look: Any = intrinsic(_read)


@njit(cache=True, nogil=True)
def becomes(board, place, value, equal, looks, settle):
    """Whether board[place] comes to equal `value` (or to differ from it) within so many looks; then some pauses."""
    for _ in range(looks):
        if (_look(board, place) == value) == equal:
            for _ in range(settle):
                _look(board, place)
            return True
    return False
