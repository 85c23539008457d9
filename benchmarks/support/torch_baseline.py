"""The renderer as commonly written in plain torch: projection, a list of Gaussians per tile, dense algebra per tile.

It is the yardstick of the CPU renderers' speed, so it is as fast as its style allows: vectorised over Gaussians and
over (pixel, Gaussian) pairs, one sort, no Python loop except over tiles, and gradients taken tile by tile, so that
500,000 Gaussians fit in memory at all. Same formula as `engine.render.classic`, except for the early end of a pixel,
which dense algebra can only mask.
"""

from __future__ import annotations

import torch
from torch import Tensor

from engine.scene.camera import Camera

__all__ = ["forward", "forward_backward"]

TILE = 16
"""Pixels along a tile's edge: 256 lanes keep torch's vector loops busy; 8 was slower by the overhead of the calls."""


def forward(means: Tensor, scales: Tensor, quats: Tensor, opacities: Tensor, rgb: Tensor, camera: Camera) -> Tensor:
    """(H, W, 3). The picture of N Gaussians on black: means (N, 3), scales (N, 3), quats (N, 4), opacities (N,),
    rgb (N, 3), float32 or float64."""
    with torch.no_grad():
        splats = _project(means, scales, quats, opacities, rgb, camera)
        tiles, pairs = _pairs(splats, camera)
        image = _blank(camera, means)
        for tile, part in zip(tiles.tolist(), pairs, strict=True):
            _put(image, tile, _blend(part, *_pixels(tile, camera, means)), camera)
    return image[: camera.height, : camera.width]


def forward_backward(
    means: Tensor,
    scales: Tensor,
    quats: Tensor,
    opacities: Tensor,
    rgb: Tensor,
    camera: Camera,
    g_rgb: Tensor,  # [H, W, 3] dL/d(picture)
) -> Tensor:
    """Returns the picture, as `forward`; adds dL/d(parameter) to the .grad of every parameter that requires it."""
    splats = _project(means, scales, quats, opacities, rgb, camera)
    tiles, pairs = _pairs(splats, camera)
    image = _blank(camera, means)
    outer = _blank(camera, means)
    outer[: camera.height, : camera.width] = g_rgb
    gradients = []
    for tile, part in zip(tiles.tolist(), pairs, strict=True):
        leaf = part.detach().requires_grad_()
        pixels = _blend(leaf, *_pixels(tile, camera, means))
        x, y = _corner(tile, camera)
        pixels.backward(outer[y : y + TILE, x : x + TILE].reshape(-1, 3))
        assert leaf.grad is not None
        gradients.append(leaf.grad)
        _put(image, tile, pixels.detach(), camera)
    if gradients:
        torch.cat(pairs).backward(torch.cat(gradients))
    return image[: camera.height, : camera.width]


def _project(means: Tensor, scales: Tensor, quats: Tensor, opacities: Tensor, rgb: Tensor, camera: Camera) -> Tensor:
    """(V, 10): u, v, conic a b c, opacity, r g b, depth of the Gaussians in front of the camera, nearest first."""
    view = torch.as_tensor(camera.viewmat, dtype=means.dtype)
    points = means @ view[:3, :3].T + view[:3, 3]
    order = torch.argsort(points[:, 2].detach())
    order = order[points[order, 2] > camera.near]
    points, scales, quats, opacities, rgb = points[order], scales[order], quats[order], opacities[order], rgb[order]
    x, y, z = points.unbind(1)
    w, i, j, k = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    rotation = torch.stack(
        [
            1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j),
            2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i),
            2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j),
        ],
        dim=1,
    ).view(-1, 3, 3)  # fmt: skip
    axes = view[:3, :3] @ rotation * scales[:, None]
    margin_x, margin_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
    slope_x = (x / z).clamp(-camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x)
    slope_y = (y / z).clamp(-camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [camera.fx / z, zero, -camera.fx * slope_x / z, zero, camera.fy / z, -camera.fy * slope_y / z], dim=1
    ).view(-1, 2, 3)
    screen = jacobian @ axes
    covariance = screen @ screen.transpose(1, 2)
    xx, xy, yy = covariance[:, 0, 0] + 0.3, covariance[:, 0, 1], covariance[:, 1, 1] + 0.3
    det = xx * yy - xy * xy
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return torch.cat([torch.stack([u, v, yy / det, -xy / det, xx / det, opacities], dim=1), rgb, z[:, None]], dim=1)


def _pairs(splats: Tensor, camera: Camera) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Tiles that are touched (T,), and the splats of each, as rows, nearest first."""
    across, down = -(-camera.width // TILE), -(-camera.height // TILE)
    with torch.no_grad():
        u, v, a, b, c, opacity = splats[:, :6].unbind(1)
        det = a * c - b * b
        reach = 2 * torch.log(255 * opacity).clamp(min=0)
        rx, ry = (reach * c / det).sqrt(), (reach * a / det).sqrt()
        x0 = ((u - rx) / TILE).floor().clamp(0, across).long()
        x1 = ((u + rx) / TILE).floor().add(1).clamp(0, across).long()
        y0 = ((v - ry) / TILE).floor().clamp(0, down).long()
        y1 = ((v + ry) / TILE).floor().add(1).clamp(0, down).long()
        wide, count = x1 - x0, (x1 - x0) * (y1 - y0)
        owner = torch.repeat_interleave(torch.arange(len(splats)), count)
        place = torch.arange(len(owner)) - (count.cumsum(0) - count)[owner]
        tile = (y0[owner] + place // wide[owner]) * across + x0[owner] + place % wide[owner]
        tile, order = torch.sort(tile, stable=True)
        tiles, counts = torch.unique_consecutive(tile, return_counts=True)
    return tiles, splats[owner[order]].split(counts.tolist())


def _pixels(tile: int, camera: Camera, like: Tensor) -> tuple[Tensor, Tensor]:
    """Centres x, y (TILE^2,) of a tile's pixels."""
    x, y = _corner(tile, camera)
    y_grid, x_grid = torch.meshgrid(
        torch.arange(y, y + TILE, dtype=like.dtype), torch.arange(x, x + TILE, dtype=like.dtype), indexing="ij"
    )
    return x_grid.reshape(-1) + 0.5, y_grid.reshape(-1) + 0.5


def _blend(splats: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """(P, 3). Colours of pixels (P,) through splats (K, 10)."""
    dx, dy = x[:, None] - splats[:, 0], y[:, None] - splats[:, 1]
    power = -0.5 * (splats[:, 2] * dx * dx + splats[:, 4] * dy * dy) - splats[:, 3] * dx * dy
    alpha = (splats[:, 5] * torch.exp(power)).clamp(max=0.99)
    alpha = torch.where(alpha < 1 / 255, 0.0, alpha)
    after = torch.cumprod(1 - alpha, dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    weight = torch.where(after >= 1e-4, before * alpha, 0.0)
    return weight @ splats[:, 6:9]


def _corner(tile: int, camera: Camera) -> tuple[int, int]:
    across = -(-camera.width // TILE)
    return tile % across * TILE, tile // across * TILE


def _blank(camera: Camera, like: Tensor) -> Tensor:
    return like.new_zeros(-(-camera.height // TILE) * TILE, -(-camera.width // TILE) * TILE, 3)


def _put(image: Tensor, tile: int, pixels: Tensor, camera: Camera) -> None:
    x, y = _corner(tile, camera)
    image[y : y + TILE, x : x + TILE] = pixels.view(TILE, TILE, 3)
