"""Classic 3DGS in plain torch, every pixel against every Gaussian: the formula and nothing else.

Written for float64; autograd gives the derivatives. `engine.render.classic` is tested against it.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from engine.scene.camera import Camera

__all__ = ["harmonics", "picture"]

MAX_ALPHA = 0.9900000095367432  # the float32 number nearest to 0.99, see `engine.render.classic.blend`


def picture(
    means: Tensor,  # [N, 3]
    scales: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    opacities: Tensor,  # [N]
    colours: Tensor,  # [N, 3] RGB or [N, (d+1)^2, 3] SH
    camera: Camera,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Tensor, Tensor, Tensor]:
    """rgb (H, W, 3), alpha (H, W), depth times alpha (H, W)."""
    kind = means.dtype
    view = torch.as_tensor(camera.viewmat, dtype=kind)
    points = means @ view[:3, :3].T + view[:3, 3]
    x, y, z = points.unbind(1)
    order = torch.argsort(z.detach(), stable=True)
    if not camera.orthographic:
        order = order[z[order] > camera.near]

    axes = view[:3, :3] @ rotations(quats) * scales[:, None, :]
    one, none = torch.ones_like(z), torch.zeros_like(z)
    if camera.orthographic:
        u, v = camera.fx * x + camera.cx, camera.fy * y + camera.cy
        rows = [[camera.fx * one, none, none], [none, camera.fy * one, none]]
        toward = view[2, :3].expand(len(means), 3)
    else:
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        air_x, air_y = 0.3 * 0.5 * camera.width / camera.fx, 0.3 * 0.5 * camera.height / camera.fy
        slope_x = (x / z).clamp(-camera.cx / camera.fx - air_x, (camera.width - camera.cx) / camera.fx + air_x)
        slope_y = (y / z).clamp(-camera.cy / camera.fy - air_y, (camera.height - camera.cy) / camera.fy + air_y)
        rows = [
            [camera.fx / z, none, -camera.fx * slope_x / z],
            [none, camera.fy / z, -camera.fy * slope_y / z],
        ]
        toward = torch.nn.functional.normalize(means + view[:3, :3].T @ view[:3, 3], dim=1)
    jacobian = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
    screen = jacobian @ axes
    covariance = screen @ screen.transpose(1, 2) + 0.3 * torch.eye(2, dtype=kind)
    inverse = torch.linalg.inv(covariance)

    if colours.ndim == 3:
        bands = harmonics(toward, math.isqrt(colours.shape[1]) - 1)
        colours = (torch.einsum("nk,nkc->nc", bands, colours) + 0.5).clamp(min=0)

    pixel_y, pixel_x = torch.meshgrid(
        torch.arange(camera.height, dtype=kind) + 0.5, torch.arange(camera.width, dtype=kind) + 0.5, indexing="ij"
    )
    rgb = torch.zeros(camera.height, camera.width, 3, dtype=kind)
    depth = torch.zeros(camera.height, camera.width, dtype=kind)
    left = torch.ones(camera.height, camera.width, dtype=kind)
    going = torch.ones(camera.height, camera.width, dtype=torch.bool)
    for i in order.tolist():
        offset = torch.stack([pixel_x - u[i], pixel_y - v[i]], dim=-1)
        distance = torch.einsum("hwa,ab,hwb->hw", offset, inverse[i], offset)
        alpha = (opacities[i] * torch.exp(-0.5 * distance)).clamp(max=MAX_ALPHA)
        alpha = torch.where(alpha >= 1 / 255, alpha, 0.0)
        going = going & (left * (1 - alpha) >= 1e-4)
        weight = torch.where(going, left * alpha, 0.0)
        rgb = rgb + weight[..., None] * colours[i]
        depth = depth + weight * z[i]
        left = torch.where(going, left * (1 - alpha), left)
    return rgb + left[..., None] * torch.tensor(background, dtype=kind), 1 - left, depth


def rotations(quats: Tensor) -> Tensor:
    """(N, 3, 3) from quaternions wxyz (N, 4) of any length but 0."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def harmonics(directions: Tensor, degree: int) -> Tensor:
    """(N, (degree+1)^2). Real spherical harmonics from their closed forms, with the signs that 3DGS files use."""
    x, y, z = directions.unbind(1)
    root = [math.sqrt(k / math.pi) for k in range(106)]
    rows = [torch.full_like(x, root[1] / 2)]
    if degree >= 1:
        rows += [-root[3] / 2 * y, root[3] / 2 * z, -root[3] / 2 * x]
    if degree >= 2:
        rows += [
            root[15] / 2 * x * y,
            -root[15] / 2 * y * z,
            root[5] / 4 * (3 * z * z - 1),
            -root[15] / 2 * x * z,
            root[15] / 4 * (x * x - y * y),
        ]
    if degree >= 3:
        rows += [
            -root[35] / (4 * math.sqrt(2)) * y * (3 * x * x - y * y),
            root[105] / 2 * x * y * z,
            -root[21] / (4 * math.sqrt(2)) * y * (5 * z * z - 1),
            root[7] / 4 * z * (5 * z * z - 3),
            -root[21] / (4 * math.sqrt(2)) * x * (5 * z * z - 1),
            root[105] / 4 * z * (x * x - y * y),
            -root[35] / (4 * math.sqrt(2)) * x * (x * x - 3 * y * y),
        ]
    return torch.stack(rows, dim=1)
