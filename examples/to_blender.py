"""Exports the two halves of a solid as closed meshes with textured cut faces, for Blender and game engines.

python examples/to_blender.py SOLID.ply halves.glb     (needs pip install 'fruitninja[export]')
"""

import sys

import fruitninja

solid = fruitninja.open(sys.argv[1])
half = solid.cut(fruitninja.Plane.through(solid.bounds.mean(0), solid.up))
print(half.export(sys.argv[2], "mesh", pieces=True, metres=0.1))
