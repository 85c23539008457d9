"""Seeing inside captured 3D objects: Gaussians, atoms, cuts, filling and the renderers."""

from engine.kernel_cache import forgive

forgive()
