"""Sweeps over labels, against the same written plainly."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.threads import cores, use_cores
from training.priors.exemplar.quilting.choice import Question
from training.priors.exemplar.quilting.seams import NO_SEAM, improve_labels

NEIGHBOURS = [
    *((step * np.eye(3, dtype=int)[axis], 1.0) for axis in range(3) for step in (-1, 1)),
    *((np.array(corner), 0.5) for corner in itertools.product((-1, 1), repeat=3)),
]
"""Steps to the cells that a cell shares seams with, and how much each counts."""


def test_each_cell_gets_its_cheapest_label() -> None:
    rng = np.random.default_rng(0)
    inside = rng.random((9, 8, 7)) < 0.8
    number = np.where(inside, np.cumsum(inside).reshape(inside.shape) - 1, -1).astype(np.int32)
    cells, weight = np.argwhere(inside).astype(np.int32), 0.4
    colours = rng.random((len(cells), 5, 3)).astype(np.float32)
    costs = rng.random((len(cells), 5)).astype(np.float32)
    costs[:, 3] = costs[:, 1]  # of labels that cost the same, the first is chosen
    colours[:, 3] = colours[:, 1]
    found = costs.argmin(1).astype(np.int32)
    wanted = found.copy()
    improve_labels(found, number, cells, colours, costs, weight, 1)
    row = {tuple(cell): n for n, cell in enumerate(cells)}
    order = sorted(range(len(cells)), key=lambda n: tuple(cells[n, ::-1] & 1))
    for n in order:
        energy = costs[n].astype(np.float64)
        for step, share in NEIGHBOURS:
            m = row.get(tuple(cells[n] + step))
            if m is None:
                continue
            apart = sum(np.linalg.norm(c - c[wanted[m]], axis=1) for c in colours[[n, m]].astype(np.float64))
            energy += weight * share * (apart + NO_SEAM) * (np.arange(5) != wanted[m])
        wanted[n] = energy.argmin()
    assert np.array_equal(found, wanted)
    assert (found != costs.argmin(1)).mean() > 0.1


def test_any_number_of_threads_gives_the_same() -> None:
    number, cells, colours, costs = _cube(20)
    found, before = [], cores()
    for count in (1, 3):
        use_cores(count)
        labels = costs.argmin(1).astype(np.int32)
        improve_labels(labels, number, cells, colours, costs, 0.5, 2)
        found.append(labels)
    use_cores(before)
    assert np.array_equal(*found)


def test_cells_that_are_not_looked_at_again_would_not_change() -> None:
    number, cells, colours, costs = _cube(20)
    at_once = costs.argmin(1).astype(np.int32)
    one_by_one = at_once.copy()
    improve_labels(at_once, number, cells, colours, costs, 0.2, 6)
    for _ in range(6):  # each looks at all cells
        before = one_by_one.copy()
        improve_labels(one_by_one, number, cells, colours, costs, 0.2, 1)
    assert np.array_equal(at_once, one_by_one)
    assert not np.array_equal(before, costs.argmin(1))


def test_what_is_not_in_question_is_never_read() -> None:
    number, cells, colours, costs = _cube(20)
    rough = np.random.default_rng(2).standard_normal((4, 20, 20, 20))
    start = np.stack([ndimage.gaussian_filter(r, 3) for r in rough]).argmax(0).astype(np.int32)
    question = Question.near(start.ravel(), number, cells, 4)
    for reach, found in ((1, question.open), (2, question.beside)):
        block = np.ones((2 * reach + 1,) * 3)
        wanted = np.stack([ndimage.binary_dilation(start == n, block) for n in range(4)], -1)
        assert np.array_equal(found, wanted.reshape(-1, 4))
    assert 0.3 < question.beside.mean() < 0.9
    costs[~question.open] = np.inf
    found, known = start.ravel().copy(), start.ravel().copy()
    improve_labels(known, number, cells, colours, costs, 0.2, 6)
    colours[~question.beside] = np.nan
    improve_labels(found, number, cells, colours, costs, 0.2, 6)
    assert np.array_equal(found, known)
    assert question.open[np.arange(len(found)), found].all()
    assert (found != start.ravel()).mean() > 0.1


def _cube(size: int) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Rows of a cube's cells, the cells, and random colours and costs of four labels at them."""
    rng = np.random.default_rng(1)
    number = np.arange(size**3, dtype=np.int32).reshape(size, size, size)
    cells = np.argwhere(number >= 0).astype(np.int32)
    return number, cells, rng.random((len(cells), 4, 3), np.float32), rng.random((len(cells), 4), np.float32)
