"""Which grids of cut planes are kept from frame to frame."""

from __future__ import annotations

import pytest

from engine.render.culling import grid_cache
from engine.render.culling.grid_cache import GridCache, GridKey

FIRST, SECOND, THIRD = (1.0,), (2.0,), (3.0,)


class Sizes:
    """A cache whose grids are their own sizes in bytes; records which are made and released."""

    def __init__(self) -> None:
        self.made: list[int] = []
        self.released: list[int] = []
        self.cache = GridCache[int](lambda size: size, self.released.append)

    def get(self, key: GridKey, size: int | None, at_once: bool = True) -> int | None:
        return self.cache.get(key, lambda: self.made.append(size or 0) or size, at_once)


def test_a_grid_is_made_once() -> None:
    sizes = Sizes()
    assert [sizes.get(FIRST, 1), sizes.get(SECOND, None)] == [1, None]
    sizes.cache.begin()
    assert [sizes.get(FIRST, 5), sizes.get(SECOND, 5)] == [1, None]
    assert sizes.made == [1, 0]


def test_a_grid_that_is_not_needed_at_once_waits_for_the_second_frame_in_a_row() -> None:
    sizes = Sizes()
    assert sizes.get(FIRST, 1, at_once=False) is None
    assert sizes.get(FIRST, 1, at_once=False) is None  # by the other piece at the plane
    sizes.cache.begin()
    sizes.cache.begin()
    assert sizes.get(FIRST, 1, at_once=False) is None
    sizes.cache.begin()
    assert sizes.get(FIRST, 1, at_once=False) == 1


def test_the_least_recently_used_goes_first_and_nothing_of_the_last_two_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grid_cache, "CACHE_BYTES", 10)
    sizes = Sizes()
    sizes.get(FIRST, 6)
    sizes.get(SECOND, 6)
    sizes.cache.begin()
    sizes.get(THIRD, 6)
    assert sizes.released == []
    sizes.cache.begin()
    sizes.get(THIRD, 6)
    assert sizes.released == [6, 6] and sizes.made == [6, 6, 6]
    sizes.cache.clear()
    assert sizes.released == [6, 6, 6]
