"""DreamBooth: teaches a model the look of one object from 1 to 6 photographs of its cut faces (paper, section 3.2).

Two losses, as in Ruiz et al. 2023: one on the photographs (instances) under a prompt with a rare word, and one on
pictures of the class that the original model drew under the plain prompt, which preserves its prior.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from peft import LoraConfig
from torch import Tensor

from engine.errors import InputError
from training.families import Kind
from training.priors.diffusion.depth import exact_depth
from training.priors.diffusion.loading import Model, load_model, resized
from training.priors.diffusion.prior import GUIDANCE
from training.priors.diffusion.prompts import plain_prompts, tuned_prompts
from training.priors.diffusion.saving import check_free, save_model
from training.priors.exemplar import Picture, read_picture
from training.priors.prior import Progress

__all__ = ["STEPS", "finetune"]

STEPS = 400
"""Enough for a few pictures: DreamBooth takes 100 to 200 per picture."""

LORA_RANK = 8
LORA_RATE = 1e-4
FULL_RATE = 5e-6
"""Learning rates: DreamBooth's for the entire network; the few new weights of LoRA start at zero and take larger
steps."""

PLACEMENTS = 8
"""Random placements of each picture: a section's camera shows slices near a pole smaller than those in the middle."""

FACE_EXTENT = (0.5, 0.9)
"""Range of the longer side of the cut face over the side of the frame in those placements."""

STEPS_PER_CLASS_PICTURE = 16
"""Training steps per class picture: drawing them then takes about as long as the training."""

CLASS_WEIGHT = 1.0
"""Weight of the class loss relative to the instance loss: DreamBooth's lambda."""

SAMPLER_STEPS = 25
SAMPLER_CURVE = 7.0
"""Noise levels of a class picture are even in sigma^(1/7) (Karras et al. 2022, eq. 5)."""


@dataclass
class Examples:
    """Training examples: latents of cut faces of one kind under one prompt."""

    latents: Tensor
    """(N, 4, h, w)."""
    depth: Tensor
    """(N, 1, h, w)."""
    text: Tensor
    """(1, tokens, dim)."""


def finetune(
    folder: str | Path,
    pictures: Mapping[Kind, Sequence[Path]],
    object_name: str,
    out: str | Path,
    full: bool = False,
    steps: int = STEPS,
    seed: int = 0,
    on_class: Progress = lambda part: None,
    on_step: Callable[[int, float], None] = lambda step, loss: None,
    device: torch.device | None = None,
) -> list[float]:
    """Trains the network and writes a complete model to `out`; returns the instance loss of each step.

    Trains LoRA on the attention layers, merged at the end, or every weight of the network if `full`. Text encoder and
    autoencoder stay unchanged. Bit-equal for a seed on one machine; `out` is written atomically. Raises InputError for
    a model or a picture that cannot be used, and if `out` exists.
    """
    out = Path(out)
    if not any(pictures.values()):
        raise InputError("no picture of a cut face; give at least one, as in --exemplar horizontal=cut.png")
    check_free(out)
    cut = {kind: [read_picture(path, kind) for path in paths] for kind, paths in pictures.items() if paths}
    model = load_model(folder, half=False, device=device)
    rng = np.random.default_rng(seed)
    instances = {
        kind: instance_examples(model, kind, shown, tuned_prompts(object_name)[kind], rng)
        for kind, shown in cut.items()
    }
    class_sets = class_examples(model, instances, plain_prompts(object_name), steps, rng, on_class)
    losses = train(model, instances, class_sets, full, steps, seed, rng, on_step)
    save_model(model, out, object_name)
    return losses


def instance_examples(
    model: Model, kind: Kind, shown: Sequence[Picture], prompt: str, rng: np.random.Generator
) -> Examples:
    """The photographs of one kind in several placements, each with the depth map that conditions its label."""
    latents: list[Tensor] = []
    depths: list[Tensor] = []
    for picture in shown:
        for _ in range(PLACEMENTS):
            face, inside = place_randomly(picture, kind, model, rng)
            latent = model.encode(face)
            latents.append(latent)
            flat = np.ones(inside.shape, np.float32)
            depths.append(resized(exact_depth(inside, flat), (latent.shape[2], latent.shape[3])))
    return Examples(torch.cat(latents), torch.cat(depths).to(model.device), model.embed([prompt]))


def place_randomly(
    picture: Picture, kind: Kind, model: Model, rng: np.random.Generator
) -> tuple[Tensor, NDArray[np.bool_]]:
    """(1, 3, S, S) and (S, S). A cut face on white at a random size and orientation, as a section's camera would see
    it.

    Horizontal pictures may be rotated by quarter turns; the others are mirrored only, as up must stay up.
    """
    side = model.working_size(1, 1)[0]
    layers = np.concatenate([np.where(picture.mask[..., None], picture.rgb, 1), picture.mask[..., None]], -1)
    layers = np.rot90(layers, int(rng.integers(4)) if kind == "horizontal" else 0)
    layers = layers[:, ::-1] if rng.integers(2) else layers
    scale = side * rng.uniform(*FACE_EXTENT) / max(layers.shape[:2])
    height, width = (max(1, round(length * scale)) for length in layers.shape[:2])
    small = torch.from_numpy(np.ascontiguousarray(layers, np.float32)).permute(2, 0, 1)[None]
    top, left = (side - height) // 2, (side - width) // 2
    frame = torch.cat([torch.ones(1, 3, side, side), torch.zeros(1, 1, side, side)], 1)
    frame[:, :, top : top + height, left : left + width] = resized(small, (height, width))
    return frame[:, :3], frame[0, 3].numpy() > 0.5


