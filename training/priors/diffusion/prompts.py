"""Prompts for the families of cut faces."""

from __future__ import annotations

from typing import get_args

from training.families import Kind

__all__ = ["TOKEN", "plain_prompts", "tuned_prompts"]

TOKEN = "sks"
"""DreamBooth's identifier for the look of the pictures: a single CLIP token, rare in captions."""

# The first is the paper's own example (section 3.2); its radial and parallel slices are both "vertical" there, but a
# loaf may have pictures of both, which need different prompts.
VIEWS: dict[Kind, str] = {
    "horizontal": "the horizontal cross-sectional view of {}",
    "radial": "the vertical cross-sectional view of {}",
    "parallel": "the cross-sectional view of a slice of {}",
    "custom": "the cross-sectional view of {}",
}


def plain_prompts(object_name: str) -> dict[Kind, str]:
    """A prompt for every kind of family of an object, such as "watermelon"."""
    article = "an" if object_name[:1].lower() in set("aeiou") else "a"
    return {kind: VIEWS[kind].format(f"{article} {object_name}") for kind in get_args(Kind)}


def tuned_prompts(object_name: str) -> dict[Kind, str]:
    """Prompts for the object that a model was fine-tuned on (DreamBooth's "a [V] class")."""
    return plain_prompts(f"{TOKEN} {object_name}")
