"""Draws the session's object with the GL engine, only when something has changed, and pictures for export."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from app.model.rigid_transform import Vec3
from app.session.session import Session
from engine.render.culling.draw_options import Mode
from engine.render.gl.overlay import Lines, Sheet
from engine.render.gl.renderer import Renderer
from engine.scene.camera import Camera
from engine.scene.piece import Piece

__all__ = ["Painter"]

SLOW, QUICK = 60.0, 20.0
"""Milliseconds of a frame over which a moving view is drawn coarser, and under which it is drawn finer again."""

STEPS = ((1.0, 0), (0.75, 1), (0.5, 1), (0.5, 2), (0.35, 3))
"""How a moving view gets coarser: part of the pixels along a side, and level of detail, which halves the atoms each
time. A GPU has too many atoms before it has too many pixels, a processor that draws the other way round."""

MODES: dict[str, Mode] = {"capture": "classic", "solid": "opaque", "interior": "interior"}


class Painter:
    """Holds the renderer of a window."""

    def __init__(self, ctx: moderngl.Context | None = None) -> None:
        """In the window's context, or offscreen."""
        self._screen = None if ctx is None else ctx.detect_framebuffer(0)
        self.renderer = Renderer(ctx)
        self.ctx = self.renderer.ctx
        self.milliseconds = 0.0
        """What a frame takes while the view moves, evened out; before it ever has, what the last full one took."""
        self._timed = False
        """Whether a frame in motion has been timed."""
        self.unfinished = False
        """Whether a better frame should follow soon: the last one was coarse, or in an older order."""
        self._step = 0
        self._drawn = 1.0
        """Part of the pixels along a side that the last frame has."""
        self._capture: object = None
        self._atoms: tuple[int, int] | None = None
        """Geometry and colours of the session that the GPU has."""
        self._key: object = None
        self._picture: moderngl.Texture | None = None
        self._texture: moderngl.Texture | None = None
        """The picture, with marks over it where there are any."""
        self._marks: object = None

    def frame(
        self,
        session: Session,
        camera: Camera,
        pieces: Sequence[Piece],
        background: Vec3,
        over: Sequence[Lines | Sheet] = (),
        moving: bool = False,
    ) -> moderngl.Texture | None:
        """The session's object as it is now; None while there is nothing to draw. Lasts until the next call.

        `moving`: the view changes from frame to frame, and keeping up matters more than the last atom.
        """
        atoms, capture = self._atoms, self._capture
        if not self._hold(session):
            return None
        part, level = STEPS[self._step] if moving else STEPS[0]
        light, mode = session.settings.face_light, session.mode
        key = (
            (mode, self._atoms, id(self._capture), background, light, part, level, moving),
            camera.viewmat.tobytes(),
            repr(replace(camera, viewmat=np.zeros(0))),
            tuple((piece.planes, piece.transform.tobytes()) for piece in pieces),
        )
        marks = tuple(
            (i.rgba, (i.corners if isinstance(i, Sheet) else i.ends).tobytes(), i.hidden, getattr(i, "width", 0.0))
            for i in over
        )
        if key != self._key or self._texture is None or self.renderer.sorting:
            begin = time.perf_counter()
            texture = self.renderer.render(
                scaled(camera, part), pieces, MODES[mode], background, light, exact=not moving, level=level, wait=False
            )
            self._give_back()
            self.ctx.finish()
            taken = 1000 * (time.perf_counter() - begin)
            self._note(taken, moving, atoms == self._atoms and capture is self._capture)
            if moving and taken > SLOW:
                self._step = min(self._step + 1, len(STEPS) - 1)
            elif moving and taken < QUICK:
                self._step = max(self._step - 1, 0)
            self._key, self._drawn, self._marks = key, part, None
            self._picture = texture
        if marks != self._marks:
            self._texture = self.renderer.overlay(over) if over else self._picture
            self._give_back()
            self._marks = marks
        self.unfinished = moving or self.renderer.sorting
        return self._texture

    def _note(self, taken: float, moving: bool, held: bool) -> None:
        """Keeps the time of a frame, in milliseconds; not of one that had to bring the object to the GPU first."""
        if moving and held:
            self.milliseconds = taken if not self._timed else 0.8 * self.milliseconds + 0.2 * taken
            self._timed = True
        elif held and not self._timed:
            self.milliseconds = taken

    def pick(self, x: float, y: float) -> tuple[int | None, NDArray[np.float64] | None]:
        """Number of the piece under a pixel of the frame as it was asked for, and the world point (3,) there."""
        if self._texture is None:
            return None, None
        found = self.renderer.pick(x * self._drawn, y * self._drawn)
        self._give_back()
        return found

    def picture(self, session: Session, camera: Camera, pieces: Sequence[Piece]) -> NDArray[np.uint8]:
        """(H, W, 4). A picture for a file, straight alpha; the next frame of the window is drawn anew."""
        self._key = None
        if not self._hold(session):
            return np.zeros((camera.height, camera.width, 4), np.uint8)
        self.renderer.render(camera, pieces, MODES[session.mode], (0.0, 0.0, 0.0), session.settings.face_light)
        seen = self.renderer.read()
        self._give_back()
        alpha = np.clip(seen.alpha[..., None], 0, 1)
        rgb = np.where(alpha > 1e-3, seen.rgb / np.maximum(alpha, 1e-3), 0.0)
        return (np.clip(np.concatenate([rgb, alpha], 2), 0, 1) * 255 + 0.5).astype(np.uint8)

    def _give_back(self) -> None:
        """ImGui draws where it finds the context."""
        if self._screen is not None:
            self._screen.use()

    def _hold(self, session: Session) -> bool:
        """Puts what the session shows onto the GPU where it is not there already; False where there is nothing."""
        shown = session.object
        if shown is None:
            return False
        if session.mode == "capture":
            if shown.capture is None:
                return False
            if shown.capture is not self._capture:
                self.renderer.set_capture(shown.capture)
                self._capture, self._key = shown.capture, None
            return True
        assert shown.atoms is not None
        atoms = (session.geometry, session.colours)
        if self._atoms is None or self._atoms[0] != session.geometry:
            self.renderer.set_atoms(shown.atoms)
        elif self._atoms[1] != session.colours:
            self.renderer.update_colours(shown.atoms.surface.sh, shown.atoms.interior.rgb)
        self._atoms = atoms
        return True

    def release(self) -> None:
        """Frees everything on the GPU."""
        self.renderer.release()
        self._texture = self._picture = None


def scaled(camera: Camera, part: float) -> Camera:
    """The same view in fewer pixels."""
    if part == 1:
        return camera
    width, height = (max(16, round(side * part)) for side in (camera.width, camera.height))
    x, y = width / camera.width, height / camera.height
    return replace(
        camera, fx=camera.fx * x, fy=camera.fy * y, cx=camera.cx * x, cy=camera.cy * y, width=width, height=height
    )
