"""Export of pieces, pictures and films from the window."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from app.jobs.export import (
    ffmpeg,
    save_animation,
    save_meshes,
    save_pieces,
    save_still,
    scale_bar,
    section_picture,
)
from app.model.document import WHOLE, Document, Part
from app.model.measure.units import Unit
from app.model.pieces import Cell, PlacedPiece, PointSample, pieces
from app.model.rigid_transform import Motion
from engine.errors import InputError
from engine.export.colours import Colours
from engine.io.load import load
from engine.io.splats.ply import read_ply
from engine.io.writers.solid_gaussians import joined, piece_gaussians
from engine.scene.camera import Camera, plane_points
from engine.scene.moved import rotated_sh
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.scene.sh import colours
from tests.helpers.app_objects import atoms
from tests.helpers.solids import ball


def test_exported_pieces_add_up_to_the_object_and_open_again(tmp_path: Path) -> None:
    solid = atoms()
    document = replace(Document().with_cut((Part(Plane.of((1, 1, 0), 0.1)),)), gap=0.0)
    parts = pieces(document, PointSample.of_atoms(solid))
    assert sum(len(piece_gaussians(solid, part.drawn())) for part in parts) == len(solid)
    count = save_pieces(tmp_path / "all.ply", [(solid, part) for part in parts])
    again, _ = read_ply(tmp_path / "all.ply")
    assert len(again) == count == len(solid) and (again.opacities > 0.99).all()
    assert save_pieces(tmp_path / "half.spz", [(solid, parts[0])]) == len(load(tmp_path / "half.spz").gaussians) < count
    with pytest.raises(InputError, match="nothing to save"):
        save_pieces(tmp_path / "none.ply", [])
    # In metres where the format is, and with as much of the colours by direction as one of them has.
    save_pieces(tmp_path / "all.glb", [(solid, part) for part in parts], metres=0.04)
    plain, small = load(tmp_path / "all.ply").gaussians, load(tmp_path / "all.glb").gaussians
    assert np.ptp(small.means, 0).max() == pytest.approx(0.04 * np.ptp(plain.means, 0).max(), rel=1e-4)
    high = piece_gaussians(atoms(2), parts[0].drawn())
    both = joined([high, plain])
    assert high.sh_degree == both.sh_degree == 2 and plain.sh_degree == 0
    assert np.array_equal(both.sh[: len(high)], high.sh) and np.array_equal(both.sh[len(high) :, :1], plain.sh)
    assert not both.sh[len(high) :, 1:].any()


def test_meshes_lie_where_the_pieces_lie(tmp_path: Path) -> None:
    pytest.importorskip("manifold3d", reason="the export extra is not installed")
    solid = ball(1 / 8)
    document = replace(Document().with_cut((Part(Plane.of((1, 1, 0), 0.1)),)), gap=0.5)
    parts = pieces(document, PointSample.of_atoms(solid))
    path = tmp_path / "all.glb"
    save_meshes(path, parts, Colours(solid, None), (0, 1, 0), 2.0, lambda: False)
    assert not path.exists()
    save_meshes(path, parts, Colours(solid, None), (0, 1, 0), 2.0, lambda: True)
    found = trimesh.load_scene(path).geometry
    assert list(found) == ["Piece_1_1", "Piece_2_2"]
    for mesh, part in zip(found.values(), parts, strict=True):
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        own = part.motion.apply(solid.interior.means[part.drawn()[0].planes[0].distance(solid.interior.means) <= 0])
        assert mesh.is_watertight and np.abs(mesh.bounds / 2 - [own.min(0), own.max(0)]).max() < 2 * solid.pitch


def test_a_turned_piece_is_seen_as_before_from_the_turned_side() -> None:
    solid = atoms(3)
    motion = Motion.about((0, 0, 0), (1, 2, 3), 77)
    directions = np.random.default_rng(2).normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turned = rotated_sh(solid.surface.sh, motion.rotation)
    before, after = colours(solid.surface.sh, directions), colours(turned, directions @ motion.rotation.T)
    assert np.abs(before - after).max() < 1e-4
    lying = PlacedPiece(WHOLE, "", (Cell(),), motion, True, np.arange(0))
    exported = piece_gaussians(solid, lying.drawn())
    own = Motion(tuple(solid.surface.quats[0].astype(np.float64).tolist())).rotation
    assert np.allclose(Motion(tuple(exported.quats[0].tolist())).rotation, motion.rotation @ own, atol=1e-5)


def test_stills_and_animations_open_again(tmp_path: Path) -> None:
    frames = [np.full((20, 31, 4), (index * 20, 100, 200, 255), np.uint8) for index in range(6)]
    frames[0][:5, :, 3] = 0
    save_still(tmp_path / "a.png", frames[0])
    assert np.array_equal(np.asarray(Image.open(tmp_path / "a.png")), frames[0])
    for name in ("a.webp", "a.gif"):
        assert save_animation(tmp_path / name, iter(frames)) == 6
        with Image.open(tmp_path / name) as image:
            assert image.size == (31, 20) and getattr(image, "n_frames", 1) == 6
    # It lasts as long as its frames, though a .gif counts in hundredths of a second.
    save_animation(tmp_path / "a.gif", iter(frames), 24.0)
    with Image.open(tmp_path / "a.gif") as image:
        assert sum(frame.info["duration"] for frame in ImageSequence.Iterator(image)) == 250
    with pytest.raises(InputError, match="ffmpeg" if ffmpeg() is None else "nothing"):
        save_animation(tmp_path / "a.mp4", iter(()))
    for path, call in ((tmp_path / "a.bmp", save_still), (tmp_path / "a.avi", save_animation)):
        with pytest.raises(InputError, match="saved as"):
            call(path, frames[0])
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


STAND_IN = """#!{python}
import sys
from pathlib import Path
words = sys.argv[1:]
if "7x" in words[words.index("-s") + 1] or "6x" in words[words.index("-s") + 1]:
    sys.exit("width not liked")
