"""Projection of Gaussians to the records that the pixel loops read, and the gradients back from them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.render.classic.blend import ROW
from engine.render.classic.records import (
    BLUE,
    CHORD_SLOPE,
    DEPTH,
    GREEN,
    HALF_CHORD,
    HALF_HEIGHT,
    HALF_WIDTH,
    LOG_OPACITY,
    RECORD,
    RED,
    U_FRACTION,
    V_FRACTION,
    WHITEN_XX,
    WHITEN_YX,
    WHITEN_YY,
    U,
    V,
)
from engine.render.classic.tiles import BLOCKS, SIDE, TAIL_BITS, box_size
from engine.render.lanes import absolute, floor, load8, load16, maximum, minimum, root, store, widen
from engine.render.projection import (
    camera_point,
    camera_point_backward,
    half_axes,
    half_axes_backward,
    jacobian,
    jacobian_backward,
    project_point,
    project_point_backward,
    screen_axes,
    screen_axes_backward,
    screen_covariance,
    screen_covariance_backward,
    view_direction,
)
from engine.scene.constants import ALPHA_STEPS, LOW_PASS
from engine.scene.sh import direction_gradient, fill_basis

__all__ = ["project", "project_backward"]

GRADIENT = 10
"""Numbers of a row (`engine.render.classic.blend.ROW`) that are used."""

GROUP = 8
"""Gaussians that are computed side by side: as many float64 as the widest vector registers hold."""

GIVEN = 11
"""Numbers of a Gaussian apart from its colours."""

LOG2_E = 1.0 / math.log(2.0)
ROOT_HALF_LOG2_E = math.sqrt(0.5 * LOG2_E)
TWO_LN2 = 2.0 * math.log(2.0)


@njit(cache=True, error_model="numpy")
def _box_group(cam, near, tiles_y, tiles_x, box):
    """Fills box (4, GROUP), tiles x0, x1, y0, y1: a box that holds the Gaussian, taken as a ball of its largest scale.

    near (4, GROUP) is mean and largest scale.
    """
    x, y, z = camera_point(cam, load8(near, 0), load8(near, GROUP), load8(near, 2 * GROUP))
    scale = load8(near, 3 * GROUP)
    u, v = project_point(cam, x, y, z)
    j00, j02, j11, j12 = jacobian(cam, x, y, z)
    reach_x = REACH * (scale * (absolute(j00) + absolute(j02))) + FRINGE
    reach_y = REACH * (scale * (absolute(j11) + absolute(j12))) + FRINGE
    per_side = 1.0 / SIDE
    store(box, 0, minimum(maximum((u - reach_x) * per_side, 0.0), tiles_x))
    store(box, GROUP, minimum(maximum((u + reach_x) * per_side + 1.0, 0.0), tiles_x))
    store(box, 2 * GROUP, minimum(maximum((v - reach_y) * per_side, 0.0), tiles_y))
    store(box, 3 * GROUP, minimum(maximum((v + reach_y) * per_side + 1.0, 0.0), tiles_y))


REACH = math.sqrt(2.0 * math.log(ALPHA_STEPS)) * 1.001
"""Standard deviations beyond which an opaque Gaussian is below 1/255, with a margin for rounding."""

FRINGE = REACH * math.sqrt(LOW_PASS) + 1.0
"""Pixels that the low-pass adds to that, with a margin."""


@njit(cache=True, error_model="numpy")
def _gather(rows, scene):
    """(groups, GIVEN, GROUP) float64: mean, scales, quaternion, opacity of these Gaussians, group after group.

    They are scattered in memory: a loop that only loads keeps many loads in flight, one that also computes, only a few.
    """
    means, scales, quats = scene.means, scene.scales, scene.quats
    out = np.zeros((-(-len(rows) // GROUP), GIVEN, GROUP), np.float64)
    for k in range(len(rows)):
        i, lane = rows[k], k % GROUP
        g = out[k // GROUP]
        g[0, lane], g[1, lane], g[2, lane] = means[i, 0], means[i, 1], means[i, 2]
        g[3, lane], g[4, lane], g[5, lane] = scales[i, 0], scales[i, 1], scales[i, 2]
        g[6, lane], g[7, lane], g[8, lane], g[9, lane] = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        g[10, lane] = scene.opacities[i]
    return out


@njit(cache=True, error_model="numpy")
def _project_group(cam, given, log_opacity, out):
    """Fills out (RECORD + 3, GROUP): the records of one group without colours, then det, u and v."""
    px, py, pz = load8(given, 0), load8(given, GROUP), load8(given, 2 * GROUP)
    sx, sy, sz = load8(given, 3 * GROUP), load8(given, 4 * GROUP), load8(given, 5 * GROUP)
    qw, qx = load8(given, 6 * GROUP), load8(given, 7 * GROUP)
    qy, qz = load8(given, 8 * GROUP), load8(given, 9 * GROUP)
    x, y, z = camera_point(cam, px, py, pz)
    u, v = project_point(cam, x, y, z)
    axes = half_axes(cam, qw, qx, qy, qz, sx, sy, sz)
    xx, xy, yy, det, _ = screen_covariance(screen_axes(jacobian(cam, x, y, z), axes), LOW_PASS)
    power = load8(log_opacity, 0)
    reach = (power + TAIL_BITS) * (2.0 / LOG2_E)  # squared, in standard deviations
    floor_u, floor_v = floor(u), floor(v)
    store(out, U * GROUP, floor_u)
    store(out, U_FRACTION * GROUP, u - floor_u)
    store(out, V * GROUP, floor_v)
    store(out, V_FRACTION * GROUP, v - floor_v)
    store(out, WHITEN_XX * GROUP, ROOT_HALF_LOG2_E / root(xx))
    store(out, WHITEN_YX * GROUP, -ROOT_HALF_LOG2_E * xy / root(xx * det))
    store(out, WHITEN_YY * GROUP, ROOT_HALF_LOG2_E * root(xx / det))
    store(out, LOG_OPACITY * GROUP, power)
    store(out, DEPTH * GROUP, z)
    store(out, HALF_WIDTH * GROUP, root(reach * xx))
    store(out, HALF_HEIGHT * GROUP, root(reach * yy))
    store(out, CHORD_SLOPE * GROUP, xy / yy)
    store(out, HALF_CHORD * GROUP, root(reach * det / yy))
    store(out, RECORD * GROUP, det)
    store(out, (RECORD + 1) * GROUP, u)
    store(out, (RECORD + 2) * GROUP, v)


@njit(cache=True, error_model="numpy", nogil=True)
def project(
    chunk,
    chunk_size,
    order,  # [V] the Gaussians, nearest first
    first,  # first of this slice of the order
    last,  # and one past its last
    scene,  # Scene
    frame,  # out Frame: records and owners
    open_sums,  # [tiles_y + 1, tiles_x + 1] summed-area table of the open tiles
    record_counts,  # out [chunks of this slice]
    pair_bounds,  # out [chunks of this slice] upper bound of the tiles touched
):
    """Writes the records of one chunk of a slice, packed from the chunk's first place on.

    A record's place grows with depth: comparing places compares depths.
    """
    cam, colours, records = frame.cam, scene.colours, frame.records
    means, scales = scene.means, scene.scales
    start = first + chunk * chunk_size
    stop = min(start + chunk_size, last)
    tiles_y, tiles_x = open_sums.shape[0] - 1, open_sums.shape[1] - 1
    bands = colours.shape[1]
    basis = np.empty(16, np.float64)
    near, box = np.zeros((-(-(stop - start) // GROUP), 4, GROUP), np.float64), np.empty((4, GROUP), np.float64)
    for k in range(stop - start):
        i = order[start + k]
        group, lane = near[k // GROUP], k % GROUP
        group[0, lane], group[1, lane], group[2, lane] = means[i, 0], means[i, 1], means[i, 2]
        group[3, lane] = max(scales[i, 0], scales[i, 1], scales[i, 2])
    rows = np.empty(stop - start, np.int64)
    count = 0
    for k in range(stop - start):
        lane = k % GROUP
        if lane == 0:
            _box_group(cam, near[k // GROUP], tiles_y, tiles_x, box)
        x0, x1, y0, y1 = int(box[0, lane]), int(box[1, lane]), int(box[2, lane]), int(box[3, lane])
        rows[count] = order[start + k]
        count += open_sums[y1, x1] - open_sums[y0, x1] - open_sums[y1, x0] + open_sums[y0, x0] > 0
    gathered = _gather(rows[:count], scene)

    most_pairs = 0
    slot = start
    log_opacity, out = np.zeros(GROUP, np.float64), np.empty((RECORD + 3, GROUP), np.float64)
    for k in range(count):
        i, lane = rows[k], k % GROUP
        g = gathered[k // GROUP]
        if lane == 0:
            for other in range(GROUP):
                log_opacity[other] = math.log2(g[10, other])
            _project_group(cam, g, log_opacity, out)
        if not g[10, lane] * ALPHA_STEPS >= 1.0:
            continue
        det = out[RECORD, lane]
        if not (det > 0.0 and det < 1e60 and abs(out[RECORD + 1, lane]) + abs(out[RECORD + 2, lane]) < 1e15):
            continue  # NaN, or beyond any picture
        record = records[slot]
        for n in range(RECORD):
            record[n] = out[n, lane]
        size = box_size(record, tiles_y, tiles_x)
        if size == 0:
            continue
        most_pairs += size
        if scene.plain:
            record[RED], record[GREEN], record[BLUE] = colours[i, 0, 0], colours[i, 0, 1], colours[i, 0, 2]
        else:
            dx, dy, dz, _ = view_direction(cam, frame.eye, g[0, lane], g[1, lane], g[2, lane])
            fill_basis(dx, dy, dz, bands, basis)
            for channel in range(3):
                value = 0.5
                for band in range(bands):
                    value += basis[band] * colours[i, band, channel]
                record[RED + channel] = max(value, 0.0)
        frame.owners[slot] = i
        slot += 1
    record_counts[chunk] = slot - start
    pair_bounds[chunk] = most_pairs


@njit(cache=True, error_model="numpy")
def _project_group_backward(cam, given, sums, out):
    """Fills out (GIVEN, GROUP): dL/d(given), from the Gaussians of one group (GIVEN, GROUP) and sums (GRADIENT + 3,
    GROUP) of their rows, followed by the whitening of their records. The viewing direction counts as constant."""
    px, py, pz = load8(given, 0), load8(given, GROUP), load8(given, 2 * GROUP)
    sx, sy, sz = load8(given, 3 * GROUP), load8(given, 4 * GROUP), load8(given, 5 * GROUP)
    qw, qx = load8(given, 6 * GROUP), load8(given, 7 * GROUP)
    qy, qz = load8(given, 8 * GROUP), load8(given, 9 * GROUP)
    sm, smm, sn = load8(sums, GROUP), load8(sums, 2 * GROUP), load8(sums, 3 * GROUP)
    smn, snn = load8(sums, 4 * GROUP), load8(sums, 5 * GROUP)
    a, b, c = load8(sums, 10 * GROUP), load8(sums, 11 * GROUP), load8(sums, 12 * GROUP)
    x, y, z = camera_point(cam, px, py, pz)
    affine = jacobian(cam, x, y, z)
    axes = half_axes(cam, qw, qx, qy, qz, sx, sy, sz)
    screen = screen_axes(affine, axes)
    # With W = [[a, 0], [b, c]] the inverse covariance is 2 ln2 W^T W: so dL/d(mean) = 2 ln2 W^T (p m, p n)
    # and dL/dC = 2 ln2^2 W^T [[p m^2, p m n], [p m n, p n^2]] W.
    gu = TWO_LN2 * (a * sm + b * sn)
    gv = TWO_LN2 * c * sn
    h0, h1 = smm * a + smn * b, smn * a + snn * b
    gxx = 0.5 * TWO_LN2 * TWO_LN2 * (a * h0 + b * h1)
    gxy = TWO_LN2 * TWO_LN2 * c * h1
    gyy = 0.5 * TWO_LN2 * TWO_LN2 * c * c * snn
    g_affine, g_axes = screen_axes_backward(affine, axes, screen_covariance_backward(screen, gxx, gxy, gyy))
    g_quat, g_scale = half_axes_backward(cam, qw, qx, qy, qz, sx, sy, sz, g_axes)
    g1 = jacobian_backward(cam, x, y, z, g_affine[0], g_affine[1], g_affine[2], g_affine[3])
    g2 = project_point_backward(cam, x, y, z, gu, gv)
    depth = load8(sums, 9 * GROUP)
    gx, gy, gz = camera_point_backward(cam, g1[0] + g2[0], g1[1] + g2[1], g1[2] + g2[2] + depth)
    store(out, 0, gx)
    store(out, GROUP, gy)
    store(out, 2 * GROUP, gz)
    store(out, 3 * GROUP, g_scale[0])
    store(out, 4 * GROUP, g_scale[1])
    store(out, 5 * GROUP, g_scale[2])
    store(out, 6 * GROUP, g_quat[0])
    store(out, 7 * GROUP, g_quat[1])
    store(out, 8 * GROUP, g_quat[2])
    store(out, 9 * GROUP, g_quat[3])
    store(out, 10 * GROUP, load8(sums, 0) / load8(given, 10 * GROUP))


@njit(cache=True, error_model="numpy", nogil=True)
def project_backward(
    chunk,
    scene,  # Scene
    frame,  # Frame
    part,  # Slice
    rows,  # [most pairs, ROW] record by record
    gradients,  # out Scene
):
    """Sums the rows of each record of a chunk, in tile order, and takes the sums back to the parameters."""
    cam, owners, colours = frame.cam, frame.owners, scene.colours
    record_counts, pair_tiles, tile_lasts = part.record_counts, part.pair_tiles, frame.tile_lasts
    g_means, g_scales, g_quats = gradients.means, gradients.scales, gradients.quats
    g_colours = gradients.colours
    start = part.first + chunk * part.chunk_size
    bands = colours.shape[1]
    basis = np.empty(16, np.float64)
    g_basis = np.empty(16, np.float64)
    slots = np.empty(record_counts[chunk], np.int64)
    sums = np.zeros((-(-record_counts[chunk] // GROUP), GRADIENT + 3, GROUP), np.float64)
    total = np.zeros(2 * ROW, np.float64)
    nothing = load16(total, ROW)
    count = 0
    pair = part.first_places[chunk]
    for slot in range(start, start + record_counts[chunk]):
        lanes = nothing
        drawn = False
        for _ in range(frame.pair_counts[slot]):
            if slot <= tile_lasts[pair_tiles[pair] >> BLOCKS]:
                drawn = True
                lanes = lanes + widen(load16(rows[pair], 0))
            pair += 1
        if drawn:
            slots[count] = slot
            store(total, 0, lanes)
            group, lane = sums[count // GROUP], count % GROUP
            for n in range(GRADIENT):
                group[n, lane] = total[n]
            for n in range(3):
                group[GRADIENT + n, lane] = frame.records[slot, WHITEN_XX + n]
            count += 1
    gathered = _gather(owners[slots[:count]], scene)

    out = np.empty((GIVEN, GROUP), np.float64)
    for k in range(count):
        i, lane = owners[slots[k]], k % GROUP
        given, group = gathered[k // GROUP], sums[k // GROUP]
        if lane == 0:
            _project_group_backward(cam, given, group, out)
        gx, gy, gz = out[0, lane], out[1, lane], out[2, lane]
        red, green, blue = group[6, lane], group[7, lane], group[8, lane]
        if scene.plain:
            g_colours[i, 0, 0], g_colours[i, 0, 1], g_colours[i, 0, 2] = red, green, blue
        else:
            dx, dy, dz, length = view_direction(cam, frame.eye, given[0, lane], given[1, lane], given[2, lane])
            fill_basis(dx, dy, dz, bands, basis)
            g_basis[:] = 0.0
            for channel in range(3):
                value = 0.5
                for band in range(bands):
                    value += basis[band] * colours[i, band, channel]
                if value > 0.0:  # a colour clamped to 0 passes no gradient on
                    outer = red if channel == 0 else green if channel == 1 else blue
                    for band in range(bands):
                        g_colours[i, band, channel] = basis[band] * outer
                        g_basis[band] += colours[i, band, channel] * outer
            if bands > 1 and length > 0.0:
                hx, hy, hz = direction_gradient(dx, dy, dz, bands, g_basis)
                along = hx * dx + hy * dy + hz * dz
                gx += (hx - along * dx) / length
                gy += (hy - along * dy) / length
                gz += (hz - along * dz) / length
        g_means[i, 0], g_means[i, 1], g_means[i, 2] = gx, gy, gz
        g_scales[i, 0], g_scales[i, 1], g_scales[i, 2] = out[3, lane], out[4, lane], out[5, lane]
        for n in range(4):
            g_quats[i, n] = out[6 + n, lane]
        gradients.opacities[i] = out[10, lane]
