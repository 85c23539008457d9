"""Lengths in which files of other programs are written."""

from __future__ import annotations

__all__ = ["INCH", "MILLIMETRES"]

MILLIMETRES = 1000.0
"""Millimetres in a metre: the unit of printers' slicers and of medical volumes."""

INCH = 0.0254
"""Metres."""
