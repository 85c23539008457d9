"""Colours as mixtures of a printer's materials: each voxel is one drop of one of them, right on average.

A colour is a mixture of inks in linear light, as drops too small to see add up. Of all mixtures that give it, the one
of the inks nearest to it is used, which looks least grainy. Voxels are then visited in order; each takes the ink that
it is owed most, and passes its excess or lack of each ink on to the neighbours still to come, in its layer and in the
next (error diffusion, Floyd and Steinberg 1976, in three dimensions as Lou and Stucki 1998). As debts are in shares of
ink and not in colours, they stay small for a colour that no mixture gives: it becomes the nearest one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage, optimize

from engine.light import as_linear

__all__ = ["halftoned"]

NODES = 33
"""Colours along each channel for which mixtures are sought; between them shares of ink are interpolated, which errs by
less than 0.002 in linear light."""

SURE = 1e3
"""Weight of a mixture's colour and of its shares' sum against how far its inks are from the colour."""

BELOW = 0.5
"""Share of a debt that goes to the next layer: as much as stays in its own, so that no direction is preferred."""

CHANCE = 1.0
"""Drops. Largest random number added to what an ink is owed before the largest is taken. Without it, drops of a rare
ink all fall in one layer; by the spread of means over layers and over blocks, half and double are worse."""


def halftoned(
    rgb: NDArray[np.uint8], filled: NDArray[np.bool_], inks: Sequence[tuple[int, int, int]]
) -> NDArray[np.uint8]:
    """(X, Y, Z). Number of the ink that each filled cell shows; 0 elsewhere.

    `rgb` (X, Y, Z, 3): colours in sRGB, range [0, 255]. `filled` (X, Y, Z): cells that are printed. `inks`: sRGB of the
    materials as they are seen, 2 to 255 of them. Layers are printed along the third axis. Bit-equal for the same cells.
    """
    shares = _mixtures(as_linear(np.array(inks) / 255).astype(np.float32))
    out = np.zeros(filled.shape, np.uint8)
    width, height, layers = filled.shape
    rng = np.random.default_rng(0)
    owed = np.zeros((2, width + 2, height + 2, len(inks)), np.float32)
    for z in range(layers):
        here, below = filled[:, :, z], filled[:, :, min(z + 1, layers - 1)] & (z + 1 < layers)
        at = np.moveaxis(rgb[:, :, z], -1, 0) * ((NODES - 1) / 255)
        wanted = np.stack([ndimage.map_coordinates(share, at, order=1, output=np.float32) for share in shares], -1)
        chance = CHANCE * rng.random(wanted.shape, np.float32)
        _print_layer(wanted, here, below, chance, owed[z % 2], owed[1 - z % 2], out[:, :, z])
        owed[z % 2] = 0
    return out


def _mixtures(inks: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, NODES, NODES, NODES). Shares of inks (N, 3) in linear light whose mean is nearest to each colour of sRGB."""
    axis = np.arange(NODES) * (255 / (NODES - 1))
    colours = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    colours = as_linear(colours / 255).astype(np.float32)
    found = np.empty((len(colours), len(inks)))
    sums = np.concatenate([SURE * inks.T, np.full((1, len(inks)), SURE * SURE)])
    for n, colour in enumerate(colours):
        apart = np.diag(np.linalg.norm(inks - colour, axis=1))
        goal = np.concatenate([SURE * colour, [SURE * SURE], np.zeros(len(inks))])
        found[n] = optimize.nnls(np.concatenate([sums, apart]), goal)[0]
    found /= found.sum(1, keepdims=True)
    return np.ascontiguousarray(found.T, np.float32).reshape(-1, NODES, NODES, NODES)


@njit(cache=True, nogil=True)
def _print_layer(
    wanted: NDArray[np.float32],  # [X, Y, N]
    here: NDArray[np.bool_],  # [X, Y], cells of this layer
    below: NDArray[np.bool_],  # [X, Y], cells of the next one
    chance: NDArray[np.float32],  # [X, Y, N]
    owed: NDArray[np.float32],  # [X + 2, Y + 2, N], to this layer, with a margin
    later: NDArray[np.float32],  # [X + 2, Y + 2, N], to the next one; out
    out: NDArray[np.uint8],  # [X, Y]
) -> None:
    """Prints one layer; every other row runs backwards."""
    width, height, count = wanted.shape
    debt = np.empty(count, np.float32)
    for i in range(width):
        step = 1 if i % 2 == 0 else -1
        for n in range(height):
            j = n if step > 0 else height - 1 - n
            if not here[i, j]:
                continue
            best, most = 0, np.float32(-np.inf)
            for k in range(count):
                debt[k] = wanted[i, j, k] + owed[i + 1, j + 1, k]
                worth = debt[k] + chance[i, j, k] if debt[k] > 0 else debt[k]
                if worth > most:
                    best, most = k, worth
            out[i, j] = best
            debt[best] -= np.float32(1)
            # The debt goes to those of the layer's four next cells, and of the nine below, that are printed.
            ahead = np.float32(0)
            for di in range(2):
                for dj in range(-1, 2):
                    a, b = i + di, j + dj * step
                    if (di > 0 or dj > 0) and a < width and 0 <= b < height and here[a, b]:
                        ahead += _part(di, dj)
            under = np.float32(0)
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    a, b = i + di, j + dj
                    if 0 <= a < width and 0 <= b < height and below[a, b]:
                        under += _part_below(di, dj)
            down = np.float32(BELOW) if ahead > 0 and under > 0 else np.float32(1 if under > 0 else 0)
            for di in range(2):
                for dj in range(-1, 2):
                    a, b = i + di, j + dj * step
                    if (di > 0 or dj > 0) and a < width and 0 <= b < height and here[a, b]:
                        for k in range(count):
                            owed[a + 1, b + 1, k] += (1 - down) * _part(di, dj) / ahead * debt[k]
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    a, b = i + di, j + dj
                    if 0 <= a < width and 0 <= b < height and below[a, b]:
                        for k in range(count):
                            later[a + 1, b + 1, k] += down * _part_below(di, dj) / under * debt[k]


@njit(cache=True, nogil=True, inline="always")
def _part(di: int, dj: int) -> np.float32:
    """Floyd and Steinberg's sixteenths, for the next cell and the three in the next row."""
    if di == 0:
        return np.float32(7)
    return np.float32(3) if dj < 0 else np.float32(5) if dj == 0 else np.float32(1)


@njit(cache=True, nogil=True, inline="always")
def _part_below(di: int, dj: int) -> np.float32:
    """Shares by distance: most for the cell below, least for those below its corners."""
    return np.float32(4 >> (abs(di) + abs(dj)))
