"""GLSL 3.30 core sources, loaded by the GL engine as package data."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files

from engine import formula

__all__ = ["source"]

INCLUDE = re.compile(r'^#include "([\w.]+)"$', re.MULTILINE)


def source(name: str, defines: Mapping[str, int] | None = None) -> str:
    """The GLSL of a file of this package, ready to compile.

    In front stand the version, the numbers of the opaque formula under their own names, and `defines`. `#include "x"`
    pulls in another file of the package.
    """
    constants = [f"#define {key} {float(getattr(formula, key))!r}" for key in formula.__all__]
    given = [f"#define {key} {value}" for key, value in (defines or {}).items()]
    return "\n".join(["#version 330 core", *constants, *given, _text(name)])


def _text(name: str) -> str:
    text = files(__package__).joinpath(name).read_text(encoding="utf-8")
    return INCLUDE.sub(lambda match: _text(match[1]), text)
