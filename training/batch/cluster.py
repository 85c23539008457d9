"""Workers for tasks: a local Dask cluster, or one that is already running."""

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

__all__ = ["cluster_client", "deferred_signals"]

WAIT_SECONDS = 30
"""Timeout in seconds for a scheduler to answer and for its first worker."""


@contextmanager
def cluster_client(scheduler: str | None, count: int | None, tasks: int, gigabytes: float) -> Iterator[Client]:
    """A client of the cluster at an address, or of a local one that is closed with the context.

    A local cluster has `count` workers, or as many as cores, memory (`gigabytes` each) and tasks allow. Every worker is
    a process that runs one task at a time on its share of the cores. Raises InputError if the address does not answer,
    has no workers, or its workers would run several tasks in one process.
    """
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # the grid reports failures, in one line
    if scheduler is not None:
        with _running_cluster(scheduler) as client:
            yield client
        return
    count = count or local_worker_count(tasks, gigabytes)
    settings: dict[str, Any] = {
        # Dask's retries ignore checkpoints; the grid counts attempts itself.
        "distributed.scheduler.allowed-failures": 0,
        "distributed.comm.timeouts.connect": f"{WAIT_SECONDS}s",
        # No web pages, whatever the user's Dask configuration says; `_CloseHttpServer` closes their port.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    # Workers import from their folder, so it must be private, unlike the shared temporary folder.
    with dask.config.set(settings), safe_imports(), closing(Scratch("fruitninja-")) as scratch:
        with deferred_signals(signal.SIGINT):
            cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                host="127.0.0.1",
                # A free port: Dask takes 8787 otherwise, and warns if two batches begin at once.
                scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
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
    """Closes the port for web pages, which Dask opens even if there are none."""
    dask_scheduler.http_server.stop()


class _CloseHttpServer(WorkerPlugin):
    """Closes that port on every worker, including replacements."""

    def setup(self, worker: Worker) -> None:
        worker.http_server.stop()


@contextmanager
def deferred_signals(*signals: signal.Signals) -> Iterator[None]:
    """Defers signals to the end of this block; only in the main thread.

    Threads started in the block, and the processes that those start later, block them for good: only the command
    handles them, and then stops its workers. A child inherits the signal mask before it executes its first line.
    """
    received: list[int] = []
    # The mask alone defers nothing: a library's earlier thread may take the signal, and Python would run the handler
    # here, perhaps between the start of a child and the data that it waits for.
    handlers = [(each, signal.signal(each, lambda number, _: received.append(number))) for each in signals]
    has_mask = hasattr(signal, "pthread_sigmask")
    if has_mask:
        resource_tracker.ensure_running()  # starting it later would lift the mask
        signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        if has_mask:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, signals)
        for each, handler in handlers:
            signal.signal(each, handler)
        for number in received:
            signal.raise_signal(number)


def local_worker_count(tasks: int, gigabytes: float) -> int:
    """Number of local workers: limited by cores, free memory and tasks; at least 1."""
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
