"""Converts outlines of faces between polygons, which are edited and stored, and masks, which are used."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from training.faces.marks import MOST_POINTS, Place

__all__ = ["mask_polygon", "polygon_mask"]

OVER = 4
"""Subpixels along a pixel's side at which a polygon is drawn as a mask, and a mask is traced."""

SMOOTH = 0.0015
"""How far a polygon may be from its outline, as a fraction of the face's width. With this, 65 to 144 points describe 29
masks of photographs of 512 pixels, and 0.998 or more of what polygon and mask cover is common to both."""

LEAST = 0.6
"""Least such distance in pixels: no outline is known better."""

BLUR = 1.0
"""Pixels by which a mask is blurred before it is traced; corners lose a third of a pixel."""


def polygon_mask(outline: tuple[Place, ...], height: int, width: int) -> NDArray[np.bool_]:
    """(H, W). The pixels of which a polygon encloses half or more."""
    image = Image.new("L", (width * OVER, height * OVER))
    # Pillow counts places from the centre of the first pixel.
    ImageDraw.Draw(image).polygon([(x * width * OVER - 0.5, y * height * OVER - 0.5) for x, y in outline], fill=255)
    return np.asarray(image.resize((width, height), Image.Resampling.BOX)) > 127


def mask_polygon(mask: NDArray[np.bool_]) -> tuple[Place, ...] | None:
    """The outline of the largest part of a mask (H, W), with as few points as show it; None if the mask has none."""
    height, width = mask.shape
    padded = np.pad(mask, 1).astype(np.float32)
    # Blurred, or the polygon would follow the steps of the pixels.
    soft = cv2.GaussianBlur(padded, (0, 0), BLUR, borderType=cv2.BORDER_REPLICATE)
    size = padded.shape[1] * OVER, padded.shape[0] * OVER
    fine = (cv2.resize(soft, size, interpolation=cv2.INTER_LINEAR) > 0.5).astype(np.uint8)
    found, _ = cv2.findContours(fine, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not found:
        return None
    contour = max(found, key=cv2.contourArea)
    span = int(np.ptp(contour[:, 0, 0])) + 1
    tolerance = max(SMOOTH * span, LEAST * OVER)
    while len(corners := cv2.approxPolyDP(contour, tolerance, True)[:, 0]) > MOST_POINTS:
        tolerance *= 2
    if len(corners) < 3:
        return None
    # A contour runs through the centres of the outermost subpixels, in a mask with one more pixel on each side.
    places = np.clip(((corners + 0.5) / OVER - 1) / (width, height), 0, 1)
    return tuple((float(x), float(y)) for x, y in places)
