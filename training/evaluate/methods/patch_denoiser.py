"""A denoising prior from exemplars, for comparisons: the posterior mean over their patches.

Kamb and Ganguli (2024) show that a denoiser with a local receptive field is a softmax over training patches. Here the
field is 7x7 pixels, the patches are those of the exemplars, restricted to similar positions in the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.errors import InputError
from engine.threads import for_spans
from training.families import Family
from training.priors.exemplar.frames import HEIGHT_CELLS, RADIUS_CELLS, Frame, depth_gate, scale_picture
from training.priors.exemplar.patches import FIXED, OVER, PATCH, POLAR, RADIAL, posterior, read_patches
from training.priors.exemplar.pictures import Picture, read_picture
from training.priors.prior import Condition

__all__ = ["PatchDenoiser"]

COEFFICIENTS = 24
"""PCA coefficients compared: over 95 % of the variance of patches of photographs."""

MAX_CANDIDATES = 800
"""Largest number of candidates of a gate cell; more are thinned evenly."""

MIN_CANDIDATES = 100
"""Smallest number of candidates; fewer are replaced by the nearest in gate coordinates."""

MIN_SIGMA = 0.04
"""Smallest assumed noise in colour units, as the exemplars are only samples of the fruit."""


class PatchDenoiser:
    """A denoiser over the patches of each family's exemplars."""

    def __init__(self) -> None:
        self._patches: dict[tuple[Family, int], Patches] = {}

    def denoise(
        self,
        noisy: NDArray[np.float32],  # [H, W, 3]
        sigma: float,
        condition: Condition,
        rng: np.random.Generator,
    ) -> NDArray[np.float32]:
        """(H, W, 3). The noise in `noisy`, of unit variance, relative to the posterior mean over the exemplar patches.

        Does not use `rng`. Raises InputError if the family has no picture, or one shows no cut face.
        """
        family = condition.family
        if not family.exemplars:
            raise InputError(f"family '{family.kind}': no exemplar pictures; give it a photograph of a cut face")
        radius = pixels_per_radius(condition)
        # Scales within two per cent share their patches: photographs are no more precise.
        step = round(np.log(radius) / 0.02)
        key = (family, step)
        if key not in self._patches:
            kind = {"horizontal": POLAR, "radial": RADIAL}.get(family.kind, FIXED)
            pictures = [read_picture(p, family.kind, family.marks_of(p)) for p in family.exemplars]
            self._patches[key] = prepare(pictures, kind, float(np.exp(0.02 * step)), _inradius(condition))
        return (noisy - denoised(noisy, sigma, condition, self._patches[key])) / max(sigma, 1e-6)


@dataclass(frozen=True)
class Patches:
    """The exemplar patches of a family at one scale."""

    kind: Frame
    mean: NDArray[np.float32]
    """(PATCH,)."""
    axes: NDArray[np.float32]
    """(PATCH, D). Orthonormal columns."""
    features: NDArray[np.float32]
    """(P, D)."""
    colours: NDArray[np.float32]
    """(P, 3). Colour at the patch's centre."""
    gate: NDArray[np.float32]
    """(P, 3). Gate coordinates."""


def pixels_per_radius(condition: Condition) -> float:
    """Pixels to the body's greatest radius in the condition's pictures."""
    gy, gx = np.gradient(condition.radius)
    inner = ndimage.binary_erosion(condition.inside, iterations=2)
    slope = np.hypot(gx, gy)[inner]
    steepest = float(np.quantile(slope, 0.9)) if len(slope) else 0.0
    return 1 / steepest if steepest > 1e-6 else float(np.sqrt(max(condition.inside.sum(), 1) / np.pi))


