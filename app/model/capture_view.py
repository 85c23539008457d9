"""The part of a capture that is shown: what the isolations of its objects leave, with selected Gaussians tinted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.model.rigid_transform import Vec3
from engine.isolate.selection import Isolation, Selection, removed, take_step
from engine.scene.gaussians import Gaussians
from engine.scene.sh import rgb_to_sh

__all__ = ["CaptureView", "view_of"]

TINT = 0.7
"""Share of the tint in a selected Gaussian's colour: it stands out on any colour, and the original still shows."""


@dataclass(frozen=True)
class CaptureView:
    """A capture as a document shows it."""

    capture: Gaussians
    isolation: Isolation
    steps: Selection
    tint: Vec3
    """RGB of selected Gaussians. Range [0, 1]."""
    beside: tuple[Isolation, ...]
    """Isolations of the other objects that are shown."""
    left: Gaussians
    """The K Gaussians that the isolation leaves."""
    selected: NDArray[np.bool_]
    """(K,). Which Gaussians of `left` the steps select."""
    shown: Gaussians
    """What is drawn: `left` with the selected Gaussians tinted, then `others`."""
    plain: Gaussians
    """The same as `shown` without a tint."""
    others: Gaussians
    """The Gaussians that the other objects keep."""

    def is_for(
        self,
        capture: Gaussians,
        isolation: Isolation,
        steps: Selection,
        tint: Vec3,
        beside: tuple[Isolation, ...] = (),
    ) -> bool:
        """Whether this view was made from these arguments."""
        same = self.capture is capture and self.tint == tint and self.beside == beside
        return same and self.isolation == isolation and self.steps == steps


def view_of(
    capture: Gaussians,
    isolation: Isolation,
    steps: Selection,
    tint: Vec3,
    before: CaptureView | None = None,
    beside: tuple[Isolation, ...] = (),
) -> CaptureView:
    """The view of a capture. `before`: any earlier view, whose results are reused where they are still valid."""
    if before is not None and before.capture is capture and before.isolation == isolation:
        left = before.left
        done = len(before.steps) if steps[: len(before.steps)] == before.steps else 0
        selected = before.selected if done else np.zeros(len(left), bool)
    else:
        left, done = capture[~removed(capture, isolation)] if isolation else capture, 0
        selected = np.zeros(len(left), bool)
    for step in steps[done:]:
        selected = take_step(left, selected, step)
    if before is not None and before.capture is capture and before.beside == beside:
        others = before.others
    else:
        gone = np.ones(len(capture), bool)
        for other in beside:
            gone &= removed(capture, other)
        others = capture[~gone]
    plain = joined(left, others)
    shown = joined(tinted(left, selected, tint), others) if selected.any() else plain
    return CaptureView(capture, isolation, steps, tint, beside, left, selected, shown, plain, others)


def joined(first: Gaussians, second: Gaussians) -> Gaussians:
    """The Gaussians of both, which must have the same number of spherical harmonics."""
    if not len(second):
        return first
    names = ("means", "scales", "quats", "opacities", "sh")
    arrays = (np.concatenate([getattr(first, name), getattr(second, name)]) for name in names)
    return Gaussians(*arrays, origin=first.origin)


def tinted(gaussians: Gaussians, selected: NDArray[np.bool_], tint: Vec3) -> Gaussians:
    """The Gaussians with the `selected` ones (N,) mixed with a colour; opacities stay as they are."""
    if not selected.any():
        return gaussians
    sh = gaussians.sh.copy()
    sh[selected] *= 1 - TINT
    sh[selected, 0] += TINT * rgb_to_sh(np.array(tint, np.float32))
    return replace(gaussians, sh=sh)
