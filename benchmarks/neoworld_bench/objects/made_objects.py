"""Files of reconstructed objects, by name."""

from pathlib import Path

from neoworld_mjx.errors import SpecError

OBJECT_FILES = (
    "resized.json",
    "verified.json",
    "spec.json",
    "program.py",
    "object.urdf",
    "object.xml",
    "object.usda",
    "mobility.urdf",
)
"""Names of an object's file in its folder, by priority."""
SUFFIXES = (".py", ".urdf", ".xml", ".mjcf", ".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of an object's file without a folder."""


def object_files(folder: Path) -> dict[str, Path]:
    """Return the files of the objects of a folder by name: files, or folders of one object each.

    Raises:
        SpecError: there is no such folder, or it holds no object.
    """
    if not folder.is_dir():
        raise SpecError(f"there is no folder {folder}")
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        file = path
        if path.is_dir():
            file = next((path / name for name in OBJECT_FILES if (path / name).is_file()), None)
        if file is not None and (path.is_dir() or path.suffix.lower() in SUFFIXES):
            files[path.name if path.is_dir() else path.stem] = file
    if not files:
        raise SpecError(
            f"{folder} holds no object: expected are NAME{SUFFIXES[0]}, NAME{SUFFIXES[1]} and the "
            f"like, or NAME/ with one of {', '.join(OBJECT_FILES)}"
        )
    return files
