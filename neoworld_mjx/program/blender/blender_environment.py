"""Where Blender's Python is on this machine, and the commands that bring it there.

Blender comes as the package bpy. It needs NumPy 1 and a CPython of its own version, so it lives in
a virtual environment beside this one, in the folder of the cache.
"""

from pathlib import Path

from ...cache import cache_folder

BPY, PYTHON = "5.0.1", "3.11"
"""The last bpy for that CPython."""
INSTALL = "neoworld doctor --install blender"
LIBRARIES = "libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1"
"""Debian packages with the libraries that bpy links to and does not bring."""


def blender_folder() -> Path:
    """Return the folder of Blender's environment; it need not exist."""
    return cache_folder() / f"bpy-{BPY}"


def blender_python() -> Path:
    """Return the Python that has bpy; it need not exist."""
    return blender_folder() / "bin" / "python"


def commands() -> list[list[str]]:
    """Return the commands that make the environment: 360 MB to fetch, 970 MB on disk."""
    python = str(blender_python())
    return [
        ["uv", "venv", "--allow-existing", "--python", PYTHON, str(blender_folder())],
        ["uv", "pip", "install", "--python", python, f"bpy=={BPY}", "numpy<2"],
    ]
