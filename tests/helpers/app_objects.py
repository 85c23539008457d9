"""A project in which no field has its default, and a small ball of atoms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from app.model.camera_control import OrbitCamera
from app.model.document import Document, Part, Training
from app.model.film.timeline import FilmLook, SceneKeyframe, Timeline
from app.model.measure.units import Unit
from app.model.project import Project, Viewing
from app.model.rigid_transform import Motion
from engine.isolate.selection import BodyAt, Box, Lasso, Step, View, keep_only
from engine.render.culling.draw_options import SplatLook
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.plane import Plane
from training.faces.marks import Marks
from training.families import Family


def full(folder: Path) -> Project:
    """A project of two objects; in the first nothing has its default value."""
    document = Document(scene=folder / "scenes" / "melon.ply", up=(0.0, -1.0, 0.0), gap=0.3, explode=0.1 + 0.2)
    document = document.with_cut((Part(Plane.of((1, 2, 3), 0.1)),))
    document = document.with_cut((Part(Plane.of((-1, 1 / 3, 0), 0.7), ((1, -1),)), Part(Plane.of((0, 1, 0), 0.2))))
    document = document.with_cut((Part(Plane.of((0, 0, 1), 0.0)),), "Plane", "section")
    document = document.changed_cut(2, lambda cut: replace(cut, shift=1e-17, on=False, name="Käse"))
    motion = Motion.about((0.1, 0.2, 0.3), (1, 1, 1), 33.3)
    document = document.placed(((1, 1),), lambda p: replace(p, motion=motion, visible=False, removed=True, name="lid"))
    document = document.placed(((1, -1),), lambda p: replace(p, group="Hälften", mark="star"))
    document = document.with_exemplars("horizontal", (folder / "a.png", folder / "b.png"))
    outline = ((0.1, 0.2), (0.9, 1 / 3), (0.5, 1.0))
    marks = Marks(outline, (0.5, 1 / 3), ((0.5, 0.0), (2 / 3, 1.0)))
    document = document.with_marks("horizontal", folder / "b.png", marks)
    document = document.with_family(
        Family("parallel", 12, (folder / "c.png",), "rye bread", (0.0, 1.0, 0.0), (), (0.1, 2 / 3))
    )
    document = document.with_family(Family("custom", 1, custom=(Plane.of((3, 1, 2), 0.4),)))
    document = replace(
        document,
        training=Training("high", "stable-diffusion", 7, 50, folder / "out", folder / "model", "rye bread", True),
    )
    view = View((0.1, 1 / 3, -2.0), (0.6, 0.0, 0.8, 0.0), (0.5, 0.4))
    lasso = Step("add", Lasso(view, ((-1.0, 0.0), (1.0, 0.1), (0.0, 0.9))))
    box = Box((-1.0, 0.0, 0.1), (1.0, 1 / 3, 2.0), (0.0, 0.0, 0.0, 1.0))
    document = replace(document, isolation=(keep_only(box),), selection=(lasso, Step("grow")))
    eye = OrbitCamera((0.1, 1e9, -3.0), 12.5, -90.0, 1 / 3, 50.0, True)
    document = replace(document, number=1, name="Käse", visible=False)
    other = Document(document.scene, isolation=(keep_only(BodyAt((0.1, 1 / 3, -2.0))),), number=7, name="Brot")
    look = FilmLook((1080, 1920), 12.0, "own", (0.1, 1 / 3, 1.0))
    first = SceneKeyframe.of(0.0, eye, (document, other))
    film = Timeline((first, SceneKeyframe.of(1 / 3, replace(eye, azimuth=400.0), (replace(document, cuts=()),))))
    splats = SplatLook(0.5, 0.25)
    viewing = Viewing(eye, "capture", (0.1, 0.2, 0.3), True, (0.5, 0.0, -1.0), Unit("cm", 12.5), True, look, splats)
    return Project((document, other), viewing, film)


def atoms(degree: int = 0) -> Atoms:
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (900, 3)).astype(np.float32)
    quats = rng.normal(size=(300, 4)).astype(np.float32)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = rng.normal(size=(300, (degree + 1) ** 2, 3)).astype(np.float32)
    surface = SurfaceAtoms(points[:300], rng.uniform(0.01, 0.05, (300, 3)).astype(np.float32), quats, sh)
    inside = InteriorAtoms(points[300:], np.full(600, 0.03, np.float32), rng.uniform(0, 1, (600, 3)).astype(np.float32))
    return Atoms(surface, inside, 0.05)
