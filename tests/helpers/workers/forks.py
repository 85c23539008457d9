"""Processes that begin as forks of one that has imported all they need, for a process that has threads and may not fork
by itself. For Linux."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
from collections.abc import Callable
from contextlib import suppress

__all__ = ["Fork", "Forks"]


class Forks:
    """Starts `main` in new processes. Made before there are threads; imports nothing later."""

    def __init__(self, main: Callable[[], object]) -> None:
        self._ask, answer = socket.socketpair()
        if not os.fork():
            self._ask.close()
            _serve(answer, main)
        answer.close()

    def start(self, *_: object, **__: object) -> Fork:
        """As Popen with all three pipes."""
        (read, stdin), (stdout, write), (stderr, write_errors) = (os.pipe() for _ in range(3))
        socket.send_fds(self._ask, [b"."], [read, write, write_errors])
        pid = int.from_bytes(self._ask.recv(8), "little")
        for end in (read, write, write_errors):
            os.close(end)
        return Fork(pid, stdin, stdout, stderr)


class Fork:
    """One of these processes: what is used of subprocess.Popen."""

    def __init__(self, pid: int, stdin: int, stdout: int, stderr: int) -> None:
        self.stdin, self.stdout, self.stderr = os.fdopen(stdin, "wb"), os.fdopen(stdout, "rb"), os.fdopen(stderr, "rb")
        self._handle: int | None = None
        with suppress(ProcessLookupError):  # it has ended already
            self._handle = os.pidfd_open(pid)

    def kill(self) -> None:
        if self._handle is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._handle, signal.SIGKILL)

    def wait(self) -> None:
        if self._handle is not None:
            select.select([self._handle], [], [])


def _serve(asked: socket.socket, main: Callable[[], object]) -> None:
    """Forks whenever it is asked to, until nobody can ask any more; never returns."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the forks
    while True:
        message, ends, *_ = socket.recv_fds(asked, 1, 3)
        if not message:
            os._exit(0)
        child = os.fork()
        if not child:
            break
        for end in ends:
            os.close(end)
        asked.send(child.to_bytes(8, "little"))
    asked.close()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    for stream, end in enumerate(ends):
        os.dup2(end, stream)
        os.close(end)
    main()
    sys.exit()
