"""Draws exported pieces in Blender, to prove that another program reads them; the last lines say what it found:

blender -b --python tools/blender.py -- PIECES.glb PICTURE.png
"""

from __future__ import annotations

import sys

import numpy as np

# Blender 3.4 of Debian 12 imports glTF with names that NumPy 1.24 no longer has.
for name, kind in (("bool", bool), ("object", object)):
    setattr(np, name, kind)

import bpy  # type: ignore[import-not-found]  # noqa: E402
from mathutils import Vector  # type: ignore[import-not-found]  # noqa: E402

GAP = 1.1
"""Distance from piece to piece, in widths of the whole."""


def main() -> None:
    """Imports the pieces, lays them side by side and draws them with Cycles on the CPU."""
    source, picture = sys.argv[sys.argv.index("--") + 1 :]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=source)
    scene = bpy.context.scene
    pieces = sorted((thing for thing in scene.objects if thing.type == "MESH"), key=lambda thing: thing.name)
    corners = np.array([piece.matrix_world @ Vector(corner) for piece in pieces for corner in piece.bound_box])
    low, high = corners.min(0), corners.max(0)
    for n, piece in enumerate(pieces):
        piece.location.x += (n - (len(pieces) - 1) / 2) * GAP * (high - low)[0]
        print(piece.name, "metres:", np.round(piece.dimensions, 3), "vertices:", len(piece.data.vertices))
    middle, size = Vector((low + high) / 2), float(np.linalg.norm(high - low))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = middle + Vector((0.15, -1.0, 0.8)) * size
    camera.rotation_euler = (middle - camera.location).to_track_quat("-Z", "Y").to_euler()
    camera.data.lens = 32
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 2.5, (0.6, 0.3, 0.2)
    for thing in (camera, sun):
        scene.collection.objects.link(thing)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    sky = scene.world.node_tree.nodes["Background"]
    sky.inputs[0].default_value, sky.inputs[1].default_value = (0.8, 0.82, 0.85, 1), 0.7
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 32, False
    scene.render.resolution_x, scene.render.resolution_y = 960, 540
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = picture
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
