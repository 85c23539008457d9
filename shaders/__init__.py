"""GLSL 3.30 core sources, loaded by the GL engine as package data. Knows nothing of the engine."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files

__all__ = ["source", "text"]

INCLUDE = re.compile(r'^#include "([\w.]+)"$', re.MULTILINE)


def source(name: str, defines: Mapping[str, int | float]) -> str:
    """The GLSL of a file of this package, ready to compile.

    The version and the defines come first: integers as switches and sizes, floats as constants. `#include "x"` inserts
    another file of the package.
    """
    given = [f"#define {key} {value!r}" for key, value in defines.items()]
    return "\n".join(["#version 330 core", *given, text(name)])


def text(name: str) -> str:
    """The GLSL of a file of this package with its includes, without a version."""
    glsl = files(__package__).joinpath(name).read_text(encoding="utf-8")
    return INCLUDE.sub(lambda match: text(match[1]), glsl)
