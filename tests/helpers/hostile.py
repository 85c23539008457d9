"""A folder as a stranger's archive might leave it: a mark shows what was imported from it or read its settings."""

from __future__ import annotations

from pathlib import Path

__all__ = ["hostile_folder", "marks"]

MODULES = (
    *("app", "engine", "fruitninja", "sample_scenes", "shaders", "training"),
    *("dask", "distributed", "glfw", "imgui_bundle", "numba", "numpy", "safetensors", "torch", "yaml"),
    *("asyncio", "ctypes", "encodings", "json", "multiprocessing", "runpy", "struct", "threading"),
    *("sitecustomize", "usercustomize"),
)


def hostile_folder(folder: Path) -> Path:
    """Creates modules and packages that the program and its libraries import, and settings files of theirs."""
    code = f"open({str(folder)!r} + '/MARK-' + __name__, 'w').close()\nraise ImportError('this is not ' + __name__)\n"
    folder.mkdir()
    for name in MODULES:
        (folder / f"{name}.py").write_text(code)
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(code)
    (folder / ".numba_config.yaml").write_text(f"cache_dir: {folder}/MARK-cache\n")
    (folder / "hello_imgui.ini").write_text("[Window][Object]\nPos=0,0\n")
    return folder


def marks(folder: Path) -> list[str]:
    """What was run or used."""
    return sorted(path.name for path in folder.glob("MARK-*"))
