"""Loaded by each worker of the batch tests: makes runs of a second or two, with a checkpoint at every iteration."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np

from training import settings

SIZES = {
    "cells": 16, "fine": 20, "voxels": 24, "label": 48, "surface": 48, "surface_views": 4, "iterations": 2,
    "skin_views": 6, "skin_steps": 2, "skin_size": 48,
}  # fmt: skip
SHORT = replace(settings.DETAILS["draft"], **SIZES)
DETAILS = {"draft": SHORT, "standard": SHORT}

SMALL = {
    "training.request.DETAILS": DETAILS,
    "training.results.DETAILS": DETAILS,
    "engine.isolate.bodies.CELLS": 48,
    "engine.solid.solidify.BODY_CELLS": 32,
    "training.priors.exemplar.pictures.MAX_SIDE": 192,
    "training.results.HELD_OUT_VIEWS": 1,
    "training.contact_sheet.TILE": 48,
    "training.optimise.training_loop.CHECKPOINT_SECONDS": 0.0,
    "training.skin.CHECKPOINT_SECONDS": 0.0,
    "training.optimise.training_loop.MIN_IMPROVEMENT": -np.inf,  # all iterations, however soon the loss settles
}


def dask_setup(_: object) -> None:
    for name, value in SMALL.items():
        module, _, constant = name.rpartition(".")
        setattr(import_module(module), constant, value)
