"""The files that a mesh refers to (textures, materials, buffers), from its folder only."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote

import trimesh

from engine.errors import InputError
from engine.io.files import read_file
from engine.io.picture_file import open_picture

__all__ = ["MeshFiles"]

MAX_BYTES = 1 << 30
"""Most bytes of a file beside a mesh: more than any texture, and a buffer of twenty million faces."""


class MeshFiles(trimesh.resolvers.FilePathResolver):
    """Reads files for trimesh and records what is wrong with them; trimesh reports little of it.

    Nothing outside the mesh's folder and its subfolders is read, whatever a name or a link says.
    """

    def __init__(self, source: Path, buffers: frozenset[str] = frozenset()) -> None:
        """`buffers` names the files that are not pictures, apart from materials (.mtl)."""
        super().__init__(str(source))
        self.source = source
        self.buffers = buffers
        self.missing: list[str] = []
        self.refused: list[InputError] = []
        self._held: dict[Path, bytes] = {}

    def get(self, name: str) -> bytes:
        """The content of a file, read only once."""
        path = self._resolved(name)
        try:
            if path not in self._held:
                data = read_file(path, MAX_BYTES)
                if name not in self.buffers and not name.lower().endswith(".mtl"):
                    with open_picture(data, f"{self.source}: its texture '{_short(name)}'"):
                        pass
                self._held[path] = data
        except InputError as error:
            self.refused.append(error)
            raise
        return self._held[path]

    def _resolved(self, name: str) -> Path:
        """The path of a file. If an exporter wrote another system's path, the file usually lies beside the mesh."""
        root = Path(self.parent).resolve()
        for candidate in (name, name.lstrip("/"), unquote(name), name.replace("\\", "/").rsplit("/", 1)[-1]):
            try:
                path = (root / candidate.strip()).resolve()
                if path.is_relative_to(root) and path.exists() and not path.is_dir():
                    return path
            except (OSError, ValueError, RuntimeError):  # too long, a null character, circular links
                continue
        self.missing.append(_short(name))
        raise FileNotFoundError(name)

    def check(self, warn: Callable[[str], None]) -> None:
        """Raises InputError if a file was refused or is missing; a missing material file only gives `warn` a line."""
        if self.refused:
            raise self.refused[0]
        for name in self.missing:
            if not name.lower().endswith(".mtl"):
                raise InputError(f"{self.source}: its file '{name}' is missing; put it into the same folder")
        for name in dict.fromkeys(self.missing):
            warn(f"{self.source}: its material file '{name}' is missing")


def _short(name: str) -> str:
    """A file's name as the mesh gives it, shortened to one line."""
    return " ".join(name.split())[:80]
