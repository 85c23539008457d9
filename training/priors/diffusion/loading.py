"""Reads a Stable Diffusion depth model from a local folder; predicts the noise in its latents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from diffusers import AutoencoderKL, DDPMScheduler, UNet2DConditionModel
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional
from transformers import CLIPTextModel, CLIPTokenizer

from engine.errors import InputError
from engine.io.files import read_file
from engine.io.strict_json import parse
from training.families import Kind

__all__ = ["PROMPTS_FILE", "Model", "load_model", "load_part", "resized"]

Prediction = Literal["epsilon", "v_prediction"]

PROMPTS_FILE = "fruitninja.json"
"""File in the folder of a fine-tuned model with the prompts that it learned."""

DEPTH_CHANNELS = 5
"""Input channels of a depth-conditioned model: four of the latent and one of depth."""

PICKLES = ("*.bin", "*.ckpt", "*.pt", "*.pth")


@dataclass
class Model:
    """The parts of a loaded model; latents are (B, 4, h, w) here, pictures (B, 3, H, W) in [0, 1]."""

    folder: Path
    unet: Any
    vae: Any
    text_encoder: Any
    tokenizer: Any
    sigmas: NDArray[np.float64]
    """(T,). Noise over signal of each timestep, sqrt((1 - a) / a) for a the cumulative product of the alphas."""
    prediction: Prediction
    device: torch.device
    prompts: dict[Kind, str]
    """Prompts that the model was fine-tuned on; empty for other models."""

    @property
    def latent_cell(self) -> int:
        """Pixels per latent cell along a side."""
        return 2 ** (len(self.vae.config.block_out_channels) - 1)

    def working_size(self, height: int, width: int) -> tuple[int, int]:
        """The size in pixels at which to encode a picture of this shape: its longer side as in the model's training.

        Smaller pictures must be enlarged: the model draws every object at the scale it was trained on.
        """
        native = int(np.max(self.unet.config.sample_size))
        scale = native / max(height, width)
        rows, columns = (max(1, round(side * scale)) for side in (height, width))
        return rows * self.latent_cell, columns * self.latent_cell

    @torch.no_grad()
    def encode(self, pictures: Tensor) -> Tensor:
        """Latents of pictures whose sides are multiples of `latent_cell`; the encoder's mean, hence deterministic."""
        given = (2 * pictures - 1).to(self.device, self.vae.dtype)
        return self.vae.encode(given).latent_dist.mode().float() * self.vae.config.scaling_factor

    @torch.no_grad()
    def decode(self, latents: Tensor) -> Tensor:
        """Pictures of latents, unclipped."""
        given = latents.to(self.device, self.vae.dtype) / self.vae.config.scaling_factor
        return (self.vae.decode(given).sample.float() + 1) / 2

    @torch.no_grad()
    def embed(self, prompts: Sequence[str]) -> Tensor:
        """(B, tokens, dim). The text embeddings of prompts."""
        words = self.tokenizer(
            list(prompts),
            padding="max_length",
            max_length=self.text_encoder.config.max_position_embeddings,
            truncation=True,
            return_tensors="pt",
        )
        return self.text_encoder(words.input_ids.to(self.device))[0]

    def noise(self, latents: Tensor, sigma: float | Tensor, text: Tensor, depth: Tensor) -> Tensor:
        """(B, 4, h, w). The noise in latents = clean + sigma * noise, of unit variance.

        The network expects sqrt(a) clean + sqrt(1 - a) noise with sigma^2 = (1 - a) / a, so its input is the latents
        over sqrt(1 + sigma^2), at the timestep whose sigma is nearest on a logarithmic scale.
        sigma: one for all or (B,); text: (B, tokens, dim); depth: (B, 1, h, w) in [-1, 1], near is large.
        """
        assert latents.ndim == 4 and depth.shape == (len(latents), 1, *latents.shape[2:]), (latents.shape, depth.shape)
        level = torch.as_tensor(sigma, dtype=torch.float32, device=latents.device).expand(len(latents))
        signal = torch.rsqrt(1 + level**2)[:, None, None, None]
        scaled = latents * signal
        given = torch.cat([scaled, depth.to(latents)], dim=1).to(self.unet.dtype)
        output = self.unet(given, self.timestep(level), text.to(self.unet.dtype)).sample.float()
        if self.prediction == "v_prediction":
            # v = sqrt(a) noise - sqrt(1 - a) clean (Salimans and Ho 2022), solved with the input for the noise
            output = signal * output + level[:, None, None, None] * signal * scaled
        return output

    def guided(
        self, latents: Tensor, sigma: float, text: Tensor, empty: Tensor, depth: Tensor, guidance: float
    ) -> Tensor:
        """The noise in one latent with classifier-free guidance (Ho and Salimans 2022)."""
        if guidance == 1:
            return self.noise(latents, sigma, text, depth)
        twice = [torch.cat([part, part]) for part in (latents, depth)]
        unconditional, conditional = self.noise(twice[0], sigma, torch.cat([empty, text]), twice[1]).chunk(2)
        return unconditional + guidance * (conditional - unconditional)

    def timestep(self, sigma: Tensor) -> Tensor:
        """(B,). The timesteps nearest to noise levels (B,)."""
        log_sigma = np.log(np.maximum(sigma.cpu().double().numpy(), 1e-9))
        nearest = np.abs(np.log(self.sigmas) - log_sigma[:, None]).argmin(1)
        return torch.from_numpy(nearest).to(sigma.device)


