"""Draws the session's object with the GL engine, only when something has changed, and pictures for export."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from app.motion import Vec3
from app.session import Session
from engine.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.camera import Camera
from engine.gl.renderer import Renderer
from engine.piece import Piece

__all__ = ["Painter"]


class Painter:
    """Holds the renderer of a window."""

    def __init__(self, ctx: moderngl.Context | None = None) -> None:
        """In the window's context, or offscreen."""
        self._screen = None if ctx is None else ctx.detect_framebuffer(0)
        self.renderer = Renderer(ctx)
        self.ctx = self.renderer.ctx
        self.milliseconds = 0.0
        """Of the last frame that was drawn."""
        self.drawn = 0
        """Frames drawn so far."""
        self._held: tuple[int, str] | None = None
        self._colours = -1
        self._key: object = None
        self._capture = None
        self._cpu = None
        self._seen = None
        self._texture: moderngl.Texture | None = None

    def frame(
        self, session: Session, camera: Camera, pieces: Sequence[Piece], background: Vec3
    ) -> moderngl.Texture | None:
        """The session's object as it is now; None while there is nothing to draw. Lasts until the next call."""
        if not self._hold(session):
            return None
        light = session.settings.face_light
        key = (
            self._held,
            self._colours,
            camera.viewmat.tobytes(),
            replace(camera, viewmat=np.zeros(0)).__repr__(),
            tuple((piece.planes, piece.transform.tobytes()) for piece in pieces),
            background,
            light,
        )
        if key != self._key or self._texture is None:
            begin = time.perf_counter()
            self._texture = self._draw(session.mode, camera, pieces, background, light)
            if self._screen is not None:
                self._screen.use()  # ImGui draws where it finds the context
            self.ctx.finish()
            self.milliseconds = 1000 * (time.perf_counter() - begin)
            self._key = key
            self.drawn += 1
        return self._texture

    def picture(self, session: Session, camera: Camera, pieces: Sequence[Piece]) -> NDArray[np.uint8]:
        """(H, W, 4). A picture for a file, straight alpha; the next frame of the window is drawn anew."""
        self._key = None
        if not self._hold(session):
            return np.zeros((camera.height, camera.width, 4), np.uint8)
        self._draw(session.mode, camera, pieces, (0.0, 0.0, 0.0), session.settings.face_light)
        if self._screen is not None:
            self._screen.use()
        seen = self._seen if session.mode == "capture" else self.renderer.read()
        alpha = seen.alpha[..., None]
        rgb = np.where(alpha > 1e-3, seen.rgb / np.maximum(alpha, 1e-3), 0.0)
        return (np.clip(np.concatenate([rgb, alpha], 2), 0, 1) * 255 + 0.5).astype(np.uint8)

    def _draw(
        self, mode: str, camera: Camera, pieces: Sequence[Piece], background: Vec3, light: bool
    ) -> moderngl.Texture:
        if mode == "capture":
            return self._draw_capture(camera, background)
        return self.renderer.render(camera, pieces, background, light=light)

    def _draw_capture(self, camera: Camera, background: Vec3) -> moderngl.Texture:
        from engine import classic

        assert self._capture is not None
        seen = classic.render(self._capture, camera, background)
        self._seen = seen
        if self._cpu is not None:
            self._cpu.release()
        self._cpu = self.ctx.texture(
            (camera.width, camera.height), 3, np.ascontiguousarray(seen.rgb, np.float32), dtype="f4", alignment=1
        )
        return self._cpu

    def _hold(self, session: Session) -> bool:
        """Puts the session's object onto the GPU where it is not there already; False where there is none."""
        shown = session.object
        if shown is None or (shown.atoms is None and shown.capture is None):
            return False
        mode = session.mode
        held = (session.geometry, mode)
        if held != self._held:
            if mode == "capture":
                if shown.capture is None:
                    return False
                self._capture = shown.capture
            else:
                assert shown.atoms is not None
                self.renderer.set_atoms(shown.atoms if mode == "solid" else bare(shown.atoms))
            self._held, self._colours, self._key = held, session.colours, None
        elif session.colours != self._colours and shown.atoms is not None and mode != "capture":
            sh = shown.atoms.surface.sh if mode == "solid" else None
            self.renderer.update_colours(sh, shown.atoms.interior.rgb)
            self._colours, self._key = session.colours, None
        return True

    def release(self) -> None:
        """Frees everything on the GPU."""
        self.renderer.release()
        self._texture = None


def bare(atoms: Atoms) -> Atoms:
    """The inside alone, seen from outside."""
    s, i = atoms.surface, atoms.interior
    none = SurfaceAtoms(s.means[:0], s.scales[:0], s.quats[:0], s.sh[:0])
    return Atoms(none, InteriorAtoms(i.means, i.sigmas, i.rgb, len(i)), atoms.pitch)
