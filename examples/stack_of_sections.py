"""Stacks evenly spaced sections along the up axis, all at one scale, as one array (layers, height, width, RGBA).

python examples/stack_of_sections.py SOLID.ply stack.npy
"""

import sys

import numpy as np

import fruitninja

solid = fruitninja.open(sys.argv[1])
low, high = solid.bounds @ solid.up
heights = np.linspace(low, high, 18)[1:-1]  # between the ends, where there is nothing to see
planes = [fruitninja.Plane.of(solid.up, -height) for height in heights]
np.save(sys.argv[2], np.stack([solid.section(plane, size=128) for plane in planes]))
