"""The process that reads a scene and makes it solid; `app.jobs.scene_loader` starts it.

It is a process rather than a thread because the geometry kernels hold the interpreter's lock, and because a process can
be stopped at any moment. It reads one request as JSON from standard input and writes JSON lines to standard output;
arrays go into safetensors files that the lines name.
"""

from __future__ import annotations

import importlib
import json
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save_file
from scipy.spatial import cKDTree

from app.jobs.coarse_picture import coarse_picture
from app.jobs.warmup import warm_up
from app.translation import _
from engine.errors import InputError
from engine.io.fields import Fields
from engine.io.files import WRITE_ERRORS, reason
from engine.io.load import load
from engine.io.trained import is_trained, load_trained
from engine.isolate.record import isolation_record, read_isolation
from engine.isolate.selection import NO_SURROUNDINGS, Isolation, removed
from engine.processes import yield_to_others
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.scene.sh import sh_to_rgb
from engine.solid.find_body import Enclosure
from engine.solid.solidify import find_enclosure, solidify
from engine.solid.up_axis.detect import detect_up
from training.settings import DETAILS, Detail

PLAIN = (0.83, 0.82, 0.80)
"""RGB of an untrained inside: a neutral material that nobody mistakes for a trained texture."""

SKIN_PITCHES = 2.0
"""Depth under the skin, in pitches, over which its colour fades into the plain one: a cut shows a rim, like a shell."""

DRAFT = DETAILS["draft"]
"""Detail of the first solid, which can be cut while the finer one is made, and of the fit of the skin: good enough to
look at until it is fitted better, and done in seconds."""


def main() -> None:
    """Serves one request."""
    request = json.loads(sys.stdin.readline())
    folder, path = Path(request["folder"]), Path(request["scene"])
    try:
        trained = request["trained"]
        isolation = read_isolation(Fields(path, "request"), request["isolation"])
        if request["refit"]:
            _refit(path, isolation, DETAILS[request["detail"]], request["seed"], folder)
        elif is_trained(path):
            _send_trained(path, folder, capture=True)
        else:
            gaussians, up = _load_capture(path, folder, request["seed"], None if request["opened"] else isolation)
            if trained is not None:
                _send_trained(Path(trained), folder, capture=False)
            else:
                detail = DETAILS[request["detail"]]
                _write_line(stage=_("Finding the body"), part=0.15)
                enclosure = find_enclosure(gaussians, detail.cells, path.name)
                del gaussians  # once there is a shell, a large capture need not stay in memory
                _solidify(enclosure, up, detail, request["seed"], folder)
    except InputError as error:
        _write_line(error=str(error))
    except MemoryError:
        _write_line(error=f"{path}: not enough memory for it; close other programs, or choose a coarser detail")
    _write_line(end=True)


def _load_capture(
    path: Path, folder: Path, seed: int, isolation: Isolation | None
) -> tuple[Gaussians, NDArray[np.float64]]:
    """What the isolation leaves of the capture, and the up axis. Sends the whole capture, preceded by a sample if it is
    large.

    `isolation`: None leaves out the surroundings, if there are any.
    """
    _write_line(stage=_("Reading {name}").format(name=path.name), part=0.02)
    coarse = coarse_picture(path)
    if coarse is not None:
        gone, seen = _left_out(coarse.gaussians, isolation)[1:]
        rows = ~gone
        if rows.any():
            up = detect_up(seen, coarse.file_axes)
            _send_arrays(folder, "coarse", _arrays(coarse.gaussians[rows]), {"up": up.axis.tolist()})
    loaded = load(path, seed)
    gaussians = loaded.gaussians
    taken, gone, seen = _left_out(gaussians, isolation)
    up = detect_up(seen, loaded.file_axes)
    reason = up.reason if up.certainty >= 0.5 else f"{up.reason}: a guess"
    facts = {"up": up.axis.tolist(), "reason": reason, "warnings": list(loaded.warnings)}
    facts["isolation"] = isolation_record(taken)
    _send_arrays(folder, "capture", _arrays(gaussians) | {"removed": gone}, facts)
    if gone.all():
        raise InputError(f"{path.name}: nothing is left of the capture; undo, or bring something back")
    return gaussians[~gone] if gone.any() else gaussians, up.axis


def _left_out(gaussians: Gaussians, isolation: Isolation | None) -> tuple[Isolation, NDArray[np.bool_], Gaussians]:
    """The isolation (for None that of the surroundings, if there are any), which Gaussians (N,) it removes, and the
    object with its floor, which shows which way is up."""
    around = removed(gaussians, (NO_SURROUNDINGS,))
    seen = gaussians[~around] if around.any() else gaussians
    if isolation is None:
        return ((NO_SURROUNDINGS,) if around.any() else ()), around, seen
    return isolation, removed(gaussians, isolation), seen


def _solidify(enclosure: Enclosure, up: NDArray[np.float64], detail: Detail, seed: int, folder: Path) -> None:
    """Sends the solid three times: coarse, fine, and with a skin that is fitted in seconds."""
    facts = {"notes": list(enclosure.notes), "trained": False, "rough": False}
    _write_line(stage=_("Making it solid"), part=0.3)
    if detail.cells > DRAFT.cells:
        _send_atoms(folder, plain_solid(enclosure, DRAFT, seed), facts)
        # From here on the object can be cut; what follows only makes it look like the capture.
        load_torch()
        _write_line(stage=_("Making it finer"), part=0.4)
    atoms = plain_solid(enclosure, detail, seed)
    _send_atoms(folder, atoms, facts)
    _write_line(stage=_("Matching the skin"), part=0.6)
    facts["rough"] = detail.skin_steps > DRAFT.skin_steps
    _send_atoms(folder, matched(atoms, enclosure, up, DRAFT, seed), facts)


