"""Seeing inside captured 3D objects: Gaussians, atoms, cuts, filling and the renderers."""

from engine import compiler as compiler  # before anything is compiled
