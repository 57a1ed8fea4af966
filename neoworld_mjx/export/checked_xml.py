"""Checks the XML of untrusted files before a library parses it.

Readers call these functions in a limited worker (`io.limited_worker`), which bounds the memory and
the time that files with many or repeated elements take.
"""

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from math import isfinite
from pathlib import Path

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes
from ..io.json_files import MAX_DEPTH

DECLARED = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)
_NAMES = ("name", "file", "filename", "class", "childclass", "mesh", "material", "texture", "joint")
"""Attributes whose values are names, which may look like numbers."""


def read_xml(path: Path) -> ET.Element:
    """Read an XML file that may be hostile or broken.

    Raises:
        SpecError: the file cannot be read, is truncated, declares entities, is nested too deeply,
            or contains a number that is not finite.
    """
    try:
        data = read_bytes(path, file_bounds().max_file_mib * MIB)
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None
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


def inside(path: Path, reference: str) -> Path:
    """Return the path of a file that an XML file refers to.

    Args:
        path: the XML file.
        reference: name or URI of the other file, as written in the XML file.

    Raises:
        SpecError: the other file is outside the XML file's folder, or does not exist.
    """
    folder = path.resolve().parent
    plain = re.sub(r"^(package|model|file)://", "", reference.strip())
    if plain != reference.strip() and reference.strip().startswith(("package://", "model://")):
        # The name of the package may, but need not, be the name of a folder.
        without_package = plain.split("/", 1)[-1]
        plain = plain if (folder / plain).exists() else without_package
    return inside_any(path, [plain], reference)


def inside_any(path: Path, candidates: Sequence[str], reference: str) -> Path:
    """Return the first existing file among the files that a name in an XML file may refer to.

    Args:
        path: the XML file.
        candidates: paths relative to the XML file's folder.
        reference: the name, for messages.

    Raises:
        SpecError: a candidate is outside the XML file's folder, or no candidate exists.
    """
    folder = path.resolve().parent
    # An absolute candidate replaces the folder, and is refused unless it is below the folder.
    targets = [Path(os.path.join(folder, candidate)).resolve() for candidate in candidates]
    if not all(target.is_relative_to(folder) for target in targets):
        raise SpecError(f"{path} names {reference!r}, which lies outside its folder {folder}")
    existing = [target for target in targets if target.is_file()]
    if not existing:
        raise SpecError(f"{path} names {reference!r}, which does not exist")
    return existing[0]
