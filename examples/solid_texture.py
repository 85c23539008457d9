"""Makes a solid texture: colours of the inside on a lattice, as an array (X, Y, Z, RGB).

python examples/solid_texture.py SOLID.ply texture.npy
"""

import sys

import numpy as np

import fruitninja

solid = fruitninja.open(sys.argv[1])
low, high = solid.bounds
step = (high - low).max() / 32
lattice = np.stack(np.meshgrid(*(np.arange(a, b, step) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
np.save(sys.argv[2], solid.colours(lattice.reshape(-1, 3), footprint=step).reshape(lattice.shape))
