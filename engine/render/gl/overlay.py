"""Lines, sheets and pictures over a frame, hidden by the object where it is in front: knives, planes, gizmos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.culling.view import View
from engine.render.gl.batches import CORNERS
from engine.render.gl.context import Growing, Programs, layout, write_uniforms

__all__ = ["Lines", "Overlay", "OverlayPass", "PictureSheet", "Sheet"]

Float = NDArray[np.floating]
Rgba = tuple[float, float, float, float]


@dataclass(frozen=True)
class Lines:
    """Straight lines of one colour."""

    ends: Float
    """(L, 2, 3). World units."""
    rgba: Rgba
    """Range [0, 1], straight alpha."""
    width: float = 1.5
    """Pixels."""
    hidden: float = 0.25
    """Fraction of the opacity that remains where the object is in front. Range [0, 1]."""


@dataclass(frozen=True)
class Sheet:
    """A flat convex polygon, such as a cut plane within the object's box."""

    corners: Float
    """(V, 3). World units, in order."""
    rgba: Rgba
    """Range [0, 1], straight alpha."""
    hidden: float = 0.4
    """Fraction of the opacity that remains where the object is in front. Range [0, 1]."""


@dataclass(frozen=True, eq=False)
class PictureSheet:
    """A picture on a flat quadrangle, such as a cut face."""

    corners: Float
    """(4, 3). World units: the picture's top left, top right, bottom right and bottom left."""
    rgba: NDArray[np.uint8]
    """(H, W, 4). Straight alpha."""
    hidden: float = 0.0
    """Fraction of the opacity that remains where the object is in front. Range [0, 1]."""


Overlay = Lines | Sheet | PictureSheet

PLACES = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
"""Texture coordinates of a sheet's corners in its picture."""


class OverlayPass:
    """Draws overlays into a framebuffer."""

    def __init__(self, ctx: moderngl.Context, programs: Programs) -> None:
        self.ctx, self.programs = ctx, programs
        self.vertices = Growing(ctx)
        self.corners = ctx.buffer(CORNERS)

    def draw(self, view: View, items: Sequence[Overlay], info: moderngl.Texture, tolerance: float) -> None:
        """Draws over the bound framebuffer: pictures, then sheets, farthest first, then lines, in their order.

        tolerance: world units by which the object must be in front to hide something.
        """
        self.ctx.enable_only(moderngl.BLEND)
        # The frame stays opaque.
        factors: Any = (moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA, moderngl.ZERO, moderngl.ONE)
        self.ctx.blend_func = factors
        common = {**view.uniforms, "info@0": info, "tolerance": tolerance}
        for item in items:
            if isinstance(item, PictureSheet):
                self._draw_picture(view, item, common)
        sheets = [item for item in items if isinstance(item, Sheet) and len(item.corners) >= 3]
        sheets.sort(key=lambda sheet: -float((sheet.corners - view.centre).mean(0) @ view.matrix[2, :3]))
        for sheet in sheets:
            self._write(sheet.corners - view.centre, sheet.rgba)
            values = {**common, "hidden": sheet.hidden, "width": 0.0}
            self._draw(view, values, {"position": 3, "rgba": 4}, len(sheet.corners), line=False)
        for item in items:
            if isinstance(item, Lines) and len(item.ends):
                self._write((item.ends - view.centre).reshape(-1, 6), item.rgba)
                values = {**common, "hidden": item.hidden, "width": item.width}
                self._draw(view, values, {"start": 3, "end": 3, "rgba": 4}, len(item.ends), line=True)

    def _draw_picture(self, view: View, item: PictureSheet, common: dict[str, Any]) -> None:
        height, width = item.rgba.shape[:2]
        texture = self.ctx.texture((width, height), 4, np.ascontiguousarray(item.rgba).tobytes())
        texture.repeat_x = texture.repeat_y = False
        self.vertices.write(np.concatenate([item.corners - view.centre, PLACES], 1).astype(np.float32))
        values = {**common, "picture@1": texture, "hidden": item.hidden, "width": 0.0}
        self._draw(view, values, {"position": 3, "place": 2}, len(PLACES), line=False, picture=True)
        texture.release()

    def _write(self, rows: Float, rgba: Rgba) -> None:
        colours = np.tile(np.asarray(rgba), (len(rows), 1))
        self.vertices.write(np.concatenate([rows, colours], 1).astype(np.float32))

    def _draw(
        self,
        view: View,
        values: dict[str, Any],
        fields: dict[str, int],
        count: int,
        line: bool,
        picture: bool = False,
    ) -> None:
        defines = {"LINE": int(line), "PICTURE": int(picture), "ORTHOGRAPHIC": int(view.camera.orthographic)}
        program = self.programs.get("overlay.vert.glsl", "overlay.frag.glsl", defines)
        write_uniforms(program, values)
        content: list[Any] = [layout(program, self.vertices.buffer, fields, instanced=line)]
        if line:
            content.append((self.corners, "2f", "corner"))
        array = self.ctx.vertex_array(program, content)
        if line:
            array.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)
        else:
            array.render(moderngl.TRIANGLE_FAN, vertices=count)
        array.release()

    def release(self) -> None:
        """Frees the buffers."""
        self.vertices.release()
        self.corners.release()
