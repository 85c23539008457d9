"""The exemplar patches of one family, laid out so that the exact search is fast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.exemplar.frames import Sheet
from training.exemplar.patches import BOX, LANES, OVER, PATCH, project_pixels

__all__ = ["Atlas", "Library", "make_atlas", "make_library"]

COEFFICIENTS = 32
"""PCA coefficients of a patch: over 97 % of the variance of photographs (DESIGN 5.1, step 4)."""

FEWEST, MOST = 150, 3000
"""Candidates per gate cell: under the first the nearest others are added, over the second they are thinned."""

FAR = 1e3
"""Coefficient of a padding lane: never the nearest."""


@dataclass(frozen=True)
class Atlas:
    """All sheets of all families in one array, so that a vote needs to know no more than a pixel's number."""

    colours: NDArray[np.float32]
    """(T, 3)."""
    images: NDArray[np.int64]
    """(E, 3). First row in `colours`, height, width."""
    image: NDArray[np.int32]
    """(P,). Picture of each candidate pixel."""
    xy: NDArray[np.float32]
    """(P, 2). Place in its picture, cells."""
    ab: NDArray[np.float32]
    """(P, 4). Directions a and b."""
    gate: NDArray[np.float32]
    """(P, 3). Gate coordinates."""
    spans: list[tuple[int, int]]
    """First and last + 1 candidate pixel of each family."""

    def pixel_colours(self) -> NDArray[np.float32]:
        """(P, 3). Colour at each candidate pixel."""
        offset, _, width = self.images[self.image].T
        column, row = (self.xy * OVER + 0.5).astype(np.int64).T
        return self.colours[offset + row * width + column]


def make_atlas(families: list[list[Sheet]]) -> Atlas:
    """Joins the sheets of all families."""
    sheets = [s for family in families for s in family]
    sizes = [s.rgb.shape[0] * s.rgb.shape[1] for s in sheets]
    starts = np.cumsum([0, *sizes])
    counts = np.cumsum([0, *[sum(len(s.xy) for s in family) for family in families]])
    return Atlas(
        np.concatenate([s.rgb.reshape(-1, 3) for s in sheets]),
        np.array([[at, *s.rgb.shape[:2]] for at, s in zip(starts, sheets, strict=False)], np.int64),
        np.repeat(np.arange(len(sheets), dtype=np.int32), [len(s.xy) for s in sheets]),
        np.concatenate([s.xy for s in sheets]),
        np.concatenate([s.ab for s in sheets]),
        np.concatenate([s.gate for s in sheets]),
        [(int(a), int(b)) for a, b in zip(counts[:-1], counts[1:], strict=True)],
    )


@dataclass(frozen=True)
class Library:
    """Patches of a family as PCA coefficients, and for each gate cell the blocks of its candidates."""

    mean: NDArray[np.float32]
    """(147,)."""
    axes: NDArray[np.float32]
    """(147, D)."""
    features: NDArray[np.float32]
    """(P, D). Of this family's pixels, numbered from 0."""
    starts: NDArray[np.int64]
    """(L + 1,). First block of each list."""
    blocks: NDArray[np.float32]
    """(B, D, LANES)."""
    low: NDArray[np.float32]
    """(B, BOX). Bounding boxes of the leading coefficients."""
    high: NDArray[np.float32]
    members: NDArray[np.int32]
    """(B, LANES). Pixel of each lane, -1 for padding."""
    lists: NDArray[np.int32]
    """(M,). The candidate list of each query."""


def make_library(atlas: Atlas, family: int, gate: NDArray[np.float32], everything: bool = False) -> Library:
    """The library of one family for queries with gate coordinates (M, 3).

    With `everything` each list holds every pixel within the neighbouring cells, for the search without shortcuts.
    """
    start, stop = atlas.spans[family]
    patches = np.empty((stop - start, PATCH), np.float32)
    part = slice(start, stop)
    project_pixels(atlas.colours, atlas.images, atlas.image[part], atlas.xy[part], atlas.ab[part], patches)
    mean = patches.mean(0, dtype=np.float64)
    centred = patches - mean.astype(np.float32)
    covariance = centred.T.astype(np.float64) @ centred
    axes = np.linalg.eigh(covariance)[1][:, ::-1][:, :COEFFICIENTS].astype(np.float32)
    features = np.ascontiguousarray(centred @ axes)
    own = atlas.gate[part]
    # The queries that share a gate cell share a list.
    corner = np.floor(gate).astype(np.int64)
    keys = corner @ np.array([1_000_000, 1_000, 1])
    _, first, lists = np.unique(keys, return_index=True, return_inverse=True)
    starts, blocks, members = [0], [], []
    for at in corner[first] + 0.5:
        near = np.flatnonzero((np.abs(own - at) <= 1.5).all(1))
        if len(near) < FEWEST:
            near = np.argsort(((own - at) ** 2).sum(1), kind="stable")[:FEWEST]
        elif len(near) > MOST and not everything:
            near = near[np.linspace(0, len(near) - 1, MOST).astype(int)]
        packed, who = _pack(features, near.astype(np.int32))
        blocks.append(packed)
        members.append(who)
        starts.append(starts[-1] + len(who))
    joined = np.concatenate(blocks)
    leading = joined[:, :BOX]
    padding = leading >= FAR
    return Library(
        mean.astype(np.float32),
        axes,
        features,
        np.array(starts, np.int64),
        joined,
        np.where(padding, np.inf, leading).min(-1).astype(np.float32),
        np.where(padding, -np.inf, leading).max(-1).astype(np.float32),
        np.concatenate(members),
        lists.astype(np.int32),
    )


def _pack(features: NDArray[np.float32], near: NDArray[np.int32]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Candidates in blocks (B, D, LANES) of neighbours: halved again and again along one coefficient after another."""
    levels = max(0, int(np.ceil(np.log2(max(len(near), 1) / LANES))))
    order = np.full(LANES << levels, -1, np.int32)
    order[: len(near)] = near
    padded = np.concatenate([features, np.full((1, features.shape[1]), FAR, np.float32)])
    order = order.reshape(1, -1)
    for level in range(levels):
        ranks = np.argsort(padded[order, level % BOX], axis=1, kind="stable")
        order = np.take_along_axis(order, ranks, 1).reshape(2 << level, -1)
    order = order[(order >= 0).any(1)]
    return np.ascontiguousarray(padded[order].transpose(0, 2, 1)), order
