"""The kernels of the exemplar prior: read a patch, find its nearest exemplar patch, gather the votes.

A patch is 7x7 samples along the two directions that a family gives a voxel; the same in an exemplar. Grid coordinates
are in cells with cell centres at whole numbers; picture coordinates are in cells too, with `OVER` pixels to a cell.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

__all__ = ["FIXED", "LANES", "OVER", "PATCH", "POLAR", "RADIAL", "SIDE", "gather_votes", "match", "project_pixels"]

SIDE = 7
PATCH = SIDE * SIDE * 3
LANES = 16
"""Exemplar patches compared at once: two AVX registers of float32."""
BOX = 6
"""Leading PCA coefficients in a block's bounding box; they hold most of the variance."""
OVER = 2
"""Pixels of an exemplar per voxel: votes land between exemplar pixels, and reading a finer picture keeps them sharp."""

POLAR, RADIAL, FIXED = 0, 1, 2
"""Kinds of frame: (e_r, e_theta), (e_r, up), two fixed axes."""

_HALF = SIDE // 2
_F0 = np.float32(0)
_F1 = np.float32(1)


@njit(cache=True, inline="always")
def _frame(kind, basis, centre, x, y, z):  # type: ignore[no-untyped-def]
    """The directions a and b at a grid point: six floats."""
    if kind == FIXED:
        return basis[0, 0], basis[0, 1], basis[0, 2], basis[1, 0], basis[1, 1], basis[1, 2]
    dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
    p = dx * basis[0, 0] + dy * basis[0, 1] + dz * basis[0, 2]
    q = dx * basis[1, 0] + dy * basis[1, 1] + dz * basis[1, 2]
    r = np.sqrt(p * p + q * q)
    if r > np.float32(1e-3):
        p, q = p / r, q / r
    else:
        p, q = _F1, _F0
    ax = p * basis[0, 0] + q * basis[1, 0]
    ay = p * basis[0, 1] + q * basis[1, 1]
    az = p * basis[0, 2] + q * basis[1, 2]
    if kind == RADIAL:
        return ax, ay, az, basis[2, 0], basis[2, 1], basis[2, 2]
    bx = p * basis[1, 0] - q * basis[0, 0]
    by = p * basis[1, 1] - q * basis[0, 1]
    bz = p * basis[1, 2] - q * basis[0, 2]
    return ax, ay, az, bx, by, bz


@njit(cache=True, inline="always")
def _read_grid(rgb, x, y, z):  # type: ignore[no-untyped-def]
    """Trilinear colour of a grid (X, Y, Z, 3) at a point, clamped to it."""
    nx, ny, nz = rgb.shape[0], rgb.shape[1], rgb.shape[2]
    x = min(max(x, _F0), np.float32(nx - 1.001))
    y = min(max(y, _F0), np.float32(ny - 1.001))
    z = min(max(z, _F0), np.float32(nz - 1.001))
    i, j, k = int(x), int(y), int(z)
    u, v, w = x - np.float32(i), y - np.float32(j), z - np.float32(k)
    w00, w01 = (_F1 - u) * (_F1 - v), (_F1 - u) * v
    w10, w11 = u * (_F1 - v), u * v
    c0 = _F0
    c1 = _F0
    c2 = _F0
    for d in range(2):
        h = w if d == 1 else _F1 - w
        a, b, c, e = w00 * h, w01 * h, w10 * h, w11 * h
        c0 += (a * rgb[i, j, k + d, 0] + b * rgb[i, j + 1, k + d, 0] + c * rgb[i + 1, j, k + d, 0]) + e * rgb[
            i + 1, j + 1, k + d, 0
        ]
        c1 += (a * rgb[i, j, k + d, 1] + b * rgb[i, j + 1, k + d, 1] + c * rgb[i + 1, j, k + d, 1]) + e * rgb[
            i + 1, j + 1, k + d, 1
        ]
        c2 += (a * rgb[i, j, k + d, 2] + b * rgb[i, j + 1, k + d, 2] + c * rgb[i + 1, j, k + d, 2]) + e * rgb[
            i + 1, j + 1, k + d, 2
        ]
    return c0, c1, c2


@njit(cache=True, inline="always")
def _read_picture(atlas, offset, height, width, x, y):  # type: ignore[no-untyped-def]
    """Bilinear colour of one picture of the atlas at (x, y) in cells, clamped to it."""
    x = min(max(x * np.float32(OVER), _F0), np.float32(width - 1.001))
    y = min(max(y * np.float32(OVER), _F0), np.float32(height - 1.001))
    i, j = int(x), int(y)
    u, v = x - np.float32(i), y - np.float32(j)
    at = offset + j * width + i
    a, b, c, d = (_F1 - u) * (_F1 - v), u * (_F1 - v), (_F1 - u) * v, u * v
    e = at + width
    return (
        a * atlas[at, 0] + b * atlas[at + 1, 0] + c * atlas[e, 0] + d * atlas[e + 1, 0],
        a * atlas[at, 1] + b * atlas[at + 1, 1] + c * atlas[e, 1] + d * atlas[e + 1, 1],
        a * atlas[at, 2] + b * atlas[at + 1, 2] + c * atlas[e, 2] + d * atlas[e + 1, 2],
    )


