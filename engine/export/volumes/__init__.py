"""Volumes of colours and kinds.

Needs the packages of the `export` extra; importing this without them raises InputError.
"""

from __future__ import annotations

from engine.errors import InputError

try:
    import nibabel  # noqa: F401
    import nrrd  # noqa: F401
    import zarr  # noqa: F401
except ImportError as error:
    raise InputError(f"volumes need more packages ({error.name} is missing); pip install fruitninja[export]") from error
