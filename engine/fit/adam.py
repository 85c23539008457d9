"""Adam on named tensors, with its state as arrays for a checkpoint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.optim.adam import adam

__all__ = ["Adam"]

MOMENTS = ("exp_avg", "exp_avg_sq")
"""Names of the moments in a checkpoint: torch's."""


@dataclass
class Adam:
    """torch's Adam in its functional form: a `torch.optim.Optimizer` imports the compiler behind it, which takes two
    seconds in every process that trains. Fused, it reads each array once instead of ten times."""

    parameters: dict[str, torch.Tensor]
    """Leaves that require gradients; changed in place."""
    rates: dict[str, float]
    """Learning rate of each parameter."""
    betas: tuple[float, float]
    eps: float = 1e-8

    def __post_init__(self) -> None:
        for parameter in self.parameters.values():
            parameter.requires_grad_()
        self._moments = {
            name: tuple(torch.zeros_like(parameter, requires_grad=False) for _ in MOMENTS)
            for name, parameter in self.parameters.items()
        }
        self._steps = {name: torch.zeros(()) for name in self.parameters}

    @torch.no_grad()
    def step(self, loss: torch.Tensor, decay: float) -> None:
        """Takes a step down the gradient of a loss, at the rates times `decay`."""
        names = list(self.parameters)
        with torch.enable_grad():
            gradients = torch.autograd.grad(loss, list(self.parameters.values()), allow_unused=True)
        for name, gradient in zip(names, gradients, strict=True):
            if gradient is None:
                continue
            first, second = self._moments[name]
            adam(
                [self.parameters[name]], [gradient], [first], [second], [], [self._steps[name]],
                fused=True, amsgrad=False, beta1=self.betas[0], beta2=self.betas[1], lr=self.rates[name] * decay,
                weight_decay=0.0, eps=self.eps, maximize=False,
            )  # fmt: skip

    def state(self) -> dict[str, NDArray[np.float32]]:
        """The parameters, and Adam's two moments of each."""
        arrays = {name: parameter.detach().numpy() for name, parameter in self.parameters.items()}
        for name, moments in self._moments.items():
            arrays |= {f"{name}.{key}": moment.numpy() for key, moment in zip(MOMENTS, moments, strict=True)}
        return arrays

    def restore(self, state: dict[str, NDArray[np.float32]], step: int) -> None:
        """Restores the state after `step` steps."""
        for name, parameter in self.parameters.items():
            parameter.data.copy_(torch.from_numpy(state[name]))
            for key, moment in zip(MOMENTS, self._moments[name], strict=True):
                moment.copy_(torch.from_numpy(state[f"{name}.{key}"]))
            self._steps[name].fill_(step)
