"""How every command ends: with its result, or with one line that says why not, and a status."""

from __future__ import annotations

import math
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn, TextIO

import typer

from engine.errors import InputError, one_line
from engine.io.files import reason

__all__ = ["FAILED", "REFUSED", "Stop", "Stopped", "parse_numbers", "run_command", "tell"]

FAILED, REFUSED, SIGNALLED = 1, 2, 128
"""Exit status where a part of the work or the machine failed, where the input is bad or its result cannot be written,
and, with the signal's number added as shells do, where the user stopped: 130 for Ctrl-C, 143 for SIGTERM."""


class Stopped(BaseException):
    """The user stops the command. No Exception, as KeyboardInterrupt is none: nothing that mends errors may take it."""

    def __init__(self, number: int, message: str = "") -> None:
        super().__init__(message)
        self.number = number
        """Of the signal."""


class Stop:
    """Remembers that the user asked to stop, by Ctrl-C or SIGTERM; a second Ctrl-C stops at once."""

    def __init__(self) -> None:
        self.number = 0
        """Of the signal; 0: none came."""

    def asked(self) -> bool:
        """Whether to stop."""
        return self.number != 0

    def listen(self) -> None:
        """From now on signals are remembered instead of ending the command between two lines."""
        signal.signal(signal.SIGINT, self._notice)
        signal.signal(signal.SIGTERM, self._notice)

    def _notice(self, number: int, _: Any) -> None:
        if self.number == signal.SIGINT == number:
            raise Stopped(number)
        self.number = number


def tell(text: str) -> None:
    """Prints what a command has to say when all went well. Raises InputError where that cannot be written."""
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


def run_command(
    name: str,
    command: Callable[..., None],
    arguments: list[str] | None = None,
    epilog: str | None = None,
    stopped: str = "stopped",
) -> NoReturn:
    """Runs a command with the arguments given to the program, or these, and ends the program.

    `stopped` is what the user reads who stopped it, where the command says nothing better.
    """
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command(epilog=epilog)(command)
    status, line = 0, ""
    try:
        with _raised():
            app(arguments, prog_name=name)
    except SystemExit as ended:  # as typer ends, whatever comes of it
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
    except OSError as error:  # what was printed did not get there
        _let_go(sys.stdout)
        if not status:
            status, line = REFUSED, f"standard output: cannot be written ({reason(error)})"
    if line and sys.stderr is not None:
        try:
            print(f"{name}: {one_line(line)}", file=sys.stderr, flush=True)
        except OSError:
            _let_go(sys.stderr)
    sys.exit(status)


@contextmanager
def _raised() -> Iterator[None]:
    """Ctrl-C and SIGTERM raise Stopped in this block, so that whatever is half done is cleared away."""

    def stop(number: int, _: Any) -> None:
        raise Stopped(number)

    before = [(number, signal.signal(number, stop)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def _let_go(stream: TextIO) -> None:
    """What a stream still holds goes nowhere: Python would try once more at its end, and complain."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
