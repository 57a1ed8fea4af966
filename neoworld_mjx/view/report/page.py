"""Parts of the report: HTML from Jinja templates that escape all text, pictures, and formats."""

import base64
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from PIL import Image

from ...errors import RunError
from ...io import file_bounds, open_image, read_object
from ...io.files import MIB, read_bytes
from ...io.names import printable


def _visible(value: object) -> object:
    """Escape hidden characters of text, which could change how other text reads."""
    return printable(value) if type(value) is str else value


_ENVIRONMENT = Environment(
    loader=PackageLoader("neoworld_mjx.view.report", "html"),
    autoescape=True,
    finalize=_visible,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
elements: Any = _ENVIRONMENT.get_template("elements.html").module
"""The macros of html/elements.html; each returns markup."""
_MAX_PX = 1280
_SMALL_BYTES = 300_000
"""Largest PNG file that is embedded unchanged [bytes]."""


def document(title: str, body: Iterable[Markup], scripts: Iterable[str] = ()) -> str:
    """Return a self-contained page.

    The page's content security policy forbids network access and all scripts except `scripts`.

    Args:
        title: title of the page.
        body: sections of the page.
        scripts: hashes of the allowed scripts, in the form of a content security policy.
    """
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    allowed = " ".join(scripts)
    policy += f"; script-src {allowed}" if allowed else ""
    page = _ENVIRONMENT.get_template("page.html")
    return page.render(title=title, body=body, policy=Markup(policy))


def read_json(path: Path) -> dict[str, Any] | None:
    """Read a JSON object; return None if it is missing or damaged."""
    try:
        return read_object(path, RunError) if path.is_file() else None
    except RunError:
        return None


def size_cm(size: Sequence[float]) -> str:
    """Format the edge lengths of a box in cm, without the unit."""
    return " × ".join(f"{100 * edge:.1f}" for edge in size)


def support_of(entry: dict[str, Any]) -> str:
    """Format the relation to the support of a tree node or scene object, such as "on table"."""
    return f"{entry.get('relation', 'on')} {entry['parent']}" if entry.get("parent") else "world"


def picture(path: Path, caption: str) -> Markup:
    """Embed a picture file, reduced if it is large; embed a note if it is missing or damaged."""
    if not path.is_file():
        return elements.missing_figure("not there yet", caption)
    try:
        with _open(path) as (raw, image):
            if image.format == "PNG" and len(raw) <= _SMALL_BYTES:
                return elements.figure(_data_uri(raw, "png"), caption)
            image.thumbnail((_MAX_PX, _MAX_PX), Image.Resampling.LANCZOS)
            return _figure(image.convert("RGB"), caption, quality=88)
    except (OSError, RunError):
        return elements.missing_figure(f"{path.name} cannot be read", caption)


def cropped_picture(path: Path, window: tuple[float, float, float, float], caption: str) -> Markup:
    """Embed a crop of a picture file; return empty markup if the file is missing or damaged.

    Args:
        path: the picture file.
        window: left, top, right and bottom, as fractions of the picture.
        caption: caption of the crop.
    """
    try:
        with _open(path) as (_, image):
            x0, y0, x1, y1 = (
                round(min(max(fraction, 0.0), 1.0) * size)
                for fraction, size in zip(window, (*image.size, *image.size), strict=True)
            )
            crop = image.convert("RGB").crop((x0, y0, max(x1, x0 + 1), max(y1, y0 + 1)))
    except (OSError, RunError):
        return Markup()
    crop.thumbnail((300, 150), Image.Resampling.LANCZOS)
    return _figure(crop, caption)


@contextmanager
def _open(path: Path) -> Iterator[tuple[bytes, Image.Image]]:
    raw = read_bytes(path, file_bounds().max_file_mib * MIB)
    with open_image(raw, path.name, RunError) as image:
        image.load()
        yield raw, image


def _figure(image: Image.Image, caption: str, quality: int = 85) -> Markup:
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=quality)
    return elements.figure(_data_uri(buffer.getvalue(), "jpeg"), caption)


def _data_uri(raw: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(raw).decode('ascii')}"
