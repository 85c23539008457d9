"""Samples colours along a line from the skin through the middle, as a table: depth, red, green, blue.

python examples/profile.py SOLID.ply profile.csv
"""

import sys

import numpy as np

import fruitninja

solid = fruitninja.open(sys.argv[1])
low, high = solid.bounds
middle, reach = (low + high) / 2, (high - low) / 2
aside = np.cross(solid.up, np.eye(3)[np.abs(solid.up).argmin()])
depth = np.linspace(0, 2, 200)[:, None] * np.abs(aside @ reach)
points = middle + aside * (np.abs(aside @ reach) - depth)
rows = np.concatenate([depth, solid.colours(points)], axis=1)
np.savetxt(sys.argv[2], rows, "%.4f", delimiter=",", header="depth,red,green,blue", comments="")
