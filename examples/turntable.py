"""Turns half a solid once around, as numbered pictures in a folder.

python examples/turntable.py SOLID.ply FOLDER
"""

import sys
from pathlib import Path

from PIL import Image

import fruitninja

solid = fruitninja.open(sys.argv[1])
half = solid.cut(fruitninja.Plane.through(solid.bounds.mean(0), solid.up))
out = Path(sys.argv[2])
out.mkdir(parents=True, exist_ok=True)
for number in range(12):
    picture = half.render(azimuth=30 * number, elevation=35, size=(320, 240))
    Image.fromarray(picture).save(out / f"{number:02d}.png")
