"""Prints the volumes of the pieces that cuts make.

python examples/volumes.py SOLID.ply
"""

import sys

import fruitninja

solid = fruitninja.open(sys.argv[1])
middle = solid.bounds.mean(0)
across = fruitninja.Plane.through(middle, solid.up)
askew = fruitninja.Plane.through(middle, (1, 0.2, 0.4))
for piece in solid.pieces(across, askew):
    print(f"{piece.volume:.4f} of {solid.volume:.4f}, from {piece.bounds[0]} to {piece.bounds[1]}")
