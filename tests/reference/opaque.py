"""The opaque image in plain float64 numpy: every atom at every pixel it reaches. Renderers are tested against it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from engine.scene import sh
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.constants import (
    CORE_Q,
    CUTOFF_Q,
    EDGE_SLOPE,
    EPSILON_PITCHES,
    FADE_LAYERS,
    FILLED_DENSITY,
    LOW_PASS,
    MIN_WEIGHT,
    SOLID_DENSITY,
)
from engine.scene.plane import Plane

Double = NDArray[np.float64]


def rotations(quats: NDArray[np.floating]) -> Double:
    """(N, 3, 3). Columns are the principal axes; a quaternion of length zero gives the identity."""
    q = np.asarray(quats, np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(length > 1e-12, q / np.maximum(length, 1e-12), [1.0, 0.0, 0.0, 0.0])
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array([[np.asarray(e) for e in row] for row in rows]).transpose(2, 0, 1)


def ellipsoids(atoms: Atoms) -> tuple[Double, Double, Double, Double]:
    """Means (M, 3), scales (M, 3), axes (M, 3, 3) and view-independent RGB (M, 3); surface atoms first."""
    surface, interior = atoms.surface, atoms.interior
    means = np.concatenate([surface.means, interior.means]).astype(np.float64)
    scales = np.concatenate([surface.scales, np.repeat(interior.sigmas[:, None], 3, 1)]).astype(np.float64)
    axes = np.concatenate([rotations(surface.quats), np.tile(np.eye(3), (len(interior), 1, 1))])
    rgb = np.concatenate([sh.sh_to_rgb(surface.sh[:, 0].astype(np.float64)), interior.rgb.astype(np.float64)])
    return means, scales, axes, rgb


def kernel_field(
    atoms: Atoms,
    points: NDArray[np.floating],  # [P, 3]
    footprint: float | NDArray[np.floating] = 0.0,  # [] or [P], world units per pixel
) -> tuple[Double, Double]:
    """Colour (P, 3) and density (P,): sums over all atoms. In the colour, skin counts only as far as the interior falls
    short of FILLED_DENSITY; the colour is zero where the density is."""
    means, scales, axes, rgb = ellipsoids(atoms)
    points = np.asarray(points, np.float64)
    least = 0.5 * np.broadcast_to(np.asarray(footprint, np.float64), len(points))[:, None]
    colour, density = np.zeros((2, len(points), 3)), np.zeros((2, len(points)))
    tree = KDTree(points)
    for i in range(len(means)):
        kind = int(i < len(atoms.surface))
        # At points farther away than this, q is over its limit, whatever the atom's axes.
        reach = 1.001 * np.sqrt(CUTOFF_Q) * max(scales[i].max(), least.max(initial=0))
        at = np.array(tree.query_ball_point(means[i], reach), int)
        used = np.maximum(scales[i], least[at])
        q = (((points[at] - means[i]) @ axes[i] / used) ** 2).sum(1)
        w = np.where(q <= CUTOFF_Q, np.exp(-q / 2) * (scales[i] / used).prod(1), 0)
        density[kind, at] += w
        colour[kind, at] += w[:, None] * rgb[i]
    interior, skin = density
    part = np.maximum(1 - interior / FILLED_DENSITY, 0)
    mass = interior + part * skin
    return (colour[0] + part[:, None] * colour[1]) / np.where(mass > 0, mass, 1)[:, None], density.sum(0)


def rays(camera: Camera) -> tuple[Double, Double]:
    """World origin and direction (H, W, 3) of every pixel's ray; one unit along it is one unit of depth."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    x, y = np.meshgrid(u, v)
    rotation, translation = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    if camera.orthographic:
        origin = (np.stack([x, y, np.zeros_like(x)], -1) - translation) @ rotation
        return origin, np.broadcast_to(rotation[2], origin.shape)
    direction = np.stack([x, y, np.ones_like(x)], -1) @ rotation
    return np.broadcast_to(camera.position, direction.shape), direction


def nearest(camera: Camera) -> float:
    """Depth at which the view begins."""
    return -np.inf if camera.orthographic else camera.near


