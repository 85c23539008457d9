"""Classic 3DGS on the CPU, differentiable: the picture of `rasterizer` as an operation of torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from engine.render.classic.rasterizer import composite, composite_backward, picture
from engine.render.classic.records import PictureGradient, Scene
from engine.scene.camera import Camera

__all__ = ["rasterize"]


def rasterize(
    means: torch.Tensor,  # [N, 3]
    scales: torch.Tensor,  # [N, 3]
    quats: torch.Tensor,  # [N, 4]
    opacities: torch.Tensor,  # [N]
    colours: torch.Tensor,  # [N, 3] RGB or [N, (d+1)^2, 3] SH
    camera: Camera,
    background: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(rgb (H, W, 3), alpha (H, W), depth times alpha (H, W)), differentiable in all five tensors.

    CPU tensors, all float32 or all float64, as in `Gaussians`; quaternions of any length, which is divided out (length
    0 is no rotation). RGB is used unchanged; SH is evaluated in the direction of the Gaussian and clamped below at 0.
    The gradient of the means includes that of the viewing direction. Clamped or skipped terms pass no gradient on.
    """
    n, kind = len(means), means.dtype
    assert kind in (torch.float32, torch.float64), kind
    for tensor in (scales, quats, opacities, colours):
        assert tensor.dtype == kind, f"{tensor.dtype} beside {kind}"
        assert tensor.device.type == "cpu", tensor.device
    assert means.shape == scales.shape == (n, 3), (means.shape, scales.shape)
    assert quats.shape == (n, 4) and opacities.shape == (n,), (quats.shape, opacities.shape)
    assert colours.shape == (n, 3) or (colours.ndim == 3 and colours.shape[1] in (1, 4, 9, 16)), colours.shape
    return _Rasterize.apply(means, scales, quats, opacities, colours, camera, tuple(background))


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: torch.Tensor,
        scales: torch.Tensor,
        quats: torch.Tensor,
        opacities: torch.Tensor,
        colours: torch.Tensor,
        camera: Camera,
        background: tuple[float, ...],
    ) -> tuple[torch.Tensor, ...]:
        tensors = (means, scales, quats, opacities, colours)
        arrays = [tensor.detach().contiguous().numpy() for tensor in tensors]
        plain = colours.ndim == 2
        m, s, q, o, c = arrays
        scene = Scene(m, s, q, o, c[:, None] if plain else c, plain)
        frame, slices = composite(scene, camera)
        ctx.save_for_backward(*tensors)  # raises if one is written to before the backward pass
        ctx.scene, ctx.frame, ctx.slices, ctx.camera, ctx.background = scene, frame, slices, camera, background
        # torch would fill a missing gradient with its own threads, which then spin on a core, waiting for more work.
        ctx.set_materialize_grads(False)
        return tuple(torch.from_numpy(array) for array in picture(frame, camera, background)[:3])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(
        ctx: Any, g_rgb: torch.Tensor | None, g_alpha: torch.Tensor | None, g_depth: torch.Tensor | None
    ) -> tuple[torch.Tensor | None, ...]:
        tensors = ctx.saved_tensors
        size, kind = (ctx.camera.height, ctx.camera.width), ctx.scene.means.dtype
        outer = [
            np.zeros(shape, kind) if gradient is None else gradient.contiguous().numpy()
            for gradient, shape in ((g_rgb, (*size, 3)), (g_alpha, size), (g_depth, size))
        ]
        has_depth = bool(outer[2].any())
        rgb, alpha, depth = outer
        gradient = PictureGradient(rgb, alpha, depth, has_depth, np.array(ctx.background, kind))
        gradients = composite_backward(ctx.scene, ctx.frame, ctx.slices, gradient)
        return (*(torch.from_numpy(g).view(t.shape) for g, t in zip(gradients, tensors, strict=True)), None, None)
