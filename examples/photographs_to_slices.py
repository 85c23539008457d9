"""Gives a capture an inside from two photographs of cut faces, and saves slices of it that nobody photographed.

python examples/photographs_to_slices.py CAPTURE HORIZONTAL RADIAL OUT
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import fruitninja

capture, horizontal, radial, out = sys.argv[1:]
solid = fruitninja.grow(
    capture, horizontal=horizontal, radial=radial, detail="draft", up="z", progress=lambda *at: print(*at)
)
Path(out).mkdir(parents=True, exist_ok=True)
solid.save(Path(out) / "solid.ply")
for number, tilt in enumerate((0.0, 0.5, 1.0)):
    plane = fruitninja.Plane.through(solid.bounds.mean(0), solid.up + np.array([tilt, 0, 0]))
    Image.fromarray(solid.section(plane)).save(Path(out) / f"slice_{number}.png")
