"""Requests to multimodal models, their responses, and the protocols of models and providers.

A step of the pipeline passes a `Request` to a `Model` and receives a `Response`, whose value is an
instance of the request's pydantic schema, no matter if a server, a tape or a person gave it.

`Request.key` identifies the content of a request: role, system text, prompt, labels and decoded
pixels of the pictures, and JSON schema. It excludes the name, the model and the compression of the
pictures, so equal requests have the same key on every machine.
"""

import hashlib
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import resources
from typing import Any, Generic, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from PIL import Image
from pydantic import BaseModel

from ..config import Role, RoleOptions
from ..errors import ModelError

T = TypeVar("T", bound=BaseModel)

_MEDIA = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}


def digest(text: str | bytes) -> str:
    """Return the sha256 of a text or bytes as 64 hex digits."""
    data = text.encode() if isinstance(text, str) else text
    return hashlib.sha256(data).hexdigest()


@cache
def package_text(package: str, name: str) -> str:
    """Read the instructions NAME.md of a package, such as ("neoworld_mjx.parse", "critic")."""
    return resources.files(package).joinpath(f"{name}.md").read_text("utf-8")


@dataclass(frozen=True)
class Picture:
    """One picture of a request, PNG or JPEG, with the label by which the prompt refers to it.

    Raises:
        ModelError: the data is neither PNG nor JPEG.
    """

    label: str
    data: bytes = field(repr=False)

    def __post_init__(self) -> None:
        if not any(self.data.startswith(magic) for magic in _MEDIA):
            raise ModelError(f"picture {self.label!r} must be PNG or JPEG bytes")

    @staticmethod
    def of(label: str, rgb: np.ndarray) -> "Picture":
        """Return a picture of an array of RGB bytes, uint8 of shape [height, width, 3].

        Raises:
            ModelError: the array has another type or shape.
        """
        return PixelPicture(label, rgb)

    @property
    def media_type(self) -> str:
        """MIME type, image/png or image/jpeg."""
        return next(kind for magic, kind in _MEDIA.items() if self.data.startswith(magic))

    @property
    def suffix(self) -> str:
        """File suffix of the data."""
        return ".png" if self.media_type == "image/png" else ".jpg"

    @cached_property
    def _decoded(self) -> tuple[tuple[int, int], str]:
        try:
            with Image.open(io.BytesIO(self.data), formats=["PNG", "JPEG"]) as image:
                rgb = image.convert("RGB")
        except (OSError, SyntaxError, ValueError) as error:
            raise ModelError(f"picture {self.label!r} cannot be decoded: {error}") from None
        return rgb.size, _pixel_digest(*rgb.size, rgb.tobytes())

    @property
    def rgb(self) -> np.ndarray:
        """Its pixels (sRGB), uint8 of shape [height, width, 3]."""
        with Image.open(io.BytesIO(self.data), formats=["PNG", "JPEG"]) as image:
            return np.asarray(image.convert("RGB"))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self._decoded[0]

    @property
    def pixels(self) -> str:
        """sha256 of size and decoded RGB bytes, which does not depend on the encoder."""
        return self._decoded[1]


