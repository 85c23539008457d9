"""A contact sheet of cuts that no family contains, for judging a finished run at a glance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.io.picture_file import save_png
from engine.render.cpu import opaque
from engine.render.cpu.kernel_field import KernelField
from engine.render.face_detail import Detailed, detailed_from, read_face
from engine.scene.atoms import Atoms
from engine.scene.camera import equator, fit_distance, orbit, section
from engine.scene.grid import Body
from engine.scene.inside import Inside
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.threads import side_by_side

__all__ = ["contact_sheet_planes", "save_contact_sheet"]

TILE = 320
"""Pixels of a square tile."""

# Tilt from the up axis and azimuth around it in degrees, and position between centre (0) and skin (1). Oblique,
# off-centre, near a pole, and upright beside the axis: no family of evenly spaced planes contains them.
CUTS = (
    (35.0, 20.0, 0.0),
    (62.0, 140.0, 0.15),
    (48.0, 250.0, -0.35),
    (8.0, 77.0, 0.62),
    (90.0, 33.0, 0.45),
    (77.0, 301.0, 0.3),
)


def contact_sheet_planes(body: Body, up: NDArray[np.float64]) -> list[Plane]:
    """Six planes through the body that no family contains; the kept side is the one away from up."""
    e1, e2 = equator(up)
    points, centre = body.points, body.bounds().mean(0)
    planes = []
    for tilt, turn, place in CUTS:
        t, a = np.radians(tilt), np.radians(turn)
        normal = np.cos(t) * up + np.sin(t) * (np.cos(a) * e1 + np.sin(a) * e2)
        along = (points - centre) @ normal
        reach = along.max() if place > 0 else -along.min()
        planes.append(Plane.through(centre + normal * place * reach, normal))
    return planes


def save_contact_sheet(
    path: Path, atoms: Atoms, body: Body, up: NDArray[np.float64], inside: Inside | None = None
) -> None:
    """Writes six cuts in two rows: the opened object in perspective above, the cut face straight on below; in the full
    detail of `inside` if it is given."""
    field = KernelField(atoms)
    centre = body.bounds().mean(0)

    def draw(cut: tuple[Plane, tuple[float, float, float]]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        plane, (tilt, turn, _) = cut
        fov = np.radians(30.0)
        # From the removed side and a little above, so that both the face and the skin around it are visible.
        elevation = max(18.0, 90.0 - tilt - 25.0)
        camera = orbit(centre, up, turn + 28.0, elevation, fit_distance(body.radius, fov, 1.0), TILE, TILE, fov)
        ahead = section(plane, up, body.bounds(), TILE, body.radius)
        opened = opaque.render(atoms, camera, [plane], light=True, field=field)
        straight = opaque.render(atoms, ahead, [plane], light=False, field=field)
        if inside is not None:
            piece, solid = Piece((plane,)), Detailed(inside, atoms.pitch)
            reading = read_face(straight, ahead, piece, solid)  # once for both pictures: this takes the time
            opened = detailed_from(reading, opened, camera, piece, solid, True)
            straight = detailed_from(reading, straight, ahead, piece, solid, False)
        return opened.rgb, straight.rgb

    tiles = side_by_side(draw, list(zip(contact_sheet_planes(body, up), CUTS, strict=True)))
    save_png(path, np.concatenate([np.concatenate(row, axis=1) for row in zip(*tiles, strict=True)]))
