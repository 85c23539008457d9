"""Solids for other programs: closed meshes with textured cut faces, volumes, particles."""