class PixelPicture(Picture):
    """A picture stored as pixels, and encoded as PNG on first use.

    Raises:
        ModelError: the array is not uint8 of shape [height, width, 3].
    """

    _rgb: np.ndarray

    def __init__(self, label: str, rgb: np.ndarray) -> None:
        if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
            raise ModelError(
                f"picture {label!r} must be uint8 of shape [height, width, 3], "
                f"got {rgb.dtype} of shape {list(rgb.shape)}"
            )
        copy = np.array(rgb)  # The caller may modify the array later.
        for name, value in (("label", label), ("_rgb", copy)):
            object.__setattr__(self, name, value)  # The dataclass is frozen.

    @cached_property
    def data(self) -> bytes:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The PNG file, encoded once."""
        buffer = io.BytesIO()
        Image.fromarray(self._rgb).save(buffer, "PNG", compress_level=6)
        return buffer.getvalue()

    @cached_property
    def _decoded(self) -> tuple[tuple[int, int], str]:
        height, width = self._rgb.shape[:2]
        return (width, height), _pixel_digest(width, height, self._rgb.tobytes())


def _pixel_digest(width: int, height: int, rgb: bytes) -> str:
    return digest(f"{width}x{height}:".encode() + rgb)


@dataclass(frozen=True)
class Request(Generic[T]):
    """One request to a model.

    Content that requests share comes first: the system text, and the photo as the first picture. A
    server with a prompt cache then processes it only once.
    """

    role: Role
    name: str
    """Short name for people, such as "parse" or "program:cup"; not part of the key."""
    system: str
    prompt: str
    schema: type[T]
    """The pydantic model that the response must validate against."""
    pictures: Sequence[Picture] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "pictures", tuple(self.pictures))

    @cached_property
    def json_schema(self) -> dict[str, Any]:
        """JSON schema of the response, whose definitions are named by the titles of their models.

        A renamed class does not change the requests if its title is its former name.
        """
        schema = self.schema.model_json_schema()
        definitions = schema.get("$defs", {})
        titles = {name: body.get("title", name) for name, body in definitions.items()}
        if all(name == title for name, title in titles.items()):
            return schema
        if len(set(titles.values())) < len(titles):
            raise ModelError(f"{self.name}: two definitions of its schema have the same title")
        text = json.dumps(schema | {"$defs": {titles[k]: v for k, v in definitions.items()}})
        for name, title in titles.items():
            text = text.replace(f'"#/$defs/{name}"', f'"#/$defs/{title}"')
        return json.loads(text)

    def draw_pictures(self) -> None:
        """Encode the pictures that are not encoded yet; it may block an event loop for seconds."""
        for picture in self.pictures:
            _ = picture.data

    @cached_property
    def parts(self) -> dict[str, str]:
        """Digest of each part of the content, to report the parts in which requests differ."""
        pictures = [[picture.label, picture.pixels] for picture in self.pictures]
        return {
            "role": self.role,
            "system": digest(self.system),
            "prompt": digest(self.prompt),
            "pictures": digest(json.dumps(pictures)),
            "schema": digest(json.dumps(self.json_schema, sort_keys=True)),
        }

    @cached_property
    def key(self) -> str:
        """sha256 of role, system, prompt, pictures with labels, and JSON schema."""
        return digest(json.dumps(self.parts, sort_keys=True))


@dataclass(frozen=True)
class Usage:
    """Tokens of one call, as counted by the server; `input` excludes tokens read from the cache."""

    input: int = 0
    output: int = 0
    cache_read: int = 0
    cache_write: int = 0

    def __add__(self, other: "Usage") -> "Usage":
        return Usage(
            self.input + other.input,
            self.output + other.output,
            self.cache_read + other.cache_read,
            self.cache_write + other.cache_write,
        )


@dataclass(frozen=True)
class Response(Generic[T]):
    """A validated response."""

    value: T
    text: str
    """Complete text of the model, which contains the JSON of the value."""
    usage: Usage
    """Sum over all calls for this response, including rejected responses."""
    model: str


@runtime_checkable
class Model(Protocol):
    """Protocol of a model that responds to requests; `Panel` implements it."""

    async def ask(self, request: Request[T]) -> Response[T]:
        """Return the response to a request.

        Raises:
            ModelError: there is no valid response; the message states the reason and a remedy.
        """
        ...


@dataclass(frozen=True)
class Rejection:
    """An invalid response, and the reason, which are returned to the model."""

    text: str
    reason: str

    def message(self, request: Request[Any]) -> str:
        """Return the message to the model; it repeats the schema that the response violates."""
        return (
            f"That response cannot be used: {self.reason}\n\n"
            f"Respond again, complete and corrected. {response_rule(request)}"
        )


@dataclass(frozen=True)
class Reply:
    """One reply of a provider, not yet validated."""

    text: str
    usage: Usage
    model: str
    stop: Literal["end", "length", "refusal"] = "end"
    detail: str = ""
    """Message of the server about a refusal."""
    fallback: str | None = None
    """Features that the server does not support, such as structured output."""
    counted: bool = True
    """True if the server counted tokens."""

    def __post_init__(self) -> None:
        # Unpaired surrogates can neither be sent nor written to a file.
        valid_text = self.text.encode("utf-8", "replace").decode()
        object.__setattr__(self, "text", valid_text)


class Transient(Exception):
    """Failure of a call that a retry may resolve; `Calls` catches it.

    Args:
        message: the reason of the failure.
        retry_after: delay that the server requests [s]; None if it requests none.
        usage: tokens that the server counted before the call failed.
    """

    def __init__(
        self, message: str, retry_after: float | None = None, usage: Usage | None = None
    ) -> None:
        super().__init__(message)
        self.retry_after = retry_after
        self.usage = usage or Usage()


@runtime_checkable
class Provider(Protocol):
    """One source of responses: a tape, a mailbox, a server's API."""

    name: str
    online: bool
    """True if calls cost money and may fail; the panel limits, retries and corrects them."""
    secrets: tuple[str, ...]
    """Texts that must never appear in output."""

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Make one call; raise Transient if a retry may help, otherwise ModelError."""
        ...

    async def close(self) -> None:
        """Close all connections."""
        ...


def response_rule(request: Request[Any]) -> str:
    """Describe a valid response in words, for models whose server does not enforce a schema."""
    schema = json.dumps(request.json_schema, sort_keys=True)
    return f"Give one JSON object and nothing else; it must fit this JSON schema:\n{schema}"
