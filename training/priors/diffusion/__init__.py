"""The Stable Diffusion prior: depth-conditioned models from a local folder, and their fine-tuning on photographs.

Needs the packages of the `diffusion` extra; importing this without them raises InputError.
"""

from __future__ import annotations

import os

from engine.errors import InputError

# Read when the libraries below are imported. Models come from local folders only; nothing may access a model hub.
os.environ["HF_HUB_OFFLINE"] = "1"

try:
    import diffusers
    import peft  # noqa: F401 (imported here, so that fine-tuning does not fail at its end)
    import transformers
except ImportError as error:
    raise InputError(
        f"Stable Diffusion needs more packages ({error.name} is missing); pip install fruitninja[diffusion]"
    ) from error

from training.priors.diffusion.dreambooth import STEPS, finetune
from training.priors.diffusion.prior import StableDiffusionPrior

__all__ = ["STEPS", "StableDiffusionPrior", "finetune"]

# This project reports errors in one line; the libraries' own messages about files are silenced.
for _library in (diffusers, transformers):
    _library.utils.logging.set_verbosity_error()
    _library.utils.logging.disable_progress_bar()
