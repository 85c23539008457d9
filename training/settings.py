"""Levels of detail of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["DETAILS", "Detail", "DetailName"]

DetailName = Literal["draft", "standard", "high"]


@dataclass(frozen=True)
class Detail:
    """Resolutions and step counts behind one level of detail."""

    cells: int
    """The body's longest side / cells is the pitch, the largest size of surface atoms."""
    tolerance: float
    """A Gaussian whose opacity after compositing is less than this in its best view becomes no atom. Range (0, 1)."""
    fine: int
    """Cells along the longest side in the lattice of the finest interior atoms."""
    voxels: int
    """Cells along the longest side of the volume that a prior solves."""
    label: int
    """Pixels of a square label picture."""
    surface: int
    """Pixels of a square surface view."""
    surface_views: int
    """Surface views of the input that training draws from."""
    iterations: int
    """Most iterations of a run that trains; the stop rule may end it sooner."""
    skin_views: int
    """Views of the capture that the skin is fitted to."""
    skin_steps: int
    """Optimisation steps of the skin's means, scales, rotations and colours."""
    skin_size: int
    """Pixels of a square view of the capture that the skin is fitted to."""


# The paper takes 120 to 200 iterations, 10 to 20 surface views in each, and labels of the diffusion model's size.
# Volume and lattice are equally fine: in draft a volume of 80 cells under a lattice of 112 raises the orange's patch
# distance by half and saves no measurable time (benchmarks/presets).
# Tolerances of 0.025, 0.05, 0.1 and 0.2 make 64, 49, 35 and 22 thousand skin atoms of a capture of a guitar, at 25.6,
# 25.4, 25.3 and 24.4 dB in unseen views after a quarter of the standard steps. Standard is at the knee: high doubles
# the atoms for at most 0.2 dB, and draft is 4 to 7 dB under it in a quarter of the time or less
# (docs/charts/fidelity.png). With 60, 90 and 120 views the guitar is at 26.8, 26.9 and 27.1 dB. With 480 and 600 steps
# the guitar is at 27.0 and 27.3, a donut at 35.9 and 36.2, a plant at 31.6 and 31.8, a box at 26.8 and 26.9, for 20 %
# more time. Splitting a tenth of the atoms where the gradients of means are largest gained nothing there (guitar 26.9,
# box 26.5).
# Colours of the sample watermelon fitted to 60 views score 2 dB better on held-out views than those fitted to 24.
DETAILS: dict[DetailName, Detail] = {
    "draft": Detail(
        cells=64,
        tolerance=0.1,
        fine=112,
        voxels=112,
        label=128,
        surface=128,
        surface_views=24,
        iterations=40,
        skin_views=48,
        skin_steps=80,
        skin_size=384,
    ),
    "standard": Detail(
        cells=104,
        tolerance=0.05,
        fine=192,
        voxels=192,
        label=256,
        surface=192,
        surface_views=60,
        iterations=120,
        skin_views=120,
        skin_steps=600,
        skin_size=512,
    ),
    "high": Detail(
        cells=160,
        tolerance=0.025,
        fine=256,
        voxels=256,
        label=384,
        surface=256,
        surface_views=60,
        iterations=200,
        skin_views=120,
        skin_steps=800,
        skin_size=640,
    ),
}
