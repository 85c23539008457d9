"""Undo and redo over immutable states: going back is exact, and unchanged parts of the states are shared in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from app.translation import _

__all__ = ["Entry", "History"]

T = TypeVar("T")


@dataclass(frozen=True)
class Entry(Generic[T]):
    """A state, and the name of the change that led to it."""

    name: str
    state: T
    merge: str = ""
    """Tag: consecutive changes with the same non-empty tag are one step, as while a slider is dragged."""


class History(Generic[T]):
    """A list of states with a cursor, of unlimited length."""

    def __init__(self, state: T) -> None:
        self.entries: list[Entry[T]] = [Entry(_("Open"), state)]
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

    def do(self, name: str, state: T, merge: str = "") -> bool:
        """Adds a state after the cursor, which drops the undone ones; False if it equals the current state."""
        if state == self.state:
            return False
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
        """Ends a series of merged changes, so that the next change is a new step."""
        last = self.entries[self.cursor]
        self.entries[self.cursor] = Entry(last.name, last.state)

    def undo(self) -> bool:
        """One step back; False at the beginning."""
        return self.jump(self.cursor - 1)

    def redo(self) -> bool:
        """One step forward; False at the end."""
        return self.jump(self.cursor + 1)

    def jump(self, index: int) -> bool:
        """Moves the cursor to an entry; False if there is no such entry, or if the cursor is there already."""
        if not 0 <= index < len(self.entries) or index == self.cursor:
            return False
        self.settle()
        self.cursor = index
        return True
