"""Runs the commands: each ends with its result, or with one line that says why not, and an exit status."""

from __future__ import annotations

import gc
import math
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn, TextIO

import typer

from engine.errors import InputError, one_line
from engine.io.files import reason
from engine.scene.plane import Plane
from engine.threads import one_thread_for_blas

__all__ = [
    "FAILED",
    "REFUSED",
    "Stop",
    "Stopped",
    "parse_numbers",
    "parse_plane",
    "parse_rgb",
    "print_result",
    "run_command",
]

FAILED, REFUSED, SIGNALLED = 1, 2, 128
"""Exit statuses: part of the work or the machine failed; the input is bad or the result cannot be written; the user
stopped it, plus the signal's number as in shells: 130 for Ctrl-C, 143 for SIGTERM."""


class Stopped(BaseException):
    """The user stopped the command. No Exception, like KeyboardInterrupt, so that error handlers do not catch it."""

    def __init__(self, number: int, message: str = "") -> None:
        super().__init__(message)
        self.number = number
        """Number of the signal."""


class Stop:
    """Records a request to stop, by Ctrl-C or SIGTERM; a second Ctrl-C stops at once."""

    def __init__(self) -> None:
        self.number = 0
        """Number of the signal; 0 before any."""

    def requested(self) -> bool:
        """Whether the user wants to stop."""
        return self.number != 0

    def listen(self) -> None:
        """Installs the handlers: from now on signals are recorded instead of ending the command anywhere."""
        signal.signal(signal.SIGINT, self._on_signal)
        signal.signal(signal.SIGTERM, self._on_signal)

    def _on_signal(self, number: int, _: Any) -> None:
        if self.number == signal.SIGINT == number:
            raise Stopped(number)
        self.number = number


def print_result(text: str) -> None:
    """Prints the result of a successful command. Raises InputError if it cannot be written."""
    try:
        print(text, flush=True)
    except OSError as error:
        raise InputError(f"standard output: cannot be written ({reason(error)})") from error


def parse_numbers(text: str, count: int, complaint: str) -> list[float]:
    """`count` finite numbers separated by commas. Raises InputError with the complaint for anything else."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(complaint) from error
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise InputError(complaint)
    return numbers


def parse_rgb(text: str, complaint: str) -> tuple[int, int, int]:
    """The colour #rrggbb, range [0, 255]. Raises InputError with the complaint for anything else."""
    if not re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        raise InputError(complaint)
    r, g, b = bytes.fromhex(text[1:])
    return r, g, b


def parse_plane(text: str) -> Plane:
    """The plane a,b,c,d of a --plane. Raises InputError for anything else."""
    a, b, c, d = parse_numbers(text, 4, f"--plane {text}: give four numbers a,b,c,d")
    return Plane.of((a, b, c), d)


def run_command(
    name: str,
    command: Callable[..., None],
    arguments: list[str] | None = None,
    epilog: str | None = None,
    stopped: str = "stopped",
) -> NoReturn:
    """Runs a command with `arguments`, by default those of the program, and exits.

    `stopped` is the message for a stop by the user, unless the command gives one.
    """
    one_thread_for_blas()
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command(epilog=epilog)(command)
    status, line = 0, ""
    try:
        with _signals_raise():
            app(arguments, prog_name=name)
    except SystemExit as ended:  # typer always ends with one
        status = ended.code if isinstance(ended.code, int) else 0
    except InputError as error:
        status, line = REFUSED, str(error)
    except Stopped as error:
        status, line = SIGNALLED + error.number, str(error) or stopped
    except MemoryError:
        status, line = FAILED, "not enough memory; close other programs, or ask for less detail"
    except OSError as error:
        where = "" if error.filename is None else f"{error.filename}: "
        status, line = FAILED, where + reason(error)
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:  # the output was not written
        _discard(sys.stdout)
        if not status:
            status, line = REFUSED, f"standard output: cannot be written ({reason(error)})"
    if line and sys.stderr is not None:
        try:
            print(f"{name}: {one_line(line)}", file=sys.stderr, flush=True)
        except OSError:
            _discard(sys.stderr)
    gc.freeze()  # a search for cycles in all that was imported takes longer than many commands
    sys.exit(status)


@contextmanager
def _signals_raise() -> Iterator[None]:
    """Makes Ctrl-C and SIGTERM raise Stopped in this block, so that unfinished work is cleaned up."""

    def stop(number: int, _: Any) -> None:
        raise Stopped(number)

    before = [(number, signal.signal(number, stop)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def _discard(stream: TextIO) -> None:
    """Discards what a stream still buffers: Python would try to write it again at exit, and complain."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
