"""The real-time renderer: an object of atoms, cut into pieces, drawn with OpenGL 3.3 into a texture.

Standalone (offscreen) or inside a window's context. Pieces with the same transform lie together as they grew: their
splats are added up in the same sums, so that pieces put back together are the uncut object to the pixel, with no seam
that lets the background through. Each such group is resolved by itself and put over or under the frame so far by
depth, pixel by pixel, because a silhouette in front is anti-aliased against the piece behind, not against the
background.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine import sh
from engine.atoms import Atoms
from engine.camera import Camera
from engine.errors import InputError
from engine.formula import EPSILON_PITCHES
from engine.gl.batches import Pool
from engine.gl.context import Programs, offscreen_context, write_uniforms
from engine.gl.facing import hiding
from engine.gl.look import Look
from engine.gl.polygon import face_polygons
from engine.gl.section import SectionPass
from engine.gl.store import Ellipsoids, Spheres
from engine.gl.surface import MAX_PLANES, SurfacePass
from engine.gl.targets import Accumulators, Frame
from engine.gl.view import View
from engine.picture import Picture
from engine.piece import Piece
from engine.plane import stack

__all__ = ["Renderer"]

Double = NDArray[np.float64]
Rect = tuple[int, int, int, int]
"""x, y, width, height in pixels."""

WHOLE = (Piece(),)

NOTHING = 3.0e38
"""The depth of a pixel that shows nothing, as shaders/resolve.frag.glsl has it."""


class Renderer:
    """Draws one object. Not thread-safe: all calls from the thread that owns the context."""

    def __init__(self, ctx: moderngl.Context | None = None) -> None:
        """Attached to a context, or on one of its own without a window (raises context.GLMissing)."""
        self._own = ctx is None
        self.ctx = offscreen_context() if ctx is None else ctx
        self.programs = Programs(self.ctx)
        self.pool = Pool(self.ctx)
        self.surface = SurfacePass(self.ctx, self.programs, self.pool)
        self.section = SectionPass(self.ctx, self.programs, self.pool)
        self._screen: dict[moderngl.Program, moderngl.VertexArray] = {}
        self._size = (0, 0)
        self._frames: list[Frame] = []
        self._sums: Accumulators | None = None
        self._skin: Ellipsoids | None = None
        self._exposed: Ellipsoids | None = None
        self._inside: Spheres | None = None
        self._centre, self._radius, self._pitch = np.zeros(3), 1.0, 1.0
        self._groups: list[tuple[Double, list[int]]] = []
        self._pieces: Sequence[Piece] = WHOLE
        self._camera: Camera | None = None

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    # Content

    def set_atoms(self, atoms: Atoms) -> None:
        """The object to draw. Replaces the one before."""
        self._drop_atoms()
        bounds = atoms.bounds.astype(np.float64)
        self._centre = bounds.mean(0)
        skin, inside = atoms.surface, atoms.interior
        widest = max(float(skin.scales.max(initial=0)), float(inside.sigmas.max(initial=0)))
        # Splats reach three sigma, the corners of their quads a factor of sqrt(2) more; epsilon lies in front.
        self._radius = (
            float(np.linalg.norm(bounds[1] - bounds[0]) / 2) + 4.5 * widest + 2 * EPSILON_PITCHES * atoms.pitch
        )
        self._pitch = float(atoms.pitch)

        def shift(means: NDArray[np.float32]) -> NDArray[np.float32]:
            return (means.astype(np.float64) - self._centre).astype(np.float32)

        hidden = hiding(atoms)
        hidden = replace(hidden, low=hidden.low - self._centre)
        self._skin = Ellipsoids(self.ctx, shift(skin.means), skin.scales, skin.quats, skin.sh, hidden)
        self._inside = Spheres(self.ctx, shift(inside.means), inside.sigmas, inside.rgb)
        if inside.exposed:
            n = inside.exposed
            unit = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
            scales = np.repeat(inside.sigmas[:n, None], 3, 1)
            self._exposed = Ellipsoids(
                self.ctx, shift(inside.means[:n]), scales, unit, sh.rgb_to_sh(inside.rgb[:n, None])
            )

    def update_colours(
        self,
        sh_coefficients: NDArray[np.float32] | None = None,  # [S, (d+1)^2, 3]
        rgb: NDArray[np.float32] | None = None,  # [I, 3]
    ) -> None:
        """Other colours for the surface or the interior atoms (or both), in the order of `set_atoms`, in place."""
        assert self._skin is not None and self._inside is not None, "no atoms yet"
        if sh_coefficients is not None:
            self._skin.update(sh_coefficients)
        self.section.grids.clear()
        if rgb is not None:
            self._inside.update(rgb)
            if self._exposed is not None:
                self._exposed.update(sh.rgb_to_sh(rgb[: len(self._exposed), None]))

    # Drawing

    def render(
        self,
        camera: Camera,
        pieces: Sequence[Piece] = WHOLE,
        background: ArrayLike = (1.0, 1.0, 1.0),
        light: bool = False,
        level: int = 0,
        cull: bool = True,
    ) -> moderngl.Texture:
        """Draws a frame of the camera's size; the texture is this renderer's own and lasts until the next call.

        background: RGB. light: shade the cut faces a little. level: 0 is the full quality, each further one draws half
        as many atoms, enlarged. cull: False draws every atom (to measure what culling saves).
        Raises InputError where a piece has more than MAX_PLANES planes that count.
        """
        pieces = list(pieces)
        self._resize(camera.width, camera.height)
        self._camera, self._pieces = camera, pieces
        self.pool.begin()
        self.section.grids.begin()
        ground = np.asarray(background, np.float64)
        frame, other = self._frames
        self._clear(frame, ground)
        self._groups = grouped(pieces)
        first = True
        for number, (transform, members) in self._far_to_near(camera):
            view = View(Piece((), transform).camera(camera), self._centre, self._radius)
            rect = bounds_on_screen(view)
            if rect is None or self._skin is None or self._inside is None:
                continue
            planes = [self._bounding_planes(pieces[m]) for m in members]
            faces = self._draw_group(view, [p for p in planes if p is not None], rect, Look(light, level, cull))
            below = None if first else frame
            self._resolve(view, rect, number, ground, frame if first else other, below, faces)
            if not first:
                self._copy(other, frame, rect)
            first = False
        return frame.colour

    def _draw_group(self, view: View, planes: list[Double], rect: Rect, look: Look) -> bool:
        """Fills the accumulators; True where a face is seen."""
        sums, skin, inside = self._sums, self._skin, self._inside
        assert sums is not None and skin is not None and inside is not None
        for fbo in (sums.front_fbo, sums.splat_fbo, sums.field_fbo, sums.face_fbo):
            fbo.scissor = rect
        sums.front_fbo.use()  # transform feedback asks for a whole framebuffer, too, and a window may not have one
        sums.front_fbo.clear(depth=1.0, viewport=rect)
        has_faces = False
        for i, p in enumerate(planes):
            if len(p) and not has_faces:
                sums.face_fbo.depth_mask = False
                sums.face_fbo.clear(viewport=rect)
                sums.face_fbo.depth_mask = True
            has_faces |= self.section.draw(
                view, p, planes[:i] + planes[i + 1 :], inside, skin, sums, self._pitch, rect, look
            )
        runs = self.surface.project(view, planes, skin, look)
        if self._exposed is not None:
            runs += self.surface.project(view, planes, self._exposed, look)
        sums.splat_fbo.depth_mask = False
        sums.splat_fbo.clear(viewport=rect)
        self.surface.draw(view, runs, sums, self._pitch * 2.0 ** (look.level / 2))
        return has_faces

    def _resolve(
        self, view: View, rect: Rect, number: int, ground: Double, into: Frame, below: Frame | None, faces: bool
    ) -> None:
        sums = self._sums
        assert sums is not None
        into.fbo.scissor = rect
        into.fbo.use()
        self.ctx.enable_only(moderngl.NOTHING)
        defines = {"FACES": int(faces), "BELOW": int(below is not None)}
        program = self.programs.get("screen.vert.glsl", "resolve.frag.glsl", defines)
        values: dict[str, Any] = {
            **view.uniforms,
            "splats@0": sums.splats,
            "sharpness@1": sums.sharpness,
            "front@2": sums.depth,
            "faces@3": sums.faces,
            "face_depths@4": sums.face_depths,
            "background": tuple(ground),
            "tolerance": 1e-3 * self._pitch,
            "group": float(number),
        }
        if below is not None:
            values |= {"below@5": below.colour, "below_info@6": below.info}
        write_uniforms(program, values)
        self._triangle(program).render(moderngl.TRIANGLES, vertices=3)

    def _copy(self, source: Frame, into: Frame, rect: Rect) -> None:
        into.fbo.scissor = rect
        into.fbo.use()
        program = self.programs.get("screen.vert.glsl", "copy.frag.glsl")
        write_uniforms(program, {"colour@0": source.colour, "info@1": source.info})
        self._triangle(program).render(moderngl.TRIANGLES, vertices=3)

    def _clear(self, frame: Frame, ground: Double) -> None:
        red, green, blue = ground.tolist()
        frame.colour_fbo.clear(red, green, blue, 1.0)
        frame.info_fbo.clear(NOTHING, -2.0, 0.0, 0.0)

    def _triangle(self, program: moderngl.Program) -> moderngl.VertexArray:
        if program not in self._screen:
            self._screen[program] = self.ctx.vertex_array(program, [])
        return self._screen[program]

    def _bounding_planes(self, piece: Piece) -> Double | None:
        """(P, 4). The planes of a piece that cut the object, in centred object space; None where nothing is left."""
        planes = stack(piece.planes)
        planes[:, 3] += planes[:, :3] @ self._centre
        # Those that miss the object: all of it is kept, or nothing.
        if (planes[:, 3] > self._radius).any():
            return None
        planes = planes[planes[:, 3] >= -self._radius]
        if len(planes) > 1:
            polygons = face_polygons(planes, np.zeros(3), self._radius)
            planes = planes[[len(p) >= 3 for p in polygons]]
        if len(planes) > MAX_PLANES:
            raise InputError(f"a piece with {len(planes)} planes; at most {MAX_PLANES} can bound one, cut less often")
        return planes

    def _far_to_near(self, camera: Camera) -> list[tuple[int, tuple[Double, list[int]]]]:
        depth = [float((camera.viewmat @ t @ np.append(self._centre, 1))[2]) for t, _ in self._groups]
        return [(i, self._groups[i]) for i in np.argsort(depth)[::-1]]

    # Reading

    def read(self) -> Picture:
        """The last frame."""
        assert self._camera is not None, "nothing rendered yet"
        width, height = self._size
        frame = self._frames[0]
        colour = np.frombuffer(frame.fbo.read(components=4, dtype="f4"), np.float32).reshape(height, width, 4)
        info = np.frombuffer(frame.fbo.read(components=2, attachment=1, dtype="f4"), np.float32)
        info = info.reshape(height, width, 2)
        coverage = info[..., 1] - 2 * np.floor(info[..., 1] / 2)
        depth = np.where(info[..., 0] < 1e38, info[..., 0], np.float32(np.inf))
        return Picture(colour[..., :3].copy(), coverage, depth)

    # Housekeeping

    def _resize(self, width: int, height: int) -> None:
        assert width > 0 and height > 0, (width, height)
        if (width, height) != self._size:
            self._drop_targets()
            self._frames = [Frame(self.ctx, width, height) for _ in range(2)]
            self._sums = Accumulators(self.ctx, width, height)
            self._size = (width, height)
            self._frames[0].fbo.use()  # what was bound may be gone

    def _drop_targets(self) -> None:
        for frame in self._frames:
            frame.release()
        self._frames = []
        if self._sums is not None:
            self._sums.release()
            self._sums = None
        self._size = (0, 0)

    def _drop_atoms(self) -> None:
        self.pool.forget_sources()
        self.section.grids.clear()
        for store in (self._skin, self._exposed, self._inside):
            if store is not None:
                store.release()
        self._skin = self._exposed = self._inside = None

    def release(self) -> None:
        """Frees everything on the GPU, and the context if it is this renderer's own."""
        self._drop_atoms()
        self._drop_targets()
        for array in self._screen.values():
            array.release()
        self._screen.clear()
        self.section.release()
        self.pool.release()
        self.programs.release()
        if self._own:
            self.ctx.release()