@njit(cache=True, parallel=True)
def project_pixels(
    atlas: NDArray[np.float32],  # [T, 3]
    images: NDArray[np.int64],  # [E, 3] offset, height, width
    image: NDArray[np.int32],  # [P]
    xy: NDArray[np.float32],  # [P, 2] cells
    ab: NDArray[np.float32],  # [P, 4] directions a and b in the picture
    out: NDArray[np.float32],  # [P, 147]
) -> None:
    """Reads the patches of exemplar pixels."""
    for p in prange(len(xy)):
        offset, height, width = images[image[p], 0], images[image[p], 1], images[image[p], 2]
        m = 0
        for i in range(-_HALF, _HALF + 1):
            for j in range(-_HALF, _HALF + 1):
                x = xy[p, 0] + np.float32(i) * ab[p, 0] + np.float32(j) * ab[p, 2]
                y = xy[p, 1] + np.float32(i) * ab[p, 1] + np.float32(j) * ab[p, 3]
                c0, c1, c2 = _read_picture(atlas, offset, height, width, x, y)
                out[p, m], out[p, m + 1], out[p, m + 2] = c0, c1, c2
                m += 3


@njit(cache=True, inline="always")
def _search(f, q, blocks, low, high, members, start, stop, coordinates, price, mu, best, best_cost):  # type: ignore[no-untyped-def]
    """The cheapest exemplar patch in the blocks start..stop: its number and cost. Exact."""
    dims = blocks.shape[1]
    total = np.empty(LANES, np.float32)
    for b in range(start, stop):
        bound = _F0
        for k in range(BOX):
            gap = max(low[b, k] - f[k], f[k] - high[b, k])
            if gap > _F0:
                bound += gap * gap
        if bound >= best_cost:
            continue
        for lane in range(LANES):
            total[lane] = _F0
        for k in range(dims):
            fk = f[k]
            for lane in range(LANES):
                gap = blocks[b, k, lane] - fk
                total[lane] += gap * gap
        for lane in range(LANES):
            if total[lane] < best_cost:
                p = members[b, lane]
                if p < 0:
                    continue
                cost = total[lane] + price[p]
                g0 = coordinates[p, 0] - q[0]
                g1 = coordinates[p, 1] - q[1]
                g2 = coordinates[p, 2] - q[2]
                cost += mu * (g0 * g0 + g1 * g1 + g2 * g2)
                if cost < best_cost:
                    best_cost = cost
                    best = p
    return best, best_cost


@njit(cache=True, parallel=True)
def match(
    rgb: NDArray[np.float32],  # [X, Y, Z, 3]
    cells: NDArray[np.int16],  # [M, 3]
    lists: NDArray[np.int32],  # [M] candidate list of each
    wanted: NDArray[np.float32],  # [M, 3] gate coordinates
    kind: int,
    basis: NDArray[np.float32],  # [3, 3]
    centre: NDArray[np.float32],  # [3]
    mean: NDArray[np.float32],  # [147]
    axes: NDArray[np.float32],  # [147, D]
    starts: NDArray[np.int64],  # [L + 1] first block of each list
    blocks: NDArray[np.float32],  # [B, D, 16]
    low: NDArray[np.float32],  # [B, BOX]
    high: NDArray[np.float32],  # [B, BOX]
    members: NDArray[np.int32],  # [B, 16]
    coordinates: NDArray[np.float32],  # [P, 3]
    price: NDArray[np.float32],  # [P]
    mu: float,
    best: NDArray[np.int32],  # [M] out
    distance: NDArray[np.float32],  # [M] out: squared patch distance alone
    features: NDArray[np.float32],  # [P, D]
) -> None:
    """Finds for each cell the exemplar patch of least |patch|^2 + mu |coordinates|^2 + price in its list."""
    dims = axes.shape[1]
    mu32 = np.float32(mu)
    for m in prange(len(cells)):
        x, y, z = np.float32(cells[m, 0]), np.float32(cells[m, 1]), np.float32(cells[m, 2])
        ax, ay, az, bx, by, bz = _frame(kind, basis, centre, x, y, z)
        f = np.zeros(dims, np.float32)
        n = 0
        for i in range(-_HALF, _HALF + 1):
            for j in range(-_HALF, _HALF + 1):
                s, t = np.float32(i), np.float32(j)
                c0, c1, c2 = _read_grid(rgb, x + s * ax + t * bx, y + s * ay + t * by, z + s * az + t * bz)
                c0 -= mean[n]
                c1 -= mean[n + 1]
                c2 -= mean[n + 2]
                for k in range(dims):
                    f[k] += c0 * axes[n, k] + c1 * axes[n + 1, k] + c2 * axes[n + 2, k]
                n += 3
        found, cost = _search(
            f,
            wanted[m],
            blocks,
            low,
            high,
            members,
            starts[lists[m]],
            starts[lists[m] + 1],
            coordinates,
            price,
            mu32,
            -1,
            np.float32(3e38),
        )
        best[m] = found
        gap = _F0
        if found >= 0:
            for k in range(dims):
                gap += (features[found, k] - f[k]) ** 2
        distance[m] = gap


