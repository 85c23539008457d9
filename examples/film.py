"""Makes a film of a knife passing through a solid, as an animated .webp or .gif.

python examples/film.py SOLID.ply film.webp
"""

import sys

import numpy as np
from PIL import Image

import fruitninja

solid = fruitninja.open(sys.argv[1])
camera = solid.camera(azimuth=30, elevation=40, size=(320, 240))
low, high = solid.bounds @ solid.up
heights = np.linspace(high, low, 14)[1:-1]
frames = [Image.fromarray(solid.cut(fruitninja.Plane.of(solid.up, -height)).render(camera)) for height in heights]
frames[0].save(sys.argv[2], save_all=True, append_images=frames[1:], duration=80, loop=0)