def grouped(pieces: Sequence[Piece]) -> list[tuple[Double, list[int]]]:
    """Pieces that lie together: their transform and their numbers."""
    groups: list[tuple[Double, list[int]]] = []
    for i, piece in enumerate(pieces):
        for transform, members in groups:
            if np.array_equal(transform, piece.transform):
                members.append(i)
                break
        else:
            groups.append((piece.transform, [i]))
    return groups


def bounds_on_screen(view: View) -> Rect | None:
    """x, y, width, height of the part of the picture that the object's ball can touch; None where there is none."""
    camera = view.camera
    x, y, z = view.matrix[:3, 3]
    r = view.radius
    whole = (0, 0, camera.width, camera.height)
    spans = []
    for f, c, at, extent in ((camera.fx, camera.cx, x, camera.width), (camera.fy, camera.cy, y, camera.height)):
        if camera.orthographic:
            low, high = f * (at - r) + c, f * (at + r) + c
        else:
            if z + r <= camera.near:
                return None
            if z - r <= 0.1 * r:  # inside or beside the eye
                return whole
            angle, half = np.arctan2(at, z), np.arcsin(min(r / np.hypot(at, z), 1.0))
            if abs(angle) + half >= 1.5:
                return whole
            low, high = f * np.tan(angle - half) + c, f * np.tan(angle + half) + c
        spans.append((int(np.clip(np.floor(low) - 4, 0, extent)), int(np.clip(np.ceil(high) + 4, 0, extent))))
    (x0, x1), (y0, y1) = spans
    return (x0, y0, x1 - x0, y1 - y0) if x1 > x0 and y1 > y0 else None
