"""The GL engine: opaque atoms with exact cuts, and the capture as it came, in OpenGL 3.3 core."""

from engine.gl.context import GLMissing
from engine.gl.look import Mode
from engine.gl.overlay import Lines, Sheet
from engine.gl.renderer import Renderer

__all__ = ["GLMissing", "Lines", "Mode", "Renderer", "Sheet"]
