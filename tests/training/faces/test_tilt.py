"""The error that remains when a face seen obliquely is stretched to a disc.

Each direction from the core is stretched to the outline, which undoes the foreshortening. What remains is the error of
the angles, and the shift of the outline's middle by perspective, which the user's mark on the core removes.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from training.faces.axis import find_core
from training.priors.exemplar.pictures import Picture, fill_outside
from training.priors.exemplar.quilting.disc import Disc, disc_grid

SIZE, RADIUS = 400, 150
DISTANCE = 3.0
"""Distance of the camera from the face, in face widths: as near as a phone focuses on an orange."""


def remaining_error(degrees: float, marked: bool) -> NDArray[np.float64]:
    """Distances in radii between the right places of points of a round face on the disc and their actual places."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    # The colours encode places, so that the disc tells where each of its pixels came from.
    places = np.stack([x, y, np.hypot(x - SIZE / 2, y - SIZE / 2) < RADIUS], -1).astype(np.float32)
    middle, turn = np.array([[1, 0, SIZE / 2], [0, 1, SIZE / 2], [0, 0, 1]]), np.radians(degrees)
    away = np.array([[1, 0, 0], [0, np.cos(turn), 0], [0, -np.sin(turn) / (DISTANCE * 2 * RADIUS), 1]])
    tilted = cv2.warpPerspective(places, middle @ away @ np.linalg.inv(middle), (SIZE, SIZE))
    mask = tilted[..., 2] > 0.5
    code = fill_outside(np.dstack([tilted[..., :2], 0 * mask]).astype(np.float32) / np.float32(SIZE), mask)
    core = (SIZE / 2, SIZE / 2) if marked else find_core(mask)
    disc = Disc.of(Picture(Path("tilted.png"), code, mask, core)).rgb[..., :2] * SIZE - SIZE / 2
    u, v = disc_grid()
    wrong = np.hypot(disc[..., 0] / RADIUS - u, disc[..., 1] / RADIUS + v)  # rows go down
    return wrong[np.hypot(u, v) < 0.95]


@pytest.mark.parametrize(("degrees", "middle", "most"), [(0, 0.01, 0.02), (20, 0.06, 0.08), (30, 0.09, 0.13)])
def test_a_tilted_round_face_is_nearly_round_on_the_disc(degrees: float, middle: float, most: float) -> None:
    wrong = remaining_error(degrees, marked=False)
    assert np.median(wrong) < middle
    assert np.percentile(wrong, 95) < most


@pytest.mark.parametrize(("degrees", "most"), [(20, 0.04), (30, 0.08)])
def test_a_mark_on_the_core_takes_perspective_out(degrees: float, most: float) -> None:
    assert np.percentile(remaining_error(degrees, marked=True), 95) < most
