"""Checks the XML of untrusted files before a library parses it."""

import os
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator, Sequence
from math import inf
from pathlib import Path

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes

MAX_ELEMENTS = 200_000
DECLARED = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)
_WORDS = ("name", "file", "filename", "class", "childclass", "mesh", "material", "texture", "joint")
_NOT_FINITE = re.compile(r"^[+-]?(nan|inf|infinity|1\.?#.*)$", re.IGNORECASE)
MAX_VALUES = {
    **{"count": 1000, "width": 16384, "height": 16384, "nrow": 4096, "ncol": 4096},
    **{"dim": 1000, "nuserdata": 10_000, "nkey": 10_000},
    **{
        f"nuser_{kind}": 1000
        for kind in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
    },
}
"""Maximum values of the attributes that determine how much memory a reader allocates."""
MAX_COUNTS = {
    "link": 400,
    "body": 1000,
    "geom": 10_000,
    "joint": 2000,
    "mesh": 2000,
    "include": 100,
    "site": 2000,
    **dict.fromkeys(("visual", "collision", "inertial"), 10_000),
    "origin": 25_000,
    **dict.fromkeys(("spatial", "fixed", "motor", "position", "velocity"), 1000),
}
"""Maximum number of elements by tag. Objects need far fewer, and more can take minutes to read."""


def read_xml(path: Path) -> ET.Element:
    """Read an XML file that may be hostile or broken.

    Raises:
        SpecError: the file cannot be read, is truncated, declares entities, is nested too deeply,
            has too many elements, or contains a number that is not finite or is too large.
    """
    bounds = file_bounds()
    try:
        data = read_bytes(path, bounds.max_text_mib * MIB)
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None
    for text in (data, data[:4096].replace(b"\0", b"")):  # UTF-16 has a zero byte per letter.
        if DECLARED.search(text):
            raise SpecError(f"{path} declares a document type or entities, which are not read")
    parser, depth, count = ET.XMLPullParser(("start", "end")), 0, 0
    root: ET.Element | None = None
    try:
        for first in range(0, len(data), 1 << 16):
            parser.feed(data[first : first + (1 << 16)])
            for event, element in _elements(parser):
                depth += 1 if event == "start" else -1
                count += event == "start"
                root = element if root is None else root
                if depth > bounds.max_depth:
                    raise SpecError(f"{path} is nested more than {bounds.max_depth} elements deep")
                if count > MAX_ELEMENTS:
                    raise SpecError(f"{path} has more than {MAX_ELEMENTS} elements")
        parser.close()
    except (ET.ParseError, ValueError, LookupError) as error:
        raise SpecError(f"{path} is not valid XML: {error}") from None
    if root is None:
        raise SpecError(f"{path} is empty")
    counts = _repeated(root)
    if counts.total() > MAX_ELEMENTS:
        raise SpecError(f"{path} expands to more than {MAX_ELEMENTS} elements")
    for tag, limit in MAX_COUNTS.items():
        if counts[tag] > limit:
            raise SpecError(f"{path} has more than {limit} elements <{tag}>")
    for element in root.iter():
        for key, value in element.attrib.items():
            if key in _WORDS:
                continue
            label = element.get("name") or element.tag
            message = f"{path}: {element.tag} {label!r}: {key}={value!r}"
            if any(_NOT_FINITE.match(word) or abs(_number(word)) == inf for word in value.split()):
                raise SpecError(f"{message} is not a finite number")
            if any(abs(_number(word)) > MAX_VALUES.get(key, inf) for word in value.split()):
                raise SpecError(f"{message}: the limit is {MAX_VALUES[key]}")
    return root


def _number(word: str) -> float:
    """Return the value of a word, or 0 if the word is not a number."""
    try:
        return float(word)
    except ValueError:
        return 0.0


def _repeated(root: ET.Element) -> Counter[str]:
    """Return the number of elements by tag after every <replicate> is expanded."""
    counts: Counter[str] = Counter()
    waiting = [(root, 1.0)]
    while waiting:
        element, times = waiting.pop()
        if element.tag == "replicate":
            times *= max(_number(element.get("count") or "1"), 1.0)
        counts[element.tag] += min(int(times), MAX_ELEMENTS + 1)
        waiting += [(child, min(times, 1e9)) for child in element]
    return counts


def _elements(parser: ET.XMLPullParser) -> Iterator[tuple[str, ET.Element]]:
    # The parser reports only starts and ends.
    yield from parser.read_events()  # pyright: ignore[reportReturnType]


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
