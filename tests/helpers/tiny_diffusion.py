"""A Stable Diffusion depth model with random weights, small enough for tests, in the folder layout of real ones."""

from __future__ import annotations

import json
import string
from pathlib import Path
from typing import Any

import torch

NATIVE = 64
"""Side in pixels of the pictures that the tiny model works on."""


def save_tiny(folder: Path, channels: int = 5, prediction: str = "epsilon", seed: int = 0) -> Path:
    """Builds the model and saves it as safetensors; `channels` other than 5 gives it no depth input."""
    from diffusers import AutoencoderKL, PNDMScheduler, UNet2DConditionModel
    from transformers import CLIPTextConfig, CLIPTextModel

    with torch.random.fork_rng():
        torch.manual_seed(seed)
        unet = UNet2DConditionModel(
            sample_size=NATIVE // 8,
            in_channels=channels,
            out_channels=4,
            down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"),
            up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"),
            block_out_channels=(16, 32),
            layers_per_block=1,
            cross_attention_dim=16,
            attention_head_dim=(2, 4),
            norm_num_groups=8,
            use_linear_projection=True,
        )
        vae = AutoencoderKL(
            down_block_types=("DownEncoderBlock2D",) * 4,
            up_block_types=("UpDecoderBlock2D",) * 4,
            block_out_channels=(8, 8, 8, 8),
            layers_per_block=1,
            norm_num_groups=4,
            sample_size=NATIVE,
            scaling_factor=5.0,  # codes of about unit variance, as in a trained model
        )
        vocabulary = save_tokenizer(folder / "tokenizer")
        text = CLIPTextModel(
            CLIPTextConfig(
                vocab_size=vocabulary,
                hidden_size=16,
                intermediate_size=32,
                num_hidden_layers=2,
                num_attention_heads=2,
                max_position_embeddings=77,
                bos_token_id=vocabulary - 2,
                eos_token_id=vocabulary - 1,
            )
        )
    models: dict[str, Any] = {"unet": unet, "vae": vae, "text_encoder": text}  # their base classes have no types
    for name, model in models.items():
        model.save_pretrained(folder / name)
    scheduler: Any = PNDMScheduler(
        beta_start=0.00085,
        beta_end=0.012,
        beta_schedule="scaled_linear",
        skip_prk_steps=True,
        prediction_type=prediction,
    )
    scheduler.save_pretrained(folder / "scheduler")
    index = {
        "_class_name": "StableDiffusionDepth2ImgPipeline",
        "unet": ["diffusers", "UNet2DConditionModel"],
        "vae": ["diffusers", "AutoencoderKL"],
        "text_encoder": ["transformers", "CLIPTextModel"],
        "tokenizer": ["transformers", "CLIPTokenizer"],
        "scheduler": ["diffusers", "PNDMScheduler"],
    }
    (folder / "model_index.json").write_text(json.dumps(index))
    return folder


def save_tokenizer(folder: Path) -> int:
    """Writes a CLIP tokenizer that knows single letters only; returns its number of words."""
    letters = string.ascii_lowercase + string.digits + string.punctuation
    words = [*letters, *(letter + "</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    folder.mkdir(parents=True)
    (folder / "vocab.json").write_text(json.dumps({word: index for index, word in enumerate(words)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    config = {"model_max_length": 77, "pad_token": "!", "tokenizer_class": "CLIPTokenizer"}
    (folder / "tokenizer_config.json").write_text(json.dumps(config))
    return len(words)


def save_midas(folder: Path) -> Path:
    """Builds and saves a depth estimator with random weights."""
    from transformers import DPTConfig, DPTForDepthEstimation

    with torch.random.fork_rng():
        torch.manual_seed(3)
        estimator = DPTForDepthEstimation(
            DPTConfig(
                hidden_size=16,
                num_hidden_layers=4,
                num_attention_heads=2,
                intermediate_size=32,
                image_size=32,
                patch_size=8,
                backbone_out_indices=[0, 1, 2, 3],
                neck_hidden_sizes=[8, 8, 8, 8],
                fusion_hidden_size=8,
                readout_type="ignore",
            )
        )
    estimator.save_pretrained(folder)
    return folder
