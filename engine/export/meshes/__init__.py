"""Closed meshes with textured cut faces.

Needs the packages of the `export` extra; importing this without them raises InputError.
"""

from __future__ import annotations

from engine.errors import InputError

try:
    import lib3mf  # noqa: F401
    import manifold3d  # noqa: F401
    import xatlas  # noqa: F401
except ImportError as error:
    raise InputError(f"meshes need more packages ({error.name} is missing); pip install fruitninja[export]") from error
