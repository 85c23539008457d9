"""Where tasks run: workers on this machine, or a Dask cluster that runs already."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from multiprocessing import resource_tracker
from typing import Any

import dask
import psutil
from distributed import Client, LocalCluster, Worker, WorkerPlugin

from engine.errors import InputError
from engine.io.scratch import Scratch
from engine.processes import safe_imports

__all__ = ["blocked_signals", "cluster_client"]

WAIT_SECONDS = 30
"""For a scheduler to answer and for its first worker."""


@contextmanager
def cluster_client(scheduler: str | None, count: int | None, tasks: int, gigabytes: float) -> Iterator[Client]:
    """A client of the cluster at an address, or of one of its own on this machine, which ends with the block.

    Its own has `count` workers, or as many as there are cores, memory for `gigabytes` each, and tasks. Every worker
    does one task at a time, in a process of its own, on its share of the cores. Raises InputError where the address
    does not answer, has no workers, or its workers would do several tasks in one process.
    """
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what fails is told by the grid, in one line
    if scheduler is not None:
        with _running_cluster(scheduler) as client:
            yield client
        return
    count = count or local_worker_count(tasks, gigabytes)
    settings: dict[str, Any] = {
        # Dask's own retries know nothing of checkpoints; the grid counts for itself.
        "distributed.scheduler.allowed-failures": 0,
        "distributed.comm.timeouts.connect": f"{WAIT_SECONDS}s",
        # No pages about the cluster, whatever the user's own settings of Dask say; `_CloseHttpServer` does the rest.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    # Workers import from their folder: it is a private one, not the one in the temporary folder that all users share.
    with dask.config.set(settings), safe_imports(), closing(Scratch("fruitninja-")) as scratch:
        with blocked_signals(signal.SIGINT):
            cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address=None,
                local_directory=str(scratch.path),
                memory_limit=0,  # no spilling to disk, and no nanny that kills a worker whose scene is large
                silence_logs=logging.CRITICAL,
            )
        with cluster, Client(cluster) as client:
            client.run_on_scheduler(_close_http_server)
            client.register_plugin(_CloseHttpServer())
            yield client


def _close_http_server(dask_scheduler: Any) -> None:
    """Dask opens a port for web pages even where it is told to have none."""
    dask_scheduler.http_server.stop()


class _CloseHttpServer(WorkerPlugin):
    """Closes such a port of every worker, also of one that takes the place of another."""

    def setup(self, worker: Worker) -> None:
        worker.http_server.stop()


@contextmanager
def blocked_signals(*signals: signal.Signals) -> Iterator[None]:
    """Threads that begin in this block, and the processes they start whenever they do, do not hear these signals.

    They are for the command, which then tells its workers, and which hears them once the block has ended. A signal
    mask reaches a process before its first line does.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its start would lift the mask again
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, signals)


def local_worker_count(tasks: int, gigabytes: float) -> int:
    """Workers on this machine: no more than cores, than memory that is free holds, or than tasks; at least 1."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    fits_memory = int(psutil.virtual_memory().available / 2**30 / gigabytes)
    return max(1, min(cores, fits_memory, tasks))


@contextmanager
def _running_cluster(address: str) -> Iterator[Client]:
    """A client of a running cluster."""
    try:
        client = Client(address, timeout=WAIT_SECONDS)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there; start one with: dask scheduler"
        ) from (error)
    with client:
        try:
            client.wait_for_workers(1, timeout=WAIT_SECONDS)
        except TimeoutError as error:
            raise InputError(f"{address}: it has no workers; start some: dask worker {address} --nthreads 1") from error
        if max(client.nthreads().values()) > 1:
            raise InputError(f"{address}: its workers do several tasks in one process; start them with --nthreads 1")
        yield client
