"""Draws the workspace's objects with the GL renderer: frames of the viewport as something changes, and exports."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from app.jobs.detail_reader import DetailReader
from app.jobs.warmup import load_kernels
from app.model.rigid_transform import Vec3
from app.session.workspace import Workspace
from engine.render.cpu.software import is_software
from engine.render.culling.draw_options import Mode, SplatLook
from engine.render.face_detail import Detailed, FaceDetail, detailed
from engine.render.gl.overlay import Lines, Overlay
from engine.render.gl.renderer import Renderer
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.image import to_8bit
from engine.scene.piece import Piece

__all__ = ["REST", "Painter"]

REST = 0.1
"""Seconds after the last change of the view until it is drawn in full. Reading the faces begins then, and is abandoned
as soon as the view changes again."""

SLOW, QUICK = 60.0, 20.0
"""Milliseconds per frame above which a moving view is drawn coarser, and below which it is drawn finer again."""

STEPS = ((1.0, 0), (0.75, 1), (0.5, 1), (0.5, 2), (0.35, 3), (0.2, 4))
"""How a moving view gets coarser: fraction of the pixels along a side, and level of detail, each of which halves the
atoms. A GPU is first limited by atoms, then by pixels; a CPU that draws, the other way round."""

MOST_IN_SOFTWARE = 2_000_000
"""Most Gaussians of a capture that are drawn without a graphics card, where each million takes a second and 0.1 GB.
Pictures for files have all of them."""

SLICE = 0.025
"""Seconds between two frames that are left for reading faces at rest, uploading a capture, or drawing one without a
graphics card: input does not wait noticeably."""

MODES: dict[str, Mode] = {"capture": "classic", "solid": "opaque", "interior": "interior"}


class Painter:
    """The renderer of a window, with what it has last uploaded and drawn."""

    def __init__(self, ctx: moderngl.Context | None = None, wake: Callable[[], None] = lambda: None) -> None:
        """`ctx`: the window's OpenGL context; None: a new one without a window. `wake` is called, in any thread, when
        there is something new to draw while the window waits."""
        self._screen = None if ctx is None else ctx.detect_framebuffer(0)
        self.renderer = Renderer(ctx)
        self.ctx = self.renderer.ctx
        self._in_software = is_software(self.ctx.info["GL_RENDERER"])
        self.milliseconds = 0.0
        """Moving average of the time of a frame while the view moves; before the first move, time of the last frame."""
        self._timed = False
        """Whether a frame in motion has been timed."""
        self.unfinished = False
        """Whether a better frame should follow: the last one was coarse, or its depth order is being updated."""
        self._step = 0
        """Index into STEPS for a moving view."""
        self._scale = 1.0
        """Fraction of the pixels along a side that the last frame was drawn with."""
        self._capture: object = None
        """The capture on the GPU."""
        self._atoms: tuple[int, int, tuple[int, ...]] | None = None
        """Geometry and colour version of the atoms on the GPU, and the numbers of their objects."""
        self._solids: list[Atoms] = []
        """The atoms on the GPU."""
        self._key: object = None
        """Everything that the last frame depends on, apart from the overlay."""
        self._picture: moderngl.Texture | None = None
        """The last frame without the overlay."""
        self._texture: moderngl.Texture | None = None
        """The last frame."""
        self._overlay_key: object = None
        """Everything that the overlay of the last frame depends on."""
        self._loading: threading.Thread | None = None
        """Loads the kernels that draw a solid without a graphics card."""
        self._uploading = False
        """Whether something must be uploaded or loaded before the workspace can be drawn."""
        self._wants_capture = False
        """Whether the last frame shows a capture coarsely, so that all of it is to be drawn next."""
        self._reader = DetailReader(wake)
        """Reads the faces of the last frame from the insides of the objects."""
        self._wants_detail = False
        """Whether these faces have yet to be shown."""

    def frame(
        self,
        workspace: Workspace,
        camera: Camera,
        pieces: Sequence[Piece],
        background: Vec3,
        over: Sequence[Overlay] = (),
        moving: bool = False,
    ) -> moderngl.Texture | None:
        """A frame of the workspace's objects; None if there is nothing to draw. Valid until the next call.

        `over`: lines, sheets and pictures drawn over the object. `moving`: the view changes from frame to frame, so
        that speed matters more than detail.
        """
        atoms, capture = self._atoms, self._capture
        self._uploading = False
        if not self._upload(workspace, SLICE):
            self.unfinished = self._uploading
            return None
        gradual = workspace.mode == "capture" and self._in_software and not moving
        part, level = STEPS[-1] if gradual else STEPS[self._step] if moving else STEPS[0]
        thinned = self._thinned(workspace)
        level = max(level, thinned)
        light, mode, look = workspace.settings.face_light, workspace.mode, workspace.viewing.splats
        insides = details_of(workspace)
        key = (
            (mode, self._atoms, id(self._capture), background, light, part, level, moving, look),
            tuple(id(detail.inside) if detail else None for detail in insides),
            camera.viewmat.tobytes(),
            repr(replace(camera, viewmat=np.zeros(0))),
            tuple((piece.planes, piece.transform.tobytes(), piece.solid) for piece in pieces),
        )
        overlay_key = tuple(
            (
                i.rgba if isinstance(i.rgba, tuple) else id(i.rgba),
                (i.ends if isinstance(i, Lines) else i.corners).tobytes(),
                i.hidden,
                getattr(i, "width", 0.0),
            )
            for i in over
        )
        if key != self._key or self._texture is None or (mode == "capture" and self.renderer.sorting):
            begin = time.perf_counter()
            texture = self.renderer.render(
                camera.scaled(part),
                pieces,
                MODES[mode],
                background,
                light,
                exact=not moving,
                level=level,
                wait=False,
                look=look,
            )
            self._restore_framebuffer()
            self.ctx.finish()
            taken = 1000 * (time.perf_counter() - begin)
            self._record_time(taken, moving, atoms == self._atoms and capture is self._capture)
            if moving and taken > SLOW:
                self._step = min(self._step + 1, len(STEPS) - 1)
            elif moving and taken < QUICK:
                self._step = max(self._step - 1, 0)
            self._key, self._scale, self._overlay_key = key, part, None
            self._picture = texture
            self._reader.stop()
            self._wants_detail = not moving and mode != "capture" and any(insides)
            self._wants_detail &= look.size == 1  # at other sizes the user wants to see the atoms
            self._wants_capture = gradual
        elif self._wants_capture:
            self._refine_capture(camera, background, thinned, look)
        elif self._wants_detail:
            self._add_detail(camera, pieces, insides, light)
        if overlay_key != self._overlay_key:
            self._texture = self.renderer.overlay(over) if over else self._picture
            self._restore_framebuffer()
            self._overlay_key = overlay_key
        # Drawing the capture again ends the sorting.
        self.unfinished = moving or self._wants_detail or self._wants_capture or self._uploading
        self.unfinished |= mode == "capture" and self.renderer.sorting
        return self._texture

    @property
    def only_reads(self) -> bool:
        """Whether all unfinished work is being done in the background."""
        return self._reader.busy and not self._uploading

    @property
    def shown(self) -> moderngl.Texture | None:
        """The last frame that `frame` returned; None before the first."""
        return self._texture

    def _thinned(self, workspace: Workspace) -> int:
        """The level of detail that keeps a capture within MOST_IN_SOFTWARE Gaussians; 0 with a graphics card."""
        capture = workspace.shown_capture
        if workspace.mode != "capture" or capture is None or not self._in_software:
            return 0
        return math.ceil(math.log2(max(len(capture) / MOST_IN_SOFTWARE, 1)))

    def _refine_capture(self, camera: Camera, background: Vec3, level: int, look: SplatLook) -> None:
        """Draws some more of a capture at rest; once all of it is drawn, the frame shows it."""
        texture = self.renderer.refine(camera, background, level, SLICE, look)
        if texture is not None:
            self._picture, self._scale = texture, 1.0
            self._wants_capture, self._overlay_key = False, None
        self._restore_framebuffer()

    def _add_detail(
        self, camera: Camera, pieces: Sequence[Piece], insides: Sequence[Detailed | None], light: bool
    ) -> None:
        """Starts reading the faces of a view at rest, and leaves the processor to that for a while; once all are read,
        the frame shows them."""
        if not self._reader.busy:
            picture = self.renderer.read()
            self._reader.start(lambda: FaceDetail(picture, camera, pieces, insides, light))
        self._wants_detail = False  # a reading that fails would fail in every frame: faces stay as fine as their atoms
        rgb = self._reader.take(SLICE)
        if rgb is None:
            self._wants_detail = True
        else:
            self._picture = self.renderer.replace(rgb)
            self._overlay_key = None
        self._restore_framebuffer()

    def _record_time(self, taken: float, moving: bool, uploaded: bool) -> None:
        """Records the milliseconds of a frame, unless the object had to be uploaded for it."""
        if moving and uploaded:
            self.milliseconds = taken if not self._timed else 0.8 * self.milliseconds + 0.2 * taken
            self._timed = True
        elif uploaded and not self._timed:
            self.milliseconds = taken

    def pick(self, x: float, y: float) -> tuple[int | None, NDArray[np.float64] | None]:
        """Index of the piece at a pixel of the full-size frame, and the world point (3,) there; None if none is."""
        if self._texture is None:
            return None, None
        found = self.renderer.pick(x * self._scale, y * self._scale)
        self._restore_framebuffer()
        return found

    def snapshot(self) -> NDArray[np.uint8] | None:
        """(H, W, 3). The last frame as it is shown, without the overlay; None before the first frame, and after a
        picture for a file has taken its place on the graphics card."""
        if self._picture is None or self._key is None:
            return None
        width, height = self._picture.size
        halves = np.frombuffer(self._picture.read(), np.float16).reshape(height, width, 4)
        return to_8bit(halves[..., :3].astype(np.float32))

    def picture(self, workspace: Workspace, camera: Camera, pieces: Sequence[Piece]) -> NDArray[np.uint8]:
        """(H, W, 4). A picture for a file, with straight alpha. The next frame is then drawn anew."""
        self._key = None
        if not self._upload(workspace, math.inf, tinted=False):
            return np.zeros((camera.height, camera.width, 4), np.uint8)
        light = workspace.settings.face_light
        look = workspace.viewing.splats
        self.renderer.render(camera, pieces, MODES[workspace.mode], (0.0, 0.0, 0.0), light, look=look)
        seen = self.renderer.read()
        self._restore_framebuffer()
        if workspace.mode != "capture" and look.size == 1:
            seen = detailed(seen, camera, pieces, details_of(workspace), light)
        return seen.straight_alpha()

    def _restore_framebuffer(self) -> None:
        """Binds the window's framebuffer again, since ImGui draws into whichever is bound."""
        if self._screen is not None:
            self._screen.use()

    def _upload(self, workspace: Workspace, seconds: float, tinted: bool = True) -> bool:
        """Uploads the workspace's objects unless the GPU has them; False if there is nothing to draw.

        `tinted`: whether selected Gaussians of the capture are tinted. `seconds`: time after which the rest of a
        capture waits for the next frame; until then the previous one is drawn.
        """
        if workspace.object is None:
            self._capture = None  # the next scene is another one
            return False
        if workspace.mode == "capture":
            capture, view = workspace.shown_capture, workspace.capture_view
            if not tinted and view is not None and capture is view.shown:
                capture = view.plain
            if capture is None:
                return False
            if capture is not self._capture:
                if not self.renderer.set_capture(capture, seconds):
                    self._uploading = True
                    return self._capture is not None
                self._capture, self._key = capture, None
            return True
        if self._in_software and self._screen is not None and tinted and not self._kernels_loaded():
            self._uploading = True
            return False
        solids = workspace.solids
        atoms = (workspace.geometry_version, workspace.colour_version, tuple(solids))
        if self._atoms is None or (self._atoms[0], self._atoms[2]) != (atoms[0], atoms[2]):
            ready = [workspace.loaded[number].drawn for number in solids]
            pairs = zip(ready, solids.values(), strict=True)
            self.renderer.set_atoms(*(r if r is not None and r.atoms is one else one for r, one in pairs))
        elif self._atoms[1] != atoms[1]:
            for k, (before, now) in enumerate(zip(self._solids, solids.values(), strict=True)):
                if now is not before:
                    self.renderer.update_colours(now.surface.sh, now.interior.rgb, k)
        self._atoms, self._solids = atoms, list(solids.values())
        return True

    def _kernels_loaded(self) -> bool:
        """Whether a solid can be drawn without waiting for its kernels; the first call begins to load them."""
        if self._loading is None:
            self._loading = threading.Thread(target=load_kernels, daemon=True)
            self._loading.start()
        return not self._loading.is_alive()

    def release(self) -> None:
        """Frees all GPU memory."""
        self._reader.close()
        self.renderer.release()
        self._texture = self._picture = None


def details_of(workspace: Workspace) -> list[Detailed | None]:
    """What the faces of each solid are read from at rest, in the order of the solids."""
    loaded = workspace.loaded
    return [
        Detailed(inside, atoms.pitch) if (inside := loaded[number].inside) is not None else None
        for number, atoms in workspace.solids.items()
    ]