def splats(atoms: Atoms, camera: Camera, planes: Sequence[Plane]) -> tuple[Double, Double, Double]:
    """The outside: colour (H, W, 3), alpha (H, W) and front depth (H, W), inf where nothing covers the pixel."""
    count = len(atoms.surface)
    means, scales, axes = (a[:count] for a in ellipsoids(atoms)[:3])
    way = means - camera.position
    way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    if camera.orthographic:
        way = np.broadcast_to(camera.forward, way.shape)
    rgb = sh.colours(atoms.surface.sh.astype(np.float64), way)

    origin, direction = rays(camera)
    size = (camera.height, camera.width)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    fragments = []
    rotation = camera.viewmat[:3, :3]
    for i in range(count):
        c = rotation @ means[i] + camera.viewmat[:3, 3]
        sigma = rotation @ axes[i] @ np.diag(scales[i] ** 2) @ axes[i].T @ rotation.T
        if c[2] <= nearest(camera):
            continue
        if camera.orthographic:
            jacobian = np.array([[camera.fx, 0, 0], [0, camera.fy, 0]])
            centre = np.array([camera.fx * c[0] + camera.cx, camera.fy * c[1] + camera.cy])
        else:
            # The local affine map of a Gaussian far outside the picture is clamped at 1.3 times the field of view.
            side_x, side_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
            left, right = -camera.cx / camera.fx - side_x, (camera.width - camera.cx) / camera.fx + side_x
            top, bottom = -camera.cy / camera.fy - side_y, (camera.height - camera.cy) / camera.fy + side_y
            tx, ty = np.clip(c[0] / c[2], left, right), np.clip(c[1] / c[2], top, bottom)
            jacobian = np.array([[camera.fx, 0, -camera.fx * tx], [0, camera.fy, -camera.fy * ty]]) / c[2]
            centre = np.array([camera.fx * c[0], camera.fy * c[1]]) / c[2] + [camera.cx, camera.cy]
        c0 = jacobian @ sigma @ jacobian.T
        blurred = c0 + LOW_PASS * np.eye(2)
        rho = np.sqrt(max(np.linalg.det(c0), 0.0) / np.linalg.det(blurred))
        sharp = max(1.0, np.sqrt(np.linalg.eigvalsh(blurred)[0]) / EDGE_SLOPE)
        # No pixel outside the ellipse's bounding box has a q within its limit.
        wide, high = 1.001 * np.sqrt(CUTOFF_Q * np.diag(blurred))
        rows, columns = np.nonzero((np.abs(x - centre[0]) <= wide) & (np.abs(y - centre[1]) <= high))
        u = np.stack([x[rows, columns], y[rows, columns]], -1) - centre
        q = (u @ np.linalg.inv(blurred) * u).sum(-1)
        reach = 3 * np.sqrt(sigma[2, 2])
        slope = np.linalg.solve(blurred, jacobian @ sigma[:, 2])
        z = c[2] + np.clip(u @ slope, -reach, reach)
        point = origin[rows, columns] + z[:, None] * direction[rows, columns]
        kept = (q <= CUTOFF_Q) & (z > nearest(camera))
        for plane in planes:
            kept &= plane.distance(point) <= 0
        fragments.append(((rows[kept], columns[kept]), q[kept], z[kept], rho, sharp, rgb[i]))

    front = np.full(size, np.inf)
    for at, q, z, _, _, _ in fragments:
        front[at] = np.where(q <= CORE_Q, np.minimum(front[at], z), front[at])
    layer = EPSILON_PITCHES * atoms.pitch
    covered, shown = [], []  # (H, W) and (H, W, 3): in the layer, before it and behind it
    for place in range(3):
        weight, edge, colour, by_depth = np.zeros(size), np.zeros(size), np.zeros((*size, 3)), np.zeros(size)
        for at, q, z, rho, sharp, c in fragments:
            first, cored = front[at], np.isfinite(front[at])
            before, behind = z < np.where(cored, first, -np.inf) - layer, z > first + layer
            w = np.where((~before & ~behind, before, behind)[place], rho * np.exp(-q / 2), 0)
            weight[at] += w
            edge[at] += w * sharp
            if place == 2:
                deeper = np.floor(z / layer) - np.floor(np.where(cored, first, z) / layer)
                w = w * 0.25 ** np.minimum(deeper, FADE_LAYERS)
            by_depth[at] += w
            colour[at] += w[:, None] * c
        covered.append(coverage(weight, edge))
        shown.append(colour / np.where(by_depth > 0, by_depth, 1)[..., None])
        if place == 0:
            some = weight > MIN_WEIGHT  # without a layer the pixel is empty, whatever lies behind
    here, before, behind = covered
    shares = np.stack([(1 - before) * here, before, (1 - before) * (1 - here) * behind])
    alpha = np.where(some, shares.sum(0), 0)
    colour = (shares[..., None] * np.stack(shown)).sum(0)
    return colour / np.where(alpha > 0, alpha, 1)[..., None], alpha, front


