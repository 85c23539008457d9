"""Seeing inside captured 3D objects: Gaussians, atoms, cuts, filling and the renderers."""