@njit(cache=True, parallel=True)
def gather_votes(
    rgb: NDArray[np.float32],  # [X, Y, Z, 3] in and out
    cells: NDArray[np.int16],  # [N, 3]
    number: NDArray[np.int32],  # [X, Y, Z] row of each cell in `cells`, -1 outside
    offsets: NDArray[np.int16],  # [K, 3]
    falloff: NDArray[np.float32],  # [K]
    matches: NDArray[np.int32],  # [F, N] exemplar pixel, -1: no match here
    weights: NDArray[np.float32],  # [F, N]
    kinds: NDArray[np.int64],  # [F]
    bases: NDArray[np.float32],  # [F, 3, 3]
    centre: NDArray[np.float32],  # [3]
    atlas: NDArray[np.float32],
    images: NDArray[np.int64],
    image: NDArray[np.int32],
    xy: NDArray[np.float32],
    ab: NDArray[np.float32],
    widths: NDArray[np.float32],  # [S] widths of the mean shift's passes
    first: int,
    last: int,
) -> None:
    """The cells first..last take the mode of what the matched patches around them say.

    Each cell gathers its own votes, so nothing depends on the order of threads (DESIGN 5.1, step 5).
    """
    families = len(matches)
    room = families * len(offsets)
    for n in prange(first, last):
        votes = np.empty((room, 4), np.float32)
        count = 0
        i, j, k = cells[n, 0], cells[n, 1], cells[n, 2]
        m0 = _F0
        m1 = _F0
        m2 = _F0
        total = _F0
        for o in range(len(offsets)):
            u, v, w = i - offsets[o, 0], j - offsets[o, 1], k - offsets[o, 2]
            at = number[u, v, w]
            if at < 0:
                continue
            dx, dy, dz = np.float32(offsets[o, 0]), np.float32(offsets[o, 1]), np.float32(offsets[o, 2])
            for family in range(families):
                p = matches[family, at]
                if p < 0:
                    continue
                weight = falloff[o] * weights[family, at]
                if weight <= _F0:
                    continue
                ax, ay, az, bx, by, bz = _frame(
                    kinds[family], bases[family], centre, np.float32(u), np.float32(v), np.float32(w)
                )
                s = dx * ax + dy * ay + dz * az
                t = dx * bx + dy * by + dz * bz
                e = image[p]
                c0, c1, c2 = _read_picture(
                    atlas,
                    images[e, 0],
                    images[e, 1],
                    images[e, 2],
                    xy[p, 0] + s * ab[p, 0] + t * ab[p, 2],
                    xy[p, 1] + s * ab[p, 1] + t * ab[p, 3],
                )
                votes[count, 0], votes[count, 1], votes[count, 2], votes[count, 3] = c0, c1, c2, weight
                count += 1
                m0 += weight * c0
                m1 += weight * c1
                m2 += weight * c2
                total += weight
        if total <= _F0:
            continue
        m0, m1, m2 = m0 / total, m1 / total, m2 / total
        for step in range(len(widths)):
            scale = np.float32(-0.5) / (widths[step] * widths[step])
            s0 = _F0
            s1 = _F0
            s2 = _F0
            sw = _F0
            for c in range(count):
                g0, g1, g2 = votes[c, 0] - m0, votes[c, 1] - m1, votes[c, 2] - m2
                weight = votes[c, 3] * np.exp(scale * (g0 * g0 + g1 * g1 + g2 * g2))
                s0 += weight * votes[c, 0]
                s1 += weight * votes[c, 1]
                s2 += weight * votes[c, 2]
                sw += weight
            if sw <= np.float32(1e-20):
                break
            m0, m1, m2 = s0 / sw, s1 / sw, s2 / sw
        rgb[i, j, k, 0] = m0
        rgb[i, j, k, 1] = m1
        rgb[i, j, k, 2] = m2