def coverage(weight: NDArray[np.floating], edge: NDArray[np.floating]) -> Double:
    """(H, W). Covered fraction of a pixel, range [0, 1], from sums of weights and of weights times sharpness (H, W)."""
    some = weight > MIN_WEIGHT
    return np.where(some, np.clip(0.5 + (weight - 0.5) * edge / np.where(some, weight, 1), 0, 1), 0)


def faces(atoms: Atoms, camera: Camera, planes: Sequence[Plane], light: bool) -> tuple[Double, Double, Double]:
    """The cut faces: colour (H, W, 3), alpha (H, W) and depth (H, W), inf where no ray enters through one."""
    origin, direction = rays(camera)
    size = (camera.height, camera.width)
    entry, through = np.full(size, -np.inf), np.full(size, -1)
    for j, plane in enumerate(planes):
        along = direction @ np.array(plane.normal)
        s = -plane.distance(origin) / np.where(along < 0, along, -1)
        first = (along < 0) & (s > entry)
        entry, through = np.where(first, s, entry), np.where(first, j, through)
    met = (through >= 0) & (entry > nearest(camera))
    point = origin + np.where(met, entry, 0)[..., None] * direction
    for plane in planes:
        # The other planes through which the ray enters lie before the last one: they need no test.
        met &= (direction @ np.array(plane.normal) < 0) | (plane.distance(point) <= 0)
    scale = np.sqrt(camera.fx * camera.fy)
    footprint = (np.where(met, entry, 1) if not camera.orthographic else np.ones(size)) / scale
    colour, density = np.zeros((*size, 3)), np.zeros(size)
    colour[met], density[met] = kernel_field(atoms, point[met], footprint[met])
    slope = np.maximum(1, atoms.pitch / 2 / (EDGE_SLOPE * footprint)) / (2 * SOLID_DENSITY)
    alpha = np.where(met, np.clip(0.5 + (density - SOLID_DENSITY) * slope, 0, 1), 0)
    if light:
        normals = np.array([p.normal for p in planes] or [(0.0, 0.0, 0.0)])[through]
        towards = -direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        colour = colour * (0.85 + 0.15 * np.maximum((normals * towards).sum(-1), 0))[..., None]
    return colour, alpha, np.where(met, entry, np.inf)


def reference(
    atoms: Atoms,
    camera: Camera,
    planes: Sequence[Plane] = (),
    background: Sequence[float] = (1.0, 1.0, 1.0),
    light: bool = False,
) -> tuple[Double, Double, Double]:
    """The opaque image of one piece: rgb (H, W, 3), alpha (H, W), depth (H, W), inf where there is nothing."""
    colour, alpha_s, front = splats(atoms, camera, planes)
    face, alpha_f, entry = faces(atoms, camera, planes, light)
    a, b = alpha_f[..., None], alpha_s[..., None]
    rgb = a * face + (1 - a) * (b * colour + (1 - b) * np.asarray(background, np.float64))
    return rgb, 1 - (1 - alpha_f) * (1 - alpha_s), np.where(alpha_f >= 0.5, entry, front)