def _refit(path: Path, isolation: Isolation, detail: Detail, seed: int, folder: Path) -> None:
    """Sends the solid of a capture that is shown already, with a skin that is fitted as closely as training does."""

    def report(part: float) -> None:
        _write_line(part=0.1 + 0.9 * part)

    yield_to_others()
    loaded = load(path, seed)
    gone, seen = _left_out(loaded.gaussians, isolation)[1:]
    up = detect_up(seen, loaded.file_axes).axis
    enclosure = find_enclosure(loaded.gaussians[~gone] if gone.any() else loaded.gaussians, detail.cells, path.name)
    del loaded, seen  # once there is a shell, a large capture need not stay in memory
    report(0.0)
    atoms = matched(plain_solid(enclosure, detail, seed), enclosure, up, detail, seed, report)
    _send_atoms(folder, atoms, {"notes": list(enclosure.notes), "trained": False, "rough": False})


def load_torch() -> None:
    """Imports torch, which fits the skin, in a thread: that takes a second, which the first solid does not wait for."""
    threading.Thread(target=importlib.import_module, args=("torch",), daemon=True).start()


def plain_solid(enclosure: Enclosure, detail: Detail, seed: int) -> Atoms:
    """The solid that an enclosure makes, with a plain inside and a skin that is not fitted."""
    atoms, body = solidify(enclosure, detail.cells, detail.tolerance, seed)
    plain = plain_inside(atoms.surface, atoms.interior, body, atoms.pitch)
    return replace(atoms, interior=replace(atoms.interior, rgb=plain))


def matched(
    atoms: Atoms,
    enclosure: Enclosure,
    up: NDArray[np.float64],
    detail: Detail,
    seed: int,
    progress: Callable[[float], None] = lambda part: None,
) -> Atoms:
    """The atoms with a skin that looks more like the capture."""
    from training.skin import match_skin  # imports torch, which the first solid does not wait for

    return match_skin(atoms, enclosure.shell, enclosure.body, up, detail, seed, progress)


def plain_inside(surface: SurfaceAtoms, interior: InteriorAtoms, body: Body, pitch: float) -> NDArray[np.float32]:
    """(I, 3). RGB of an untrained inside: one plain colour, blended into the skin's colour close to the skin."""
    rgb = np.tile(np.array(PLAIN, np.float32), (len(interior), 1))
    depth = body.at(interior.means)
    near = depth < 1.5 * SKIN_PITCHES * pitch
    if len(surface) and near.any():
        skin = np.clip(sh_to_rgb(surface.sh[:, 0]), 0, 1).astype(np.float32)
        rows = cKDTree(surface.means).query(interior.means[near], k=min(4, len(surface)))[1]
        colour = skin[rows].mean(1) if rows.ndim == 2 else skin[rows]
        weight = np.clip(1.5 - depth[near] / (SKIN_PITCHES * pitch), 0, 1)[:, None].astype(np.float32)
        rgb[near] += weight * (colour - rgb[near])
    return rgb


def _send_trained(path: Path, folder: Path, capture: bool) -> None:
    _write_line(stage=_("Reading {name}").format(name=path.name), part=0.3)
    atoms, meta = load_trained(path)
    axis: dict[str, Any] = {"up": list(meta.up), "reason": "as trained"} if capture else {}
    _send_atoms(folder, atoms, {"notes": [], "trained": True, "rough": False, **axis})
    if capture:  # after the atoms: a trained object is shown solid, and drawing the file's Gaussians takes longer
        gaussians = load(path).gaussians
        nothing = np.zeros(len(gaussians), bool)
        facts = {**axis, "warnings": [], "isolation": []}
        _send_arrays(folder, "capture", _arrays(gaussians) | {"removed": nothing}, facts)


def _send_atoms(folder: Path, atoms: Atoms, facts: dict[str, Any]) -> None:
    warm_up()
    s, i = atoms.surface, atoms.interior
    arrays = {"means": s.means, "scales": s.scales, "quats": s.quats, "sh": s.sh}
    arrays |= {"inside": i.means, "sigmas": i.sigmas, "rgb": i.rgb}
    _send_arrays(folder, "atoms", arrays, {"pitch": float(atoms.pitch), **facts})


def _arrays(gaussians: Gaussians) -> dict[str, NDArray[Any]]:
    g = gaussians
    return {"means": g.means, "scales": g.scales, "quats": g.quats, "opacities": g.opacities, "sh": g.sh}


def _send_arrays(folder: Path, what: str, arrays: dict[str, NDArray[Any]], facts: dict[str, Any]) -> None:
    # A new name each time: the window may still be reading the previous file.
    file = folder / f"{what}_{len(list(folder.iterdir()))}.safetensors"
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    try:
        save_file(contiguous, file)
    except WRITE_ERRORS as error:
        raise InputError(
            f"{folder.parent}: no room in the temporary folder ({reason(error)}); make some, or name another in TMPDIR"
        ) from error
    _write_line(ready=what, file=str(file), facts=facts)


def _write_line(**facts: Any) -> None:
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    main()
