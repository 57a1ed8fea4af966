"""Location of the Python interpreter with Blender, and the commands that install it.

Blender is distributed as the package bpy. The package requires NumPy 1 and one version of CPython,
so it is installed into a separate virtual environment in the cache folder.
"""

from pathlib import Path

from ...cache import cache_folder

BPY, PYTHON = "5.0.1", "3.11"
"""Versions of bpy and of CPython; this bpy is the latest for this CPython."""
INSTALL = "neoworld doctor --install blender"
LIBRARIES = "libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1"
"""Debian packages with libraries that bpy is linked to but does not contain."""


def blender_folder() -> Path:
    """Return the folder of Blender's virtual environment; the folder may not exist."""
    return cache_folder() / f"bpy-{BPY}"


def blender_python() -> Path:
    """Return the path of the Python interpreter that has bpy; the file may not exist."""
    return blender_folder() / "bin" / "python"


def commands() -> list[list[str]]:
    """Return the commands that create the environment: a download of 360 MB, 970 MB on disk."""
    python = str(blender_python())
    return [
        ["uv", "venv", "--allow-existing", "--python", PYTHON, str(blender_folder())],
        ["uv", "pip", "install", "--python", python, f"bpy=={BPY}", "numpy<2"],
    ]