def class_examples(
    model: Model,
    instances: Mapping[Kind, Examples],
    prompts: Mapping[Kind, str],
    steps: int,
    rng: np.random.Generator,
    progress: Progress,
) -> dict[Kind, Examples]:
    """Latents of class pictures drawn by the original model in the silhouettes of the photographs."""
    count = max(1, -(-steps // (STEPS_PER_CLASS_PICTURE * len(instances))))
    empty = model.embed([""])
    class_sets = {}
    for index, (kind, examples) in enumerate(instances.items()):
        text = model.embed([prompts[kind]])
        depth = examples.depth[rng.integers(len(examples.depth), size=count)]
        latents = []
        for done in range(count):
            latents.append(sample(model, text, empty, depth[done : done + 1], rng))
            progress((index + (done + 1) / count) / len(instances))
        class_sets[kind] = Examples(torch.cat(latents), depth, text)
    return class_sets


@torch.no_grad()
def sample(model: Model, text: Tensor, empty: Tensor, depth: Tensor, rng: np.random.Generator) -> Tensor:
    """(1, 4, h, w). A latent sampled by DDIM: Euler steps of dx/dsigma = noise, from the highest sigma to none."""
    high, low = (s ** (1 / SAMPLER_CURVE) for s in (model.sigmas[-1], model.sigmas[0]))
    sigmas = [*(np.linspace(high, low, SAMPLER_STEPS) ** SAMPLER_CURVE).tolist(), 0.0]
    latents = sigmas[0] * gaussian(rng, (1, 4, *depth.shape[2:]), model.device)
    for now, then in pairwise(sigmas):
        latents = latents + (then - now) * model.guided(latents, now, text, empty, depth, GUIDANCE)
    return latents


def train(
    model: Model,
    instances: Mapping[Kind, Examples],
    class_sets: Mapping[Kind, Examples],
    full: bool,
    steps: int,
    seed: int,
    rng: np.random.Generator,
    on_step: Callable[[int, float], None],
) -> list[float]:
    """Trains on one photograph and one class picture per step; leaves the model frozen. Returns the instance losses."""
    unet = model.unet
    unet.enable_gradient_checkpointing()  # else the attention of a real model at 512 x 512 takes some 10 GB
    if full:
        unet.requires_grad_(True)
    else:
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            unet.add_adapter(
                LoraConfig(
                    r=LORA_RANK,
                    lora_alpha=LORA_RANK,
                    init_lora_weights="gaussian",
                    target_modules=["to_q", "to_k", "to_v", "to_out.0"],
                )
            )
    weights = [weight for weight in unet.parameters() if weight.requires_grad]
    optimiser = torch.optim.AdamW(weights, lr=FULL_RATE if full else LORA_RATE)
    kinds = list(instances)
    losses = []
    for step in range(steps):
        kind = kinds[int(rng.integers(len(kinds)))]
        batch = [draw(examples, rng) for examples in (instances[kind], class_sets[kind])]
        latents, depth, text = (torch.cat(parts) for parts in zip(*batch, strict=True))
        each = noise_losses(model, latents, depth, text, rng)
        loss = each[0] + CLASS_WEIGHT * each[1]
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(weights, 1.0)
        optimiser.step()
        losses.append(float(each[0].detach()))
        if not np.isfinite(losses[-1]):
            raise InputError(f"{model.folder}: training left the numbers a computer knows; the weights are damaged")
        on_step(step + 1, losses[-1])
    unet.disable_gradient_checkpointing()
    if not full:
        unet.fuse_lora()
        unet.unload_lora()
    unet.requires_grad_(False)
    return losses


def draw(examples: Examples, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """A random latent of some examples with its depth and text."""
    index = int(rng.integers(len(examples.latents)))
    return examples.latents[index : index + 1], examples.depth[index : index + 1], examples.text


def noise_losses(model: Model, latents: Tensor, depth: Tensor, text: Tensor, rng: np.random.Generator) -> Tensor:
    """(B,). Mean squared error of the noise at random timesteps, weighted as in the model's training.

    The error of v is the error of the noise times sqrt(1 + sigma^2), so one expression serves both kinds of model.
    """
    sigma = torch.from_numpy(model.sigmas[rng.integers(len(model.sigmas), size=len(latents))]).float().to(model.device)
    noise = gaussian(rng, tuple(latents.shape), model.device)
    with torch.autocast(model.device.type, torch.bfloat16, enabled=model.device.type == "cuda"):
        found = model.noise(latents + sigma[:, None, None, None] * noise, sigma, text, depth)
    error = ((found - noise) ** 2).mean(dim=(1, 2, 3))
    return error * (1 + sigma**2) if model.prediction == "v_prediction" else error


def gaussian(rng: np.random.Generator, shape: tuple[int, ...], device: torch.device) -> Tensor:
    """Standard normal numbers from numpy's generator, the same on every device."""
    return torch.from_numpy(rng.standard_normal(shape, dtype=np.float32)).to(device)