Path(words[-1]).write_bytes(words[words.index("-s") + 1].encode() + b" " + sys.stdin.buffer.read())
"""


def test_mp4_is_written_by_ffmpeg_and_refused_in_words_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [np.full((21, 31, 4), (index * 20, 100, 200, 255), np.uint8) for index in range(6)]
    if ffmpeg() is not None:
        assert save_animation(tmp_path / "real.mp4", iter(frames)) == 6
        assert (tmp_path / "real.mp4").read_bytes()[4:8] == b"ftyp"
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    with pytest.raises(InputError, match=r"MP4 needs ffmpeg.*choose \.webp or \.gif"):
        save_animation(tmp_path / "a.mp4", iter(frames))
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(STAND_IN.format(python=sys.executable))
    program.chmod(0o755)
    assert save_animation(tmp_path / "a.mp4", iter(frames)) == 6
    said, pixels = (tmp_path / "a.mp4").read_bytes().split(b" ", 1)
    assert said == b"30x20" and len(pixels) == 6 * 30 * 20 * 3 and pixels[-3:] == bytes([100, 100, 200])
    with pytest.raises(InputError, match="width not liked"):
        save_animation(tmp_path / "b.mp4", iter([frame[:, :7] for frame in frames]))

    def stopped() -> Iterator[np.ndarray]:
        yield frames[0]
        raise InputError("cancelled")

    with pytest.raises(InputError, match="cancelled"):
        save_animation(tmp_path / "c.mp4", stopped())
    left = [path.name for path in tmp_path.iterdir() if path.is_file() and path.name != "real.mp4"]
    assert left == ["a.mp4"]  # nothing is left of the failed ones


def test_a_cut_face_fills_its_picture_with_a_scale_below() -> None:
    """An ellipsoid away from the centre: the face is an ellipse of known axes, and the scale is as long as it says."""
    axes = np.array([1.0, 0.6, 0.8])
    points = np.random.default_rng(0).normal(size=(4000, 3))
    solid = PointSample.of((points / np.linalg.norm(points, axis=1, keepdims=True)) * axes + 5.0)
    plane = Plane((0.0, 0.0, 1.0), -5.4)  # halfway up: the face has sqrt(3)/2 of the axes

    def draw(camera: Camera, drawn: Sequence[Piece]) -> NDArray[np.uint8]:
        assert drawn[0].planes[0] == plane and camera.orthographic
        inside = (((plane_points(camera, plane) - 5.0) / axes) ** 2).sum(2) <= 1
        return np.repeat((inside * 255).astype(np.uint8)[..., None], 4, 2)

    picture = section_picture(draw, plane, Piece(), (0.0, 0.0, 1.0), solid, 500, Unit())
    face = picture[: picture.shape[0] - scale_bar(picture.shape[1], 100.0, Unit()).shape[0]]
    assert max(face.shape[:2]) == 500 and abs(min(face.shape[:2]) - (480 * 0.6 + 20)) <= 6
    alpha = face[..., 3] == 255
    for axis in (0, 1):
        ends = np.flatnonzero(alpha.any(axis))
        assert abs(ends[0] - 10) <= 4 and abs(face.shape[1 - axis] - 1 - ends[-1] - 10) <= 4  # the margin on every side
    bar = (picture[len(face) :, : face.shape[1] // 2, 3] > 0)[:, 10:]
    pixels = int(np.logical_and.accumulate(bar, 1).sum(1).max())  # length of the line that begins at the margin
    unit = 480 / (2 * np.sqrt(0.75))
    assert any(abs(pixels - length * unit) <= 4 for length in (0.1, 0.2, 0.5))
    with pytest.raises(InputError, match="does not meet"):
        section_picture(draw_nothing, plane, Piece(), (0.0, 0.0, 1.0), solid, 500, Unit())


def draw_nothing(camera: Camera, _: Sequence[Piece]) -> NDArray[np.uint8]:
    return np.zeros((camera.height, camera.width, 4), np.uint8)
