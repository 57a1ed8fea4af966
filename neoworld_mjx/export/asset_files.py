"""Finds and reads the untrusted files of an asset: its XML, and the files that it refers to.

An asset may refer to files below its root (`asset_root`), and below packages beside it. Readers
call these functions in a limited worker (`io.limited_worker`), which bounds the memory and the time
that a file takes.
"""

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from urllib.parse import unquote

from ..errors import SpecError
from ..io import read_untrusted_bytes
from ..io.text_files import MAX_DEPTH

DECLARED = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)
_NAMES = ("name", "file", "filename", "class", "childclass", "mesh", "material", "texture", "joint")
"""Attributes whose values are names, which may look like numbers."""
MANIFESTS = ("package.xml", "model.config", "manifest.xml")
"""Files in the root folder of a ROS package or a Gazebo model."""
INNER_FOLDERS = frozenset({"urdf", "xacro", "robots", "robot", "mjcf", "xml", "models", "sdf"})
"""Folders of descriptions, which lie beside the folder of meshes in packages."""
MAX_LEVELS = 3
"""Largest number of folders between a file and the root folder of its package."""


def read_xml(path: Path) -> ET.Element:
    """Read an XML file that may be hostile or broken.

    Raises:
        SpecError: the file cannot be read, is truncated, declares entities, is nested too deeply,
            or contains a number that is not finite.
    """
    data = read_untrusted_bytes(path, SpecError)
    refuse_entities(path, data)
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise SpecError(f"{path} is not valid XML: {error}") from None
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise SpecError(f"{path} is nested more than {MAX_DEPTH} elements deep")
    for element in root.iter():
        for key, value in element.attrib.items():
            if key not in _NAMES and not all(map(_is_finite, value.split())):
                label = element.get("name") or element.tag
                raise SpecError(
                    f"{path}: {element.tag} {label!r}: {key}={value!r} is not a finite number"
                )
    return root


def refuse_entities(path: Path, data: bytes) -> None:
    """Raise a SpecError if an XML file declares a document type or entities, which may expand."""
    for text in (data, data[:4096].replace(b"\0", b"")):  # UTF-16 has a zero byte per letter.
        if DECLARED.search(text):
            raise SpecError(f"{path} declares a document type or entities, which are not read")


def _is_finite(word: str) -> bool:
    """Return False if a word is a number that is infinite or NaN."""
    try:
        return isfinite(float(word))
    except ValueError:
        return True


def asset_root(path: Path) -> Path:
    """Return the folder below which an asset may refer to files.

    It is the nearest folder above the file with a manifest of a package; otherwise the parent of
    the file's folder, if that has a usual name for descriptions beside meshes, such as urdf/;
    otherwise the file's folder.
    """
    folder = path.resolve().parent
    for above in (folder, *list(folder.parents)[:MAX_LEVELS]):
        if any((above / name).is_file() for name in MANIFESTS):
            return above
    return folder.parent if folder.name.lower() in INNER_FOLDERS else folder


def inside(path: Path, reference: str) -> Path:
    """Return the path of a file that an asset refers to.

    Args:
        path: the file of the asset.
        reference: name or URI of the other file, as written in the asset.

    Raises:
        SpecError: the other file is outside the asset's folders, or does not exist.
    """
    text = reference.strip()
    scheme, separator, rest = text.partition("://")
    if not separator or scheme not in ("package", "model", "file"):
        return inside_any(path, [text], reference)
    if scheme == "file":
        return inside_any(path, [rest], reference)
    name, _, within = rest.partition("/")
    root = asset_root(path)
    neighbor = root.parent / name
    # A workspace keeps its packages beside each other.
    beside = name not in ("", "..") and (neighbor / MANIFESTS[0]).is_file()
    if beside:
        return inside_any(path, [str(neighbor / within)], reference, [neighbor])
    # The name of the package may, but need not, be the name of a folder.
    candidates = [rest, str(root / rest), within, str(root / within)]
    try:
        return inside_any(path, candidates, reference)
    except SpecError as error:
        raise SpecError(
            f"{error}; copy the package {name}, with its package.xml, beside {root}"
        ) from None


def inside_any(
    path: Path, candidates: Sequence[str], reference: str, folders: Sequence[Path] = ()
) -> Path:
    r"""Return the first existing file among the files that a name in an asset may refer to.

    A name that does not exist is tried with slashes for backslashes, and with %20 and the like
    decoded.

    Args:
        path: the file of the asset.
        candidates: paths relative to the asset's folder.
        reference: the name, for messages.
        folders: further folders below which files may be.

    Raises:
        SpecError: a candidate is outside the asset's folders, or no candidate exists.
    """
    folder, root = path.resolve().parent, asset_root(path)
    spellings = [
        spelling
        for name in candidates
        for spelling in dict.fromkeys(
            (name, name.replace("\\", "/"), unquote(name.replace("\\", "/")))
        )
    ]
    # An absolute candidate replaces the folder, and is refused unless it is below a root.
    targets = [Path(os.path.join(folder, spelling)).resolve() for spelling in spellings]
    roots = [root, *(Path(given).resolve() for given in folders)]
    if not all(any(target.is_relative_to(r) for r in roots) for target in targets):
        raise SpecError(f"{path} names {reference!r}, which lies outside its folder {root}")
    existing = [target for target in targets if target.is_file()]
    if not existing:
        raise SpecError(f"{path} names {reference!r}, which does not exist")
    return existing[0]
