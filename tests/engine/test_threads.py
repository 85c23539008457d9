"""Loops over cores: everything is done once, whoever calls, whatever fails, with any number of threads."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from engine.threads import cores, for_each, for_spans, side_by_side, use_cores


@pytest.fixture(autouse=True)
def same_cores() -> Iterator[None]:
    before = cores()
    yield
    use_cores(before)


def mark(i: int, array: np.ndarray) -> None:
    array[i] += 1


def slow_mark(i: int, array: np.ndarray) -> None:
    time.sleep(1e-4)
    array[i] += 1


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_everything_is_done_once(threads: int) -> None:
    use_cores(threads)
    for count in (0, 1, 2, 7, 100):
        for kernel in (mark, slow_mark):
            done = np.zeros(count, int)
            for_each(kernel, count, done)
            assert (done == 1).all()


@pytest.mark.parametrize("threads", [1, 3])
def test_spans_are_every_row_once_and_none_beyond(threads: int) -> None:
    use_cores(threads)
    for count in (0, 1, 7, 8, 9, 100):
        done = np.zeros(count + 8, int)

        def mark_span(start: int, stop: int, array: np.ndarray) -> None:
            assert 0 < stop - start <= 8
            array[start:stop] += 1

        for_spans(mark_span, count, done, span=8)
        assert (done[:count] == 1).all() and not done[count:].any()


@pytest.mark.parametrize("threads", [1, 3])
def test_results_of_functions_side_by_side_are_in_order_and_the_first_error_is_raised(threads: int) -> None:
    use_cores(threads)

    def inverse(number: int) -> float:
        time.sleep(0.002 * (number % 3))
        total = np.zeros(10)
        for_each(mark, 10, total)  # kernels may be called from each of them
        return float(total.sum()) / (10 * number)

    assert side_by_side(inverse, []) == []
    assert side_by_side(inverse, range(1, 9)) == [1 / n for n in range(1, 9)]
    with pytest.raises(ZeroDivisionError):
        side_by_side(inverse, range(-4, 4))


def test_loops_of_functions_side_by_side_stay_on_their_own_threads() -> None:
    use_cores(2)
    both_began = threading.Barrier(2)

    def threads_of_a_loop() -> set[int]:
        seen = set[int]()

        def kernel(i: int) -> None:
            seen.add(threading.get_ident())
            time.sleep(1e-3)

        for_each(kernel, 100)
        return seen

    def loop(_: int) -> bool:
        both_began.wait(60)
        alone = threads_of_a_loop() == {threading.get_ident()}
        both_began.wait(60)
        return alone

    assert side_by_side(loop, range(2)) == [True, True]
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda n: 1 // n, range(2))
    assert len(threads_of_a_loop()) == 2


def test_a_helper_takes_part_and_sleeps_when_there_is_nothing_to_do() -> None:
    use_cores(2)
    who = set()

    def note(_: int) -> None:
        time.sleep(1e-3)
        who.add(threading.get_ident())

    for_each(note, 20)
    assert len(who) == 2
    time.sleep(0.05)
    before = time.process_time()
    time.sleep(0.2)
    assert time.process_time() - before < 0.1
    who.clear()
    for_each(note, 20)  # the helper wakes up again
    assert len(who) == 2


def test_an_error_is_raised_once_all_have_ended() -> None:
    use_cores(3)
    running = []

    def fail(i: int) -> None:
        running.append(i)
        time.sleep(0.01 * i)
        running.remove(i)
        if i == 0:
            raise ValueError("task 0")

    with pytest.raises(ValueError, match="task 0"):
        for_each(fail, 3)
    assert not running
    done = np.zeros(50, int)
    for_each(slow_mark, 50, done)
    assert (done == 1).all()


def test_many_threads_call_at_once() -> None:
    use_cores(3)
    arrays = [np.zeros(40, int) for _ in range(6)]

    def call(array: np.ndarray) -> None:
        for _ in range(25):
            for_each(mark, 40, array)

    callers = [threading.Thread(target=call, args=(array,)) for array in arrays]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(20)
    assert all((array == 25).all() for array in arrays)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_child_has_threads_of_its_own() -> None:
    use_cores(2)
    for_each(slow_mark, 10, np.zeros(10, int))
    child = os.fork()
    if child == 0:
        done = np.zeros(10, int)
        for_each(slow_mark, 10, done)
        os._exit(int(done.sum()))
    for _ in range(200):
        gone, status = os.waitpid(child, os.WNOHANG)
        if gone:
            break
        time.sleep(0.05)
    else:
        os.kill(child, 9)
        pytest.fail("the child hangs")
    assert os.waitstatus_to_exitcode(status) == 10


def test_the_window_opens_without_torch() -> None:
    """Importing torch takes as long as importing all the rest."""
    code = "import sys, app.ui.window; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_matrix_product_stays_on_its_thread_unless_the_user_says_otherwise() -> None:
    program = (
        "import os, numpy, scipy.linalg\n"
        "from threadpoolctl import threadpool_info\n"
        "from engine.threads import one_thread_for_blas\n"
        "one_thread_for_blas()\n"
        "print(*(pool['num_threads'] for pool in threadpool_info() if pool['user_api'] == 'blas'))\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    counts = {}
    for wish in (None, "2"):
        environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
        environment |= {"OPENBLAS_NUM_THREADS": wish} if wish else {}
        run = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
        )
        counts[wish] = set(run.stdout.split())
    assert counts[None] == {"1"}
    assert "2" in counts["2"]
