"""A hollow capture as loaded."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.io.load import LoadedScene
from engine.io.load import load as load_scene
from engine.io.trained import Meta
from engine.isolate.record import isolation_record
from engine.isolate.selection import Sphere, isolated, without_surroundings
from engine.isolate.surroundings import object_ball
from engine.scene.gaussians import Gaussians
from engine.solid.up_axis.detect import detect_up
from fruitninja.arguments import PathLike, Progress, Shapes, UpLike, as_detail, as_isolation, as_seed, as_up
from fruitninja.solid import Solid, Whole
from training.settings import DETAILS

__all__ = ["Capture", "load"]


@dataclass(frozen=True, eq=False)
class Capture:
    """The N Gaussians of a 3DGS capture, or of a mesh whose surface was sampled. They are moved near the origin if they
    lay far from it (`gaussians.origin`)."""

    path: Path
    """The file that it was loaded from."""
    scene: LoadedScene

    def __repr__(self) -> str:
        return f"<Capture {self.path.name}: {len(self):,} Gaussians>"

    def __len__(self) -> int:
        return len(self.gaussians)

    @property
    def gaussians(self) -> Gaussians:
        """All of the capture's arrays."""
        return self.scene.gaussians

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out or repaired while reading the file, one line each."""
        return self.scene.warnings

    @property
    def means(self) -> NDArray[np.float32]:
        """(N, 3). Centres, units of the file."""
        return self.gaussians.means

    @property
    def scales(self) -> NDArray[np.float32]:
        """(N, 3). Standard deviations along the axes, units of the file."""
        return self.gaussians.scales

    @property
    def quats(self) -> NDArray[np.float32]:
        """(N, 4). Unit quaternions, wxyz."""
        return self.gaussians.quats

    @property
    def opacities(self) -> NDArray[np.float32]:
        """(N,). Range [0, 1]."""
        return self.gaussians.opacities

    @property
    def sh(self) -> NDArray[np.float32]:
        """(N, (d+1)^2, 3). Spherical harmonics of degree d = 0..3."""
        return self.gaussians.sh

    @cached_property
    def middle(self) -> Sphere | None:
        """The ball that holds the object and some of its floor, if the capture also shows the room or view around it;
        None if it shows the object alone. `keep=[capture.middle]` leaves out the rest."""
        found = object_ball(self.gaussians)
        return None if found is None else Sphere(*found)

    def solidify(
        self,
        *,
        detail: str = "standard",
        up: UpLike | None = None,
        keep: Shapes = (),
        seed: int = 0,
        progress: Progress | None = None,
    ) -> Solid:
        """Makes a solid that is grey inside, for cutting and measuring without pictures; its skin is fitted to the
        capture as `grow` does. Bit-equal for equal arguments.

        `detail`: draft, standard or high. `up`: x, y, z, -x, -y, -z or a vector (3,); None: detected. `keep`: shapes
        that contain the object; what lies outside all of them is left out. `progress` may raise an exception to end the
        work, which is passed on. Raises Error if the capture encloses nothing.
        """
        # These import torch, which those who only look at solids need not wait for.
        from engine.solid.solidify import find_enclosure, solidify
        from training.skin import match_skin

        def report(stage: str, part: float = 0.0) -> None:
            if progress is not None:
                progress(stage, part)

        fineness, axis, isolation = DETAILS[as_detail(detail)], as_up(up), as_isolation(keep)
        seed = as_seed(seed)
        gaussians, _ = isolated(self.gaussians, isolation, self.path.name)
        report("body")
        enclosure = find_enclosure(gaussians, fineness.cells, self.path.name)
        if axis is None:  # detected before isolation: even a floor that is left out shows which way is up
            x, y, z = detect_up(without_surroundings(self.gaussians), self.scene.file_axes).axis.tolist()
            axis = x, y, z
        report("atomise")
        atoms, _ = solidify(enclosure, fineness.cells, fineness.tolerance, seed)
        report("refit")
        refit = partial(report, "refit")
        atoms = match_skin(atoms, enclosure.shell, enclosure.body, np.array(axis), fineness, seed, refit)
        meta = Meta(
            axis,
            seed=seed,
            source=self.path.name,
            origin=self.gaussians.origin,
            isolation=tuple(isolation_record(isolation)),
        )
        return Solid(Whole(atoms, meta, None, self.path))


def load(path: PathLike, *, seed: int = 0) -> Capture:
    """Reads a capture (.ply, .splat, .spz, .sog, .ksplat, .glb) or a textured mesh (.obj, .glb, .ply, .stl), whose
    surface is sampled with `seed`. Raises Error for any other file."""
    return Capture(Path(path), load_scene(Path(path), as_seed(seed)))