def load_model(folder: str | Path, half: bool, device: torch.device | None = None) -> Model:
    """Reads a model in the layout of diffusers, onto the best available device unless one is given.

    `half`: a CUDA device holds the network in 16 bits, for inference only. Raises InputError for
    a folder that is missing, incomplete, damaged, pickled, or holds another kind of model.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a depth model of Stable Diffusion in the layout of diffusers")
    scheduler = read_json(folder / "scheduler" / "scheduler_config.json")
    prediction = scheduler.get("prediction_type", "epsilon")
    if prediction not in get_args(Prediction):
        raise InputError(f"{folder}: a model that predicts '{prediction}' cannot be used; give one that predicts noise")
    channels = read_json(folder / "unet" / "config.json").get("in_channels")
    if channels != DEPTH_CHANNELS:
        raise InputError(
            f"{folder}: not a depth-conditioned model ({channels} input channels instead of {DEPTH_CHANNELS}); "
            "give one such as stable-diffusion-2-depth"
        )
    device = device or best_device()
    unet = load_part(UNet2DConditionModel, folder / "unet")
    return Model(
        folder=folder,
        unet=unet.to(device, torch.float16 if half and device.type == "cuda" else torch.float32),
        # The decoder overflows in 16 bits on some pictures, and is cheap beside the network.
        vae=load_part(AutoencoderKL, folder / "vae").to(device, torch.float32),
        text_encoder=load_part(CLIPTextModel, folder / "text_encoder").to(device, torch.float32),
        tokenizer=load_tokenizer(folder / "tokenizer"),
        sigmas=read_sigmas(folder / "scheduler"),
        prediction=prediction,
        device=device,
        prompts=read_prompts(folder / PROMPTS_FILE),
    )


def best_device() -> torch.device:
    """CUDA, else Apple's GPU, else the CPU."""
    if torch.cuda.is_available():
        return torch.device("cuda")
    return torch.device("mps" if torch.backends.mps.is_available() else "cpu")


def load_part(kind: Any, folder: Path) -> Any:
    """One network from the safetensors in its folder, frozen. Raises InputError if a weight is missing."""
    read_json(folder / "config.json")
    names = [path.name for path in folder.glob("*.safetensors")]
    if not names:
        pickled = sorted(path.name for pattern in PICKLES for path in folder.glob(pattern))
        if pickled:
            raise InputError(
                f"{folder / pickled[0]}: pickled weights, which can run code when they are read; "
                "give the model as .safetensors"
            )
        raise InputError(f"{folder}: no weights; a .safetensors file should be there")
    variant = None if any(".fp16." not in name for name in names) else "fp16"
    try:
        network, found = kind.from_pretrained(
            folder,
            variant=variant,
            local_files_only=True,
            use_safetensors=True,
            torch_dtype=torch.float32,
            output_loading_info=True,
        )
    except Exception as error:  # the libraries raise many types for a damaged file
        raise InputError(f"{folder}: cannot be read ({one_line(error)})") from error
    lacking = sorted([*found["missing_keys"], *(key for key, *_ in found["mismatched_keys"])])
    if lacking:
        raise InputError(f"{folder}: {len(lacking)} weights are missing or of another size, such as {lacking[0]}")
    return network.eval().requires_grad_(False)


def load_tokenizer(folder: Path) -> Any:
    """The tokenizer from vocab.json and merges.txt, or from tokenizer.json."""
    if not (folder / "tokenizer.json").is_file():
        for name in ("vocab.json", "merges.txt"):
            if not (folder / name).is_file():
                raise InputError(f"{folder / name}: missing; copy the model's tokenizer folder whole")
    try:
        return CLIPTokenizer.from_pretrained(folder, local_files_only=True)
    except Exception as error:  # as above
        raise InputError(f"{folder}: not a tokenizer that can be read ({one_line(error)})") from error


def read_sigmas(folder: Path) -> NDArray[np.float64]:
    """(T,). Noise over signal of each timestep. Schedules that end in pure noise are clipped to finite values."""
    try:
        signal = DDPMScheduler.from_pretrained(folder, local_files_only=True).alphas_cumprod.double().numpy()
    except Exception as error:  # as above
        raise InputError(f"{folder}: not a noise schedule that can be read ({one_line(error)})") from error
    signal = np.clip(signal, 1e-6, 1 - 1e-9)
    return np.sqrt((1 - signal) / signal)


def read_prompts(path: Path) -> dict[Kind, str]:
    """The prompts of a fine-tuned model; empty without their file."""
    if not path.is_file():
        return {}
    prompts = read_json(path).get("prompts")
    if not isinstance(prompts, dict):
        raise InputError(f"{path}: no 'prompts' in it; fine-tune the model again, or delete the file")
    return {kind: str(prompts[kind]) for kind in get_args(Kind) if kind in prompts}


JSON_LIMIT = 1 << 24
"""Largest accepted configuration file in bytes; real ones have a few KB."""


def read_json(path: Path) -> dict[str, Any]:
    """An object from a JSON file."""
    if not path.exists():
        raise InputError(f"{path}: missing; give a whole model in the layout of diffusers")
    try:
        value = parse(read_file(path, JSON_LIMIT))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: cannot be read ({one_line(error)})") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: not a JSON object")
    return value


def one_line(error: Exception) -> str:
    """The first line of a library's error message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def resized(pictures: Tensor, size: tuple[int, int]) -> Tensor:
    """(B, C, *size). Pictures (B, C, H, W) at another size, without aliasing."""
    if pictures.shape[2:] == size:
        return pictures
    return functional.interpolate(pictures, size=size, mode="bilinear", antialias=True, align_corners=False)
