"""The photographs of fruit that lie beside the repository, as the tests of several modules read them."""

from __future__ import annotations

from functools import cache

import pytest

from tests.paths import SHARED
from training.priors.exemplar.pictures import read_picture
from training.priors.exemplar.quilting.disc import Disc

__all__ = ["photograph"]


@cache
def photograph(name: str) -> Disc:
    """One of them, whose name tells the kind of cut; skips where there are none."""
    path = SHARED / "photos/fruit" / f"{name}.png"
    if not path.exists():
        pytest.skip("the photographs are not beside the repository")
    return Disc.of(read_picture(path, "horizontal" if "_h" in name else "radial"))
