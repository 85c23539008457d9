"""Where the nodes of a glTF file place its Gaussians."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.io.gltf_tree import GAUSSIANS, extensions, rows

__all__ = ["Placement", "placements"]

SKEW = 1e-3
"""How far a node's matrix may be from a rotation times one factor: exporters round."""

FACTORS = (1e-9, 1e9)
"""Least and greatest plausible scale factor."""


@dataclass(frozen=True)
class Placement:
    """One primitive of Gaussians at one node: x -> factor R x + shift."""

    primitive: dict[str, Any]
    rotation: NDArray[np.float64]
    """(3, 3)."""
    factor: float
    shift: NDArray[np.float64]
    """(3,)."""

    @property
    def linear(self) -> NDArray[np.float64]:
        """(3, 3). The rotation times the factor."""
        return self.factor * self.rotation


def placements(path: Path, tree: dict[str, Any]) -> list[Placement]:
    """The placements of all primitives of Gaussians in the default scene, or in all meshes if there are no nodes.

    Raises InputError if the nodes form a cycle, and for a node that mirrors or stretches.
    """
    meshes = [[p for p in rows(mesh, "primitives") if GAUSSIANS in extensions(p)] for mesh in rows(tree, "meshes")]
    found = []
    for name, mesh, matrix in _shown(path, tree):
        for primitive in meshes[mesh] if 0 <= mesh < len(meshes) else []:
            found.append(_placed(path, name, primitive, matrix))
    if not found and not rows(tree, "nodes"):
        found = [_placed(path, "", primitive, np.eye(4)) for mesh in meshes for primitive in mesh]
    return found


def _shown(path: Path, tree: dict[str, Any]) -> Iterator[tuple[str, int, NDArray[np.float64]]]:
    """The nodes with a mesh in the default scene: name, mesh index, and the matrix (4, 4) to the world."""
    nodes, scenes = rows(tree, "nodes"), rows(tree, "scenes")
    number = tree.get("scene", 0)
    scene = scenes[number] if isinstance(number, int) and 0 <= number < len(scenes) else {}
    roots = scene.get("nodes")
    if not isinstance(roots, list):
        children = {child for node in nodes for child in _list(node.get("children"))}
        roots = [index for index in range(len(nodes)) if index not in children]
    waiting = [(index, np.eye(4)) for index in reversed(_list(roots))]
    seen: set[int] = set()
    while waiting:
        index, above = waiting.pop()
        if not 0 <= index < len(nodes) or index in seen:
            raise InputError(f"{path}: damaged: its nodes are no tree; export it again")
        seen.add(index)
        node = nodes[index]
        with np.errstate(all="ignore"):
            matrix = above @ _local(path, node)
        if isinstance(node.get("mesh"), int):
            yield str(node.get("name", index)), node["mesh"], matrix
        waiting += [(child, matrix) for child in reversed(_list(node.get("children")))]


def _list(value: Any) -> list[int]:
    """The whole numbers in a list."""
    return [item for item in value if type(item) is int] if isinstance(value, list) else []


def _local(path: Path, node: dict[str, Any]) -> NDArray[np.float64]:
    """(4, 4). A node's own matrix."""
    try:
        if "matrix" in node:
            return np.array(node["matrix"], np.float64).reshape(4, 4).T
        turn, factor, shift = (
            np.array(node.get(key, default), np.float64)
            for key, default in (("rotation", (0, 0, 0, 1)), ("scale", (1, 1, 1)), ("translation", (0, 0, 0)))
        )
        result = np.eye(4)
        result[:3, :3] = Rotation.from_quat(turn).as_matrix() * factor.reshape(3)
        result[:3, 3] = shift.reshape(3)
        return result
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: damaged: a node has no transform that makes sense; export it again") from error


def _placed(path: Path, name: str, primitive: dict[str, Any], matrix: NDArray[np.float64]) -> Placement:
    """A primitive placed by a matrix. Raises InputError unless that is a rotation, one factor and a shift."""
    with np.errstate(all="ignore"):
        determinant = float(np.linalg.det(matrix[:3, :3])) if np.isfinite(matrix).all() else float("nan")
        factor = np.cbrt(determinant)
        good = FACTORS[0] <= factor <= FACTORS[1]  # false for NaN
        rotation = matrix[:3, :3] / factor
        good = good and np.abs(rotation @ rotation.T - np.eye(3)).max() < SKEW
    if not good:
        raise InputError(
            f"{path}: its node {name[:40]!r} mirrors or stretches its Gaussians; apply its scale where it was exported"
        )
    left, _, right = np.linalg.svd(rotation)
    return Placement(primitive, left @ right, float(factor), matrix[:3, 3])
