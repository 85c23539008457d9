"""The state of an optimisation with torch's Adam as arrays, for a checkpoint."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

__all__ = ["adam_state", "restore_adam"]

MOMENTS = ("exp_avg", "exp_avg_sq")
"""Keys of the moments in the state of torch's Adam."""


def adam_state(parameters: dict[str, torch.Tensor], optimiser: torch.optim.Adam) -> dict[str, NDArray[np.float32]]:
    """The parameters and, after the first step, Adam's moments of each."""
    state = {name: parameter.detach().numpy() for name, parameter in parameters.items()}
    for name, parameter in parameters.items():
        moments = optimiser.state.get(parameter, {})  # empty before the first step
        state |= {f"{name}.{key}": moments[key].numpy() for key in MOMENTS if key in moments}
    return state


def restore_adam(
    state: dict[str, NDArray[np.float32]], step: int, parameters: dict[str, torch.Tensor], optimiser: torch.optim.Adam
) -> None:
    """Puts the `adam_state` after `step` steps back into the parameters and their optimiser."""
    for name, parameter in parameters.items():
        parameter.data.copy_(torch.from_numpy(state[name]))
        if f"{name}.{MOMENTS[0]}" in state:
            moments = {key: torch.from_numpy(state[f"{name}.{key}"].copy()) for key in MOMENTS}
            optimiser.state[parameter] = {"step": torch.tensor(float(step)), **moments}
