"""The GL engine: opaque atoms with exact cuts, and the unchanged capture, in OpenGL 3.3 core."""

from engine.render.culling.draw_options import Mode
from engine.render.gl.context import GLMissing
from engine.render.gl.overlay import Lines, PictureSheet, Sheet
from engine.render.gl.renderer import Renderer

__all__ = ["GLMissing", "Lines", "Mode", "PictureSheet", "Renderer", "Sheet"]