def prepare(pictures: list[Picture], kind: Frame, radius: float, inradius: float) -> Patches:
    """Patches of pictures whose cut face is `radius` pixels in half width; inradius of the body in pixels."""
    scaled_pictures = []
    for picture in pictures:
        rows, columns = np.nonzero(picture.mask)
        half = np.sqrt(len(rows) / np.pi) if kind == POLAR else np.ptp(columns) / 2
        scaled_pictures.append(scale_picture(picture, inradius, kind, radius / max(half, 1.0)))
    patches, colours = [], []
    for scaled in scaled_pictures:
        out = np.empty((len(scaled.xy), PATCH), np.float32)
        # A pixel of a scaled picture is a fraction of a pixel of the label; a patch's steps are the label's.
        over = np.float32(OVER)
        for_spans(read_patches, len(out), scaled.rgb, scaled.xy * over, scaled.ab * over, out)
        patches.append(out)
        column, row = (scaled.xy * OVER + 0.5).astype(int).T
        colours.append(scaled.rgb[row, column])
    joined = np.concatenate(patches)
    mean = joined.mean(0, dtype=np.float64).astype(np.float32)
    centred = joined - mean
    covariance = centred[:: max(1, len(centred) // 20_000)].astype(np.float64)
    axes = np.linalg.eigh(covariance.T @ covariance)[1][:, ::-1][:, :COEFFICIENTS].astype(np.float32)
    return Patches(
        kind,
        mean,
        np.ascontiguousarray(axes),
        np.ascontiguousarray(centred @ axes),
        np.concatenate(colours),
        np.concatenate([s.gate for s in scaled_pictures]),
    )


def denoised(noisy: NDArray[np.float32], sigma: float, condition: Condition, patches: Patches) -> NDArray[np.float32]:
    """(H, W, 3). The posterior mean of the picture under the noise; outside of the silhouette the render."""
    out = condition.render.astype(np.float32).copy()
    rows, columns = np.nonzero(condition.inside)
    if len(rows) == 0:
        return out
    gate = _gate(condition, patches.kind)[rows, columns]
    ab = _directions(condition, patches.kind)[rows, columns]
    queries = np.empty((len(rows), PATCH), np.float32)
    for_spans(read_patches, len(rows), noisy, np.stack([columns, rows], -1).astype(np.float32), ab, queries)
    cells, lists = np.unique(np.floor(gate).astype(np.int64), axis=0, return_inverse=True)
    near = [_candidates(patches.gate, cell + 0.5) for cell in cells]
    starts = np.cumsum([0, *[len(n) for n in near]]).astype(np.int64)
    means = np.empty((len(rows), 3), np.float32)
    for_spans(
        posterior,
        len(rows),
        np.ascontiguousarray((queries - patches.mean) @ patches.axes),
        lists.ravel().astype(np.int64),
        starts,
        np.concatenate(near).astype(np.int32),
        patches.features,
        patches.colours,
        max(sigma, MIN_SIGMA),
        means,
    )
    out[rows, columns] = means
    return out


def _candidates(gates: NDArray[np.float32], at: NDArray[np.floating]) -> NDArray[np.intp]:
    """Patches in a gate cell and its neighbours, thinned to MAX_CANDIDATES, or else the nearest MIN_CANDIDATES."""
    near = np.flatnonzero((np.abs(gates - at) <= 1.5).all(1))
    if len(near) < MIN_CANDIDATES:
        gaps = ((gates - at) ** 2).sum(1)
        count = min(MIN_CANDIDATES, len(gates))
        return np.sort(np.argpartition(gaps, count - 1)[:count])
    return near[np.linspace(0, len(near) - 1, min(MAX_CANDIDATES, len(near))).astype(int)]


def _gate(condition: Condition, kind: Frame) -> NDArray[np.float32]:
    """(H, W, 3). Gate coordinates of every pixel, in the units of `ScaledPicture.gate`."""
    depth = depth_gate(condition.under_skin)
    zero = np.zeros_like(depth)
    if kind == POLAR:
        widest = max(float(condition.radius[condition.inside].max()), 1e-6)
        return np.stack([depth, np.clip(condition.radius / widest, 0, 1) * np.float32(RADIUS_CELLS), zero], -1)
    if kind == RADIAL:
        across = np.clip(condition.radius, 0, 1) * np.float32(RADIUS_CELLS)
        up = (np.clip(condition.height, -1, 1) + 1) / 2 * np.float32(HEIGHT_CELLS)
        return np.stack([depth, across, up.astype(np.float32)], -1)
    return np.stack([depth, zero, zero], -1)


def _directions(condition: Condition, kind: Frame) -> NDArray[np.float32]:
    """(H, W, 4). Directions a and b in the picture, x to the right and y down."""
    out = np.zeros((*condition.radius.shape, 4), np.float32)
    out[..., 0], out[..., 3] = 1, -1
    if kind == FIXED:
        return out
    gy, gx = np.gradient(ndimage.gaussian_filter(condition.radius, 1.0))
    length = np.maximum(np.hypot(gx, gy), 1e-9)
    gx, gy = gx / length, gy / length
    if kind == RADIAL:
        out[..., 0] = np.where(gx < 0, -1, 1)
        return out
    # Around the axis: across the radius, towards growing angles.
    ty, tx = np.gradient(np.unwrap(condition.angle, axis=1))
    sign = np.sign(np.median((-gy * tx + gx * ty)[condition.inside])) or 1.0
    out[..., 0], out[..., 1], out[..., 2], out[..., 3] = gx, gy, -gy * sign, gx * sign
    return out


def _inradius(condition: Condition) -> float:
    """Inradius of the body in pixels of the condition's pictures, from how fast the depth grows away from the edge."""
    gy, gx = np.gradient(condition.under_skin)
    slope = np.hypot(gx, gy)[condition.inside]
    steepest = float(np.quantile(slope, 0.9)) if len(slope) else 0.0
    return 1 / max(steepest, 1e-3)
