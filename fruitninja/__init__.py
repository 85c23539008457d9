"""Gives captures an inside, cuts them open, and hands out the results as arrays.

    import fruitninja

    solid = fruitninja.grow("melon.ply", horizontal="across.png", radial="along.png", up="z")
    half = solid.cut((0, 0, 1, 0))  # keeps what is below z = 0
    picture = half.render(size=(640, 480))  # (480, 640, 3) bytes
    face = solid.section((0, 0, 1, 0))  # (512, 512, 4) bytes
    solid.save("solid.ply")

`load` reads a capture, `grow` and `Capture.solidify` make a solid of it, `open` reads a saved solid. Lengths are in
units of the file, colours are sRGB as in the capture. Unusable input raises `Error`, whose message is one line that
says what is wrong and what to do.
"""

from __future__ import annotations

from engine.errors import InputError as Error
from engine.isolate.selection import Below, Box, Sphere
from engine.scene.camera import Camera
from engine.scene.plane import Plane
from fruitninja.capture import Capture, load
from fruitninja.growing import grow
from fruitninja.solid import Solid
from fruitninja.solid import open_solid as open

__all__ = ["Below", "Box", "Camera", "Capture", "Error", "Plane", "Solid", "Sphere", "grow", "load", "open"]
