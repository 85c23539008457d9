"""The real-time renderer: solids of atoms, cut into pieces, or a capture, drawn with OpenGL 3.3 into a texture.

Standalone (offscreen) or inside a window's context. If OpenGL runs in software, CPU kernels draw the solid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import wraps
from types import TracebackType
from typing import Any, TypeVar, cast

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.render.cpu.software import SoftwareMode, is_software
from engine.render.culling.draw_options import DrawOptions, Mode, SplatLook
from engine.render.culling.drawable import Drawable
from engine.render.culling.groups import Group, group_pieces
from engine.render.culling.view import View
from engine.render.gl.batches import Pool
from engine.render.gl.classic import Blending, Capture
from engine.render.gl.context import Programs, offscreen_context
from engine.render.gl.opaque import OpaqueMode
from engine.render.gl.overlay import Overlay, OverlayPass
from engine.render.gl.screen import Screen
from engine.render.gl.targets import Accumulators, Frame, Layers
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.constants import NOTHING
from engine.scene.gaussians import Gaussians
from engine.scene.image import Picture
from engine.scene.piece import Piece

__all__ = ["Renderer"]

WHOLE = (Piece(),)

AS_IT_IS = SplatLook()


Method = TypeVar("Method", bound=Callable[..., Any])


def current(method: Method) -> Method:
    """Makes the renderer's own context current, and leaves it so; other contexts may exist beside it.

    In a foreign context, the bound framebuffer is bound again afterwards, and the state that passes change is reset to
    OpenGL's initial state, except for straight-alpha blending: nothing enabled, depth test `<`.
    """

    @wraps(method)
    def call(self: Renderer, *arguments: Any, **named: Any) -> Any:
        if self._owns_context:
            self.ctx.__enter__()
            return method(self, *arguments, **named)
        bound = self.ctx.detect_framebuffer()
        try:
            return method(self, *arguments, **named)
        finally:
            bound.use()
            self.ctx.enable_only(moderngl.NOTHING)
            self.ctx.depth_func = "<"
            self.ctx.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA

    return cast(Method, call)


class Renderer:
    """Draws objects. Not thread-safe: all calls from the thread that owns the context.

    A foreign context keeps its bound framebuffer; everything it had enabled is disabled afterwards, see `current`.
    """

    def __init__(self, ctx: moderngl.Context | None = None, shaders: bool | None = None) -> None:
        """Uses a given context, or creates one without a window (raises context.GLMissing).

        shaders: whether GLSL or the CPU kernels draw the solid; None chooses the faster one, which is GLSL if there is
        a graphics card.
        """
        self._owns_context = ctx is None
        self.ctx = offscreen_context() if ctx is None else ctx
        self._programs = Programs(self.ctx)
        self._pool = Pool(self.ctx)
        self._screen = Screen(self.ctx, self._programs)
        self._opaque = OpaqueMode(self.ctx, self._programs, self._pool, self._screen)
        by_shaders = not is_software(self.ctx.info["GL_RENDERER"]) if shaders is None else shaders
        self._software = None if by_shaders else SoftwareMode()
        self._overlays = OverlayPass(self.ctx, self._programs)
        self._solids: list[Drawable] = []
        self._made_of: list[Atoms | None] = []
        """The atoms that each solid shows; None if it has been recoloured."""
        self._capture: Capture | None = None
        self._next_capture: Capture | None = None
        """The capture that is being uploaded."""
        self._gradual: Blending | None = None
        """A frame of the capture that is drawn part by part, in the layers."""
        self._frames: list[Frame] = []
        self._sums: Accumulators | None = None
        self._layers: Layers | None = None
        self._overlaid: Frame | None = None
        self._replaced: Frame | None = None
        """Other colours of the last frame, if `_is_replaced`."""
        self._is_replaced = False
        self._camera: Camera | None = None
        self._pieces: Sequence[Piece] = WHOLE
        self._groups: list[Group] = []

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    # Content

    @current
    def set_atoms(self, *atoms: Atoms | Drawable) -> None:
        """Sets the solids to draw: `Piece.solid` is an index into them. Those of atoms set before are reused.

        A `Drawable` may be made from its atoms beforehand, as in another thread: a million atoms take half a second.
        """
        known = {id(made_of): solid for made_of, solid in zip(self._made_of, self._solids, strict=True)}
        made_of = [one.atoms if isinstance(one, Drawable) else one for one in atoms]
        ready = [one if isinstance(one, Drawable) else None for one in atoms]
        solids = [known.get(id(one)) or made or Drawable(one) for one, made in zip(made_of, ready, strict=True)]
        self._release_solids()
        self._solids, self._made_of = solids, list(made_of)

    @current
    def set_capture(self, gaussians: Gaussians, seconds: float = math.inf) -> bool:
        """Sets the capture, which classic mode draws.

        Uploads it for at most about this time. False if there is more to upload: the previous capture is still drawn,
        and another call continues.
        """
        if self._next_capture is None or self._next_capture.gaussians is not gaussians:
            if self._next_capture is not None:
                self._next_capture.release()
            self._next_capture = Capture(self.ctx, self._programs, self._pool, gaussians)
        if not self._next_capture.upload(seconds):
            return False
        self._release_capture()
        self._capture, self._next_capture = self._next_capture, None
        return True

    @current
    def update_colours(
        self,
        sh: NDArray[np.float32] | None = None,  # [S, (d+1)^2, 3]
        rgb: NDArray[np.float32] | None = None,  # [I, 3]
        solid: int = 0,
    ) -> None:
        """Replaces the colours of a solid's surface or interior atoms (or both), in the order of `set_atoms`."""
        self._solids[solid].update(sh, rgb)
        self._made_of[solid] = None
        if rgb is not None:
            self._clear_grids()

    # Drawing

    @current
    def render(
        self,
        camera: Camera,
        pieces: Sequence[Piece] = WHOLE,
        mode: Mode = "opaque",
        background: ArrayLike = (1.0, 1.0, 1.0),
        light: bool = False,
        exact: bool = True,
        level: int = 0,
        cull: bool = True,
        wait: bool = True,
        look: SplatLook = AS_IT_IS,
    ) -> moderngl.Texture:
        """Draws a frame of the camera's size; the texture (top row first) lasts until the size changes.

        mode: classic shows the uncut capture; the others show the pieces of the solid. background: RGB. light: shade
        the cut faces slightly.

        While the camera moves: exact=False reads a face from a grid that is cached while its plane stays, and blends a
        capture in half floats on a graphics card; both are faster and have at least 50 dB. level=0 is full quality;
        each further level draws half as many atoms, enlarged. On the software path pixels cost more than atoms, and a
        smaller picture saves more.
        wait=False lets classic mode draw in the order of an earlier camera while a thread sorts, see `sorting`.
        cull=False draws every atom, to measure what culling saves. look: factors on the splats' sizes and opacities.

        Raises InputError if a piece has more than groups.MAX_PLANES planes that cut it.
        """
        assert mode in ("opaque", "classic", "interior"), mode
        self._gradual = None
        self._resize(camera.width, camera.height)
        self._is_replaced = False
        self._pool.begin()
        self._camera, self._pieces = camera, list(pieces)
        self._groups = group_pieces(self._pieces)
        background_rgb = np.asarray(background, np.float64)
        frame, sums = self._frames[0], self._sums
        assert sums is not None
        if self._software is not None and mode != "classic" and self._solids:
            options = DrawOptions(mode == "interior", light, exact, level, cull, look.size)
            changed, halves = self._software.draw(
                self._solids, camera, self._pieces, self._groups, background_rgb, options
            )
            if changed[2] and changed[3]:
                frame.colour.write(halves, viewport=changed)
            return frame.colour
        if self._software is not None:
            self._software.reset()
        frame.clear(background_rgb)
        if mode == "classic":
            if self._capture is not None:
                blending = self._blending(camera, exact, wait, level, look)
                blending.advance()
                blending.resolve(frame, background_rgb)
        elif self._solids:
            options = DrawOptions(mode == "interior", light, exact, level, cull, look.size)
            self._opaque.draw(
                self._solids, camera, self._pieces, self._groups, self._frames, sums, background_rgb, options
            )
        return frame.colour

    def _blending(self, camera: Camera, exact: bool, wait: bool, level: int, look: SplatLook) -> Blending:
        """A new frame of the capture, in the layers."""
        assert self._capture is not None, "no capture is set"
        size = camera.width, camera.height
        slabs = None if self._software is not None else "f4" if exact else "f2"
        if self._layers is not None and (self._layers.size, self._layers.slabs) != (size, slabs):
            self._layers.release()
            self._layers = None
        if self._layers is None:
            self._layers = Layers(self.ctx, *size, slabs)
        return Blending(self._capture, self._screen, self._layers, camera, wait, level, look)

    @current
    def refine(
        self, camera: Camera, background: ArrayLike, level: int, seconds: float, look: SplatLook = AS_IT_IS
    ) -> moderngl.Texture | None:
        """Draws more of a classic frame for about this time. Returns None until it is complete and replaces the last.

        The first call after any other frame begins it; arguments as in `render`. Until it is complete, the last frame
        can be shown, picked and overlaid.
        """
        if self._gradual is None:
            self._gradual = self._blending(camera, True, True, level, look)
        if not self._gradual.advance(seconds):
            return None
        blending, self._gradual = self._gradual, None
        self._resize(camera.width, camera.height)
        if self._software is not None:
            self._software.reset()
        frame = self._frames[0]
        blending.resolve(frame, np.asarray(background, np.float64))
        self._camera, self._is_replaced = camera, False
        return frame.colour

    @property
    def sorting(self) -> bool:
        """Whether the last classic frame used an older depth order: draw again when convenient."""
        return self._capture is not None and self._capture.sorting

    @current
    def overlay(self, items: Sequence[Overlay]) -> moderngl.Texture:
        """The last frame with an overlay, in a separate texture: the frame itself stays unchanged."""
        assert self._camera is not None, "nothing rendered yet"
        camera, frame = self._camera, self._frames[0]
        if self._overlaid is None:
            self._overlaid = Frame(self.ctx, camera.width, camera.height)
        self._overlaid.colour_fbo.use()  # first: a copy obeys the scissor of what was bound
        colours = self._replaced if self._is_replaced and self._replaced is not None else frame
        self.ctx.copy_framebuffer(self._overlaid.colour_fbo, colours.colour_fbo)
        self._overlaid.colour_fbo.use()
        centre = self._solids[0].centre if self._solids else np.zeros(3)
        pitch = max((solid.pitch for solid in self._solids), default=0.0)
        self._upload_info()
        self._overlays.draw(View(camera, centre, 1.0), items, frame.info, pitch)
        return self._overlaid.colour

    @current
    def replace(self, rgb: NDArray[np.float32]) -> moderngl.Texture:
        """Gives the last frame other colours (H, W, 3), in a separate texture and in overlays, until the next frame."""
        height, width = rgb.shape[:2]
        if self._replaced is None:
            self._replaced = Frame(self.ctx, width, height)
        halves = np.ones((height, width, 4), np.float16)
        halves[..., :3] = rgb
        self._replaced.colour.write(halves)
        self._is_replaced = True
        return self._replaced.colour

    # Reading

    @current
    def read(self) -> Picture:
        """The last frame, without overlays."""
        assert self._camera is not None, "nothing rendered yet"
        width, height = self._camera.width, self._camera.height
        frame = self._frames[0]
        self._upload_info()
        colour = np.frombuffer(frame.fbo.read(components=4, dtype="f4"), np.float32).reshape(height, width, 4)
        info = np.frombuffer(frame.fbo.read(components=2, attachment=1, dtype="f4"), np.float32)
        info = info.reshape(height, width, 2)
        depth = np.where(info[..., 0] < 0.5 * NOTHING, info[..., 0], np.float32(np.inf))
        return Picture(colour[..., :3].copy(), info[..., 1] - 2 * np.floor(info[..., 1] / 2), depth)

    @current
    def pick(self, x: float, y: float) -> tuple[int | None, NDArray[np.float64] | None]:
        """The index of the piece under a pixel of the last frame, and the world point (3,) there.

        x to the right, y down, in pixels from the top left. (None, None) outside the picture and on the background.
        """
        camera = self._camera
        if camera is None or not (0 <= x < camera.width and 0 <= y < camera.height):
            return None, None
        self._upload_info()
        data = self._frames[0].fbo.read((int(x), int(y), 1, 1), components=2, attachment=1, dtype="f4")
        z, code = np.frombuffer(data, np.float32).astype(np.float64)
        if z > 0.5 * NOTHING:
            return None, None
        across, down = (int(x) + 0.5 - camera.cx) / camera.fx, (int(y) + 0.5 - camera.cy) / camera.fy
        ray = np.array([across, down, z] if camera.orthographic else [across * z, down * z, z])
        point = camera.viewmat[:3, :3].T @ (ray - camera.viewmat[:3, 3])
        group = int(np.floor(code / 2))
        if not 0 <= group < len(self._groups):
            return None, point
        transform, members = self._groups[group]
        in_object = transform[:3, :3].T @ (point - transform[:3, 3])
        outside = [
            max((float(plane.distance(in_object)) for plane in self._pieces[m].planes), default=-np.inf)
            for m in members
        ]
        return members[int(np.argmin(outside))], point

    # Housekeeping

    def _upload_info(self) -> None:
        """Uploads the depths and pieces that the software path has drawn, only when they are read."""
        info = None if self._software is None else self._software.take_info()
        if info is not None:
            self._frames[0].info.write(info)

    def _resize(self, width: int, height: int) -> None:
        assert width > 0 and height > 0, (width, height)
        if not self._frames or self._frames[0].colour.size != (width, height):
            frames = [Frame(self.ctx, width, height) for _ in range(2)]
            sums = Accumulators(self.ctx, width, height)
            frames[0].fbo.use()  # the old ones must not be released while they are bound
            self._release_targets()
            self._frames, self._sums = frames, sums

    def _release_targets(self) -> None:
        for frame in self._frames:
            frame.release()
        self._frames = []
        if self._software is not None:
            self._software.reset()
        if self._sums is not None:
            self._sums.release()
            self._sums = None
        if self._overlaid is not None:
            self._overlaid.release()
            self._overlaid = None
        if self._replaced is not None:
            self._replaced.release()
            self._replaced = None

    def _release_solids(self) -> None:
        self._pool.clear()
        self._clear_grids()
        self._opaque.clear()
        self._solids, self._made_of = [], []

    def _clear_grids(self) -> None:
        self._opaque.section.grids.clear()
        if self._software is not None:
            self._software.grids.clear()

    def _release_capture(self) -> None:
        self._gradual = None
        self._pool.clear()
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def release(self) -> None:
        """Frees everything on the GPU, and the context if it is this renderer's own."""
        self._release()
        if self._owns_context:
            self.ctx.release()

    @current
    def _release(self) -> None:
        self._release_solids()
        self._release_capture()
        if self._next_capture is not None:
            self._next_capture.release()
        self._release_targets()
        if self._layers is not None:
            self._layers.release()
        self._overlays.release()
        self._opaque.release()
        if self._software is not None:
            self._software.release()
        self._screen.release()
        self._pool.release()
        self._programs.release()
