"""Undo and redo over immutable states: going back is exact, and unchanged parts of the states are shared in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

__all__ = ["Entry", "History"]

T = TypeVar("T")


@dataclass(frozen=True)
class Entry(Generic[T]):
    """A state, and the name of the change that led to it."""

    name: str
    state: T
    merge: str = ""
    """Consecutive changes with the same non-empty tag are one step, as while a slider is dragged."""


class History(Generic[T]):
    """A list of states with a cursor, of unlimited length."""

    def __init__(self, state: T, name: str = "Open") -> None:
        self.entries: list[Entry[T]] = [Entry(name, state)]
        self.cursor = 0
        self.saved: T | None = state

    @property
    def state(self) -> T:
        """The state at the cursor."""
        return self.entries[self.cursor].state

    @property
    def changed(self) -> bool:
        """Whether the state differs from the saved one."""
        return self.state != self.saved

    def do(self, name: str, state: T, merge: str = "", apply: Callable[[T], None] | None = None) -> bool:
        """Adds a state after the cursor, which drops the undone ones; False if it equals the current state.

        `apply` is called with the new state first; if it raises, nothing changes.
        """
        if state == self.state:
            return False
        if apply is not None:
            apply(state)
        del self.entries[self.cursor + 1 :]
        last = self.entries[self.cursor]
        if merge and merge == last.merge:
            self.entries[self.cursor] = Entry(name, state, merge)
            if self.entries[self.cursor - 1].state == state:  # dragged back to where it began
                del self.entries[self.cursor]
                self.cursor -= 1
            return True
        self.entries.append(Entry(name, state, merge))
        self.cursor += 1
        return True

    def settle(self) -> None:
        """Ends a series of merged changes: the next change is a new step."""
        last = self.entries[self.cursor]
        self.entries[self.cursor] = Entry(last.name, last.state)

    def undo(self, apply: Callable[[T], None] | None = None) -> bool:
        """One step back; False at the beginning."""
        return self.jump(self.cursor - 1, apply)

    def redo(self, apply: Callable[[T], None] | None = None) -> bool:
        """One step forward; False at the end."""
        return self.jump(self.cursor + 1, apply)

    def jump(self, index: int, apply: Callable[[T], None] | None = None) -> bool:
        """To any entry; the cursor moves after `apply` has accepted the state. False if it cannot move there."""
        if not 0 <= index < len(self.entries) or index == self.cursor:
            return False
        if apply is not None:
            apply(self.entries[index].state)
        self.settle()
        self.cursor = index
        return True
