"""Seconds of a frame of a trained object, in a process whose threads somebody else has limited.

    python -m benchmarks.threads.frames TRAINED.ply [--quick]

Prints one JSON object: threads, least seconds of each kind of frame, and a digest of all their pixels and gradients.
The object is cut once. `benchmarks.threads` starts this.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from benchmarks.support.timing import timed
from engine.fit.differentiable import AtomTensors, opaque_image
from engine.io.trained import load_trained
from engine.render.cpu import opaque
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.software import SoftwareMode
from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.drawable import Drawable
from engine.render.culling.groups import group_pieces
from engine.render.face_detail import Detailed, detailed
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, fit_distance, orbit
from engine.scene.inside import Inside
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.threads import cores, one_thread_for_blas
from training.priors.inside_file import read_inside

__all__ = ["main"]

SIZE = 1280, 720
FOV = 0.6
"""Vertical field of view in radians, about that of the window."""

TILT = np.array([0.1, 0.05, 0.0])
"""Added to up for the cut's normal: a plane that follows no axis."""

WHOLE, CLOSE = 1.12, 0.5
"""Radii of the object in half a picture's height: all of it, and a face that fills the picture."""

FRAMES, PATIENCE = 7, 3.0
"""Most frames of a kind, and seconds after which no other is begun."""

Frame = Callable[[int], object]
"""Draws the frame of a step, in degrees around the object; returns arrays for the digest."""


def kinds_of_frames(atoms: Atoms, inside: Inside, up: np.ndarray) -> dict[str, Frame]:
    """What is timed, by name."""
    low, high = atoms.bounds.astype(np.float64)
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 12**0.5
    plane = Plane.through(centre, up + TILT)
    piece = Piece((plane,))
    field, solid, software = KernelField(atoms), Drawable(atoms), SoftwareMode()
    tensors = trainable(atoms)
    outer = torch.rand(SIZE[1], SIZE[0], 3, generator=torch.Generator().manual_seed(1))
    options = DrawOptions(interior_only=False, light=True, exact=False, level=0, cull=True)

    def view(step: int, elevation: float, radii: float) -> Camera:
        away = fit_distance(radii * radius, FOV, SIZE[0] / SIZE[1])
        return orbit(centre, up, 30 + step, elevation, away, *SIZE, FOV)

    close = view(0, 70, CLOSE)
    still = opaque.render(atoms, close, (plane,), light=True, field=field)

    def reference(step: int) -> object:
        return opaque.render(atoms, view(step, 35, WHOLE), (plane,), light=True, field=field).rgb

    def with_gradient(step: int) -> object:
        for leaf in leaves(tensors):
            leaf.grad = None
        rgb, _ = opaque_image(tensors, view(step, 35, WHOLE), (plane,))
        rgb.backward(outer)
        return [rgb.detach().numpy(), *(leaf.grad.numpy() for leaf in leaves(tensors) if leaf.grad is not None)]

    def window(step: int) -> object:
        for _ in range(1 if step else 2):  # it makes the grid of a plane when it draws the plane again
            camera = view(step, 35, WHOLE)
            _, pixels = software.draw([solid], camera, (piece,), group_pieces((piece,)), np.ones(3), options)
        return pixels

    def face(step: int) -> object:
        return detailed(still, close, [piece], [Detailed(inside, atoms.pitch)], light=True).rgb

    return {
        "reference": reference,
        "reference, forward and backward": with_gradient,
        "window": window,
        "face at rest": face,
    }


def trainable(atoms: Atoms) -> AtomTensors:
    """All parameters of the atoms, each with a gradient."""
    tensors = AtomTensors.of(atoms)
    names = [field.name for field in fields(tensors) if isinstance(getattr(tensors, field.name), torch.Tensor)]
    return replace(tensors, **{name: getattr(tensors, name).requires_grad_() for name in names})


def leaves(tensors: AtomTensors) -> list[torch.Tensor]:
    """The parameters."""
    values = (getattr(tensors, field.name) for field in fields(tensors))
    return [value for value in values if isinstance(value, torch.Tensor)]


def least_seconds(draw: Frame, most: int) -> float:
    """Least wall time of a frame."""
    spent: list[float] = []
    while len(spent) < most and sum(spent) < PATIENCE:
        spent.append(timed(partial(draw, len(spent) + 1))[0])
    return min(spent)


def main(arguments: list[str] | None = None) -> None:
    """Times all kinds of frames."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trained", type=Path)
    parser.add_argument("--quick", action="store_true", help="one frame of each kind")
    options = parser.parse_args(arguments)
    one_thread_for_blas()
    torch.set_num_threads(1)  # as training does: the kernels use all cores
    atoms, meta = load_trained(options.trained)
    inside = read_inside(options.trained)
    assert inside is not None, f"{options.trained} has only its atoms"
    seconds, digest = {}, hashlib.sha256()
    for name, draw in kinds_of_frames(atoms, inside, np.asarray(meta.up, np.float64)).items():
        shown = draw(0)  # not timed: it loads or compiles the kernels
        for array in shown if isinstance(shown, list) else [shown]:
            digest.update(np.ascontiguousarray(array).tobytes())
        seconds[name] = round(least_seconds(draw, 1 if options.quick else FRAMES), 4)
    print(json.dumps({"threads": cores(), "seconds": seconds, "digest": digest.hexdigest()[:16]}))


if __name__ == "__main__":
    main()
