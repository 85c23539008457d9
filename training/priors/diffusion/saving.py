"""Writes a fine-tuned model as a complete folder in the layout of diffusers."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path

import torch
from safetensors import safe_open

from engine.errors import InputError
from engine.io.files import reason
from engine.io.scratch import atomic_folder
from training.priors.diffusion.loading import PROMPTS_FILE, Model
from training.priors.diffusion.prompts import TOKEN, tuned_prompts

__all__ = ["check_free", "save_model"]

PARTS = ("vae", "text_encoder", "tokenizer", "scheduler", "depth_estimator", "feature_extractor")
"""Parts of a model other than its network; the last two are for programs that estimate depth."""

INDEX = "model_index.json"


def check_free(out: Path) -> None:
    """Raises InputError if a model cannot be written to `out`; called before hours of work, not after."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already; give a new folder")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=out.parent).close()
    except OSError as error:
        raise InputError(f"{out}: cannot be written here ({reason(error)})") from error


def save_model(model: Model, out: Path, object_name: str) -> None:
    """Writes the trained network, the other parts of the original model, and the prompts that it learned.

    The network keeps the precision of its original file. Raises InputError, and leaves nothing behind, if the folder
    cannot be written.
    """
    precision = stored_type(model.folder / "unet")
    note = {"object": object_name, "token": TOKEN, "prompts": tuned_prompts(object_name)}
    text = json.dumps(note, indent=1) + "\n"
    unet = model.unet.to(precision)
    with atomic_folder(out) as temporary:
        for name in PARTS:
            if (model.folder / name).is_dir():
                shutil.copytree(model.folder / name, temporary / name, ignore=unwanted)
        if (model.folder / INDEX).is_file():
            shutil.copy2(model.folder / INDEX, temporary)
        unet.save_pretrained(temporary / "unet", safe_serialization=True)
        (temporary / PROMPTS_FILE).write_text(text, encoding="utf-8")


def unwanted(_: str, names: Iterable[str]) -> list[str]:
    """Files never read: weights in other formats than safetensors, and second copies in 16 bits."""
    names = list(names)
    full = any(name.endswith(".safetensors") and ".fp16." not in name for name in names)
    pickled = (".bin", ".ckpt", ".h5", ".msgpack", ".pt", ".pth")
    return [name for name in names if name.endswith(pickled) or (full and ".fp16." in name)]


def stored_type(folder: Path) -> torch.dtype:
    """The data type of the weights in a folder."""
    names = sorted(folder.glob("*.safetensors"), key=lambda path: ".fp16." in path.name)
    with safe_open(names[0], "pt") as weights:
        return weights.get_tensor(next(iter(weights.keys()))).dtype
