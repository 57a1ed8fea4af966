"""Location of Blender's Python on this machine, and the commands that install it.

Blender comes as the package bpy. It requires NumPy 1 and one version of CPython, so it has its own
virtual environment in the cache folder.
"""

from pathlib import Path

from ...cache import cache_folder

BPY, PYTHON = "5.0.1", "3.11"
"""Latest bpy for its CPython."""
INSTALL = "neoworld doctor --install blender"
LIBRARIES = "libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1"
"""Debian packages with the libraries that bpy links to but does not contain."""


def blender_folder() -> Path:
    """Return the folder of Blender's environment; it need not exist."""
    return cache_folder() / f"bpy-{BPY}"


def blender_python() -> Path:
    """Return the Python that has bpy; it need not exist."""
    return blender_folder() / "bin" / "python"


def commands() -> list[list[str]]:
    """Return the commands that create the environment (360 MB download, 970 MB on disk)."""
    python = str(blender_python())
    return [
        ["uv", "venv", "--allow-existing", "--python", PYTHON, str(blender_folder())],
        ["uv", "pip", "install", "--python", python, f"bpy=={BPY}", "numpy<2"],
    ]
