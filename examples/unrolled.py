"""Makes a cut that no knife can: a cylinder around the up axis, at half the radius, unrolled into a picture.

python examples/unrolled.py SOLID.ply unrolled.png
"""

import sys

import numpy as np
from PIL import Image

import fruitninja

solid = fruitninja.open(sys.argv[1])
low, high = solid.bounds
e1 = np.cross(solid.up, np.eye(3)[np.abs(solid.up).argmin()])
e1 /= np.linalg.norm(e1)
e2 = np.cross(solid.up, e1)
radius = 0.25 * np.ptp(solid.bounds @ e1)
angle, height = np.meshgrid(
    np.linspace(0, 2 * np.pi, 512), 0.3 * np.ptp(solid.bounds @ solid.up) * np.linspace(1, -1, 192)
)
around = np.cos(angle)[..., None] * e1 + np.sin(angle)[..., None] * e2
points = (low + high) / 2 + radius * around + height[..., None] * solid.up
rgb = solid.colours(points.reshape(-1, 3)).reshape(points.shape)
Image.fromarray(np.round(255 * rgb).astype(np.uint8)).save(sys.argv[2])
