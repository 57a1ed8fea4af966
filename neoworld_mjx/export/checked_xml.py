"""XML of files from elsewhere, looked through before any library gets it."""

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from math import inf
from pathlib import Path

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes

MAX_ELEMENTS = 200_000
_DECLARED = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)
_WORDS = ("name", "file", "filename", "class", "childclass", "mesh", "material", "texture", "joint")
_NONE = re.compile(r"^[+-]?(nan|inf|infinity|1\.?#.*)$", re.IGNORECASE)
MOST = {
    **{"count": 1000, "width": 16384, "height": 16384, "nrow": 4096, "ncol": 4096},
    **{"dim": 1000, "nuserdata": 10_000, "nkey": 10_000},
    **{
        f"nuser_{kind}": 1000
        for kind in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
    },
}
"""Largest values of attributes by which one number could make a reader allocate much memory."""
MAX_OF = {"link": 400, "body": 1000, "geom": 10_000, "joint": 2000, "mesh": 2000, "include": 100}
"""Most elements of a kind: far above what an object needs, and below what takes minutes."""


def read_xml(path: Path) -> ET.Element:
    """Read an XML file that may be hostile or broken.

    Raises:
        SpecError: it cannot be read, is cut off, declares entities, is nested absurdly deep, or
            holds a number that is none.
    """
    bounds = file_bounds()
    try:
        data = read_bytes(path, bounds.max_text_mib * MIB)
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None
    for text in (data, data[:4096].replace(b"\0", b"")):  # UTF-16 hides it behind zeros.
        if _DECLARED.search(text):
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
                    raise SpecError(f"{path} holds more than {MAX_ELEMENTS} elements")
        parser.close()
    except (ET.ParseError, ValueError, LookupError) as error:
        raise SpecError(f"{path} is not whole XML: {error}") from None
    if root is None:
        raise SpecError(f"{path} is empty")
    counts = _repeated(root)
    if counts.total() > MAX_ELEMENTS:
        raise SpecError(f"{path} repeats to more than {MAX_ELEMENTS} elements")
    for tag, most in MAX_OF.items():
        if counts[tag] > most:
            raise SpecError(f"{path} holds more than {most} elements <{tag}>, which are not read")
    for element in root.iter():
        for key, value in element.attrib.items():
            if key in _WORDS:
                continue
            what = f"{path}: {element.tag} {element.get('name') or element.tag!r}: {key}={value!r}"
            if any(_NONE.match(word) or abs(_number(word)) == inf for word in value.split()):
                raise SpecError(f"{what} is no number")
            if any(abs(_number(word)) > MOST.get(key, inf) for word in value.split()):
                raise SpecError(f"{what}: at most {MOST[key]} are read")
    return root


def _number(word: str) -> float:
    """Return a word's value; 0 for one that is no number."""
    try:
        return float(word)
    except ValueError:
        return 0.0


def _repeated(root: ET.Element) -> Counter[str]:
    """Return how many elements of each tag there are once all are repeated as often as they say."""
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
    # Only starts and ends were asked for.
    yield from parser.read_events()  # pyright: ignore[reportReturnType]


def inside(path: Path, named: str, below: str = "") -> Path:
    """Return the file that `named` means in the XML file `path`, below a folder of its own.

    Raises:
        SpecError: it lies outside the file's folder, or is not there.
    """
    home = path.resolve().parent
    plain = re.sub(r"^(package|model|file)://", "", named.strip())
    if plain != named.strip() and named.strip().startswith(("package://", "model://")):
        # The package's name is no folder here, unless it is.
        rest = plain.split("/", 1)[-1]
        plain = plain if (home / plain).exists() else rest
    target = (home / below / plain).resolve()
    if not target.is_relative_to(home):
        raise SpecError(f"{path} names {named!r}, which lies outside its folder {home}")
    if not target.is_file():
        raise SpecError(f"{path} names {named!r}, and there is no such file")
    return target
