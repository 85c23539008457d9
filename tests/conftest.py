"""Fixtures that several topics share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from engine.render.gl import GLMissing, Renderer


@pytest.fixture(scope="session")
def offscreen() -> Iterator[Renderer]:
    """The renderer of all tests: compiling its shaders takes longer than drawing."""
    try:
        renderer = Renderer()
    except GLMissing as missing:
        pytest.skip(str(missing))
    yield renderer
    renderer.release()


@pytest.fixture
def renderer(offscreen: Renderer) -> Iterator[Renderer]:
    """The renderer, with no GL error before the test and none after it."""
    assert offscreen.ctx.error == "GL_NO_ERROR"
    yield offscreen
    assert offscreen.ctx.error == "GL_NO_ERROR"
