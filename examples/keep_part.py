"""Takes one object out of a capture that shows more: a ball around the middle, as a solid that is grey inside.

python examples/keep_part.py CAPTURE part.ply
"""

import sys

import numpy as np

import fruitninja

capture = fruitninja.load(sys.argv[1])
middle = np.median(capture.means, axis=0)
radius = np.quantile(np.linalg.norm(capture.means - middle, axis=1), 0.98)
part = capture.solidify(detail="draft", keep=[fruitninja.Sphere(tuple(middle.tolist()), float(radius))])
print(part, f"with a volume of {part.volume:.4g}")
part.save(sys.argv[2])
