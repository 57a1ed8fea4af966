"""Requests to multimodal models, their responses, and the protocols of models and providers.

A step of the pipeline passes a `Request` to a `Model` and receives a `Response`. The value of the
response is an instance of the request's pydantic schema, whether the response comes from a server,
from recorded responses (a tape) or from a person.

`Request.key` identifies the content of a request: role, system text, prompt, labels and decoded
pixels of the pictures, and JSON schema. It does not depend on the name, the model and the
compression of the pictures, so equal requests have the same key on every machine. `read_response`
finds and validates the JSON object in a model's text.
"""

import hashlib
import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from itertools import islice
from typing import Any, Generic, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from PIL import Image
from pydantic import BaseModel, ValidationError

from ..config import Role, RoleOptions
from ..errors import BudgetError, MissingResponseError, ModelError
from ..io.files import MIB
from ..io.text_files import validation_message

MAX_BODY_BYTES = 16 * MIB
"""Maximum size of a response or an error; a response has some 5 bytes per token."""
T = TypeVar("T", bound=BaseModel)
Fallback = tuple[str, str]
"""A skipped stage, and the reason."""

_MEDIA = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}


def digest(text: str | bytes) -> str:
    """Return the sha256 of a string (as UTF-8) or of bytes, as 64 hex digits."""
    data = text.encode() if isinstance(text, str) else text
    return hashlib.sha256(data).hexdigest()


@cache
def package_text(package: str, name: str) -> str:
    """Read the file NAME.md of a package, such as "critic" of "neoworld_mjx.parse"."""
    return resources.files(package).joinpath(f"{name}.md").read_text("utf-8")


class Picture:
    """A picture of a request, with the label by which the prompt refers to it.

    Args:
        label: the label.
        data: a PNG or JPEG file, or pixels (sRGB), uint8 of shape [height, width, 3], which are
            encoded as PNG on first use.

    Raises:
        ModelError: the file is neither PNG nor JPEG, or the array has another type or shape.
    """

    def __init__(self, label: str, data: bytes | np.ndarray) -> None:
        self.label = label
        if isinstance(data, bytes):
            if not any(data.startswith(magic) for magic in _MEDIA):
                raise ModelError(f"picture {label!r} must be PNG or JPEG bytes")
            self.data = data
            return
        if data.dtype != np.uint8 or data.ndim != 3 or data.shape[2] != 3:
            raise ModelError(
                f"picture {label!r} must be uint8 of shape [height, width, 3], "
                f"got {data.dtype} of shape {list(data.shape)}"
            )
        self.rgb = np.array(data)  # The caller may modify the array later.

    @cached_property
    def data(self) -> bytes:
        """The PNG or JPEG file."""
        buffer = io.BytesIO()
        Image.fromarray(self.rgb).save(buffer, "PNG", compress_level=6)
        return buffer.getvalue()

    @cached_property
    def rgb(self) -> np.ndarray:
        """Pixels (sRGB), uint8 of shape [height, width, 3].

        Raises:
            ModelError: the file cannot be decoded.
        """
        try:
            with Image.open(io.BytesIO(self.data), formats=["PNG", "JPEG"]) as image:
                return np.asarray(image.convert("RGB"))
        except (OSError, SyntaxError, ValueError) as error:
            raise ModelError(f"picture {self.label!r} cannot be decoded: {error}") from None

    @property
    def media_type(self) -> str:
        """MIME type: image/png or image/jpeg."""
        return next(kind for magic, kind in _MEDIA.items() if self.data.startswith(magic))

    @property
    def suffix(self) -> str:
        """File suffix: .png or .jpg."""
        return ".png" if self.media_type == "image/png" else ".jpg"

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.rgb.shape[1], self.rgb.shape[0]

    def bounded(self, max_bytes: int) -> tuple[str, bytes]:
        """Return MIME type and content of the file; a larger file becomes a JPEG."""
        if len(self.data) <= max_bytes:
            return self.media_type, self.data
        buffer = io.BytesIO()
        Image.fromarray(self.rgb).save(buffer, "JPEG", quality=90)
        return "image/jpeg", buffer.getvalue()

    @cached_property
    def pixels(self) -> str:
        """sha256 of the size and the decoded RGB bytes; it does not depend on the encoder."""
        width, height = self.size
        return digest(f"{width}x{height}:".encode() + self.rgb.tobytes())


@dataclass(frozen=True)
class Request(Generic[T]):
    """One request to a model.

    The content that several requests share comes first: the system text, and the photo as the first
    picture. A server with a prompt cache then processes this content only once.
    """

    role: Role
    name: str
    """Short name for messages, such as "parse" or "program:cup"; not part of the key."""
    system: str
    prompt: str
    schema: type[T]
    """The pydantic model that the response must validate against."""
    pictures: Sequence[Picture] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "pictures", tuple(self.pictures))

    @cached_property
    def json_schema(self) -> dict[str, Any]:
        """JSON schema of the response, with each definition named by the title of its model.

        Renaming a class does not change its requests if the title keeps the former name.
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

    @cached_property
    def schema_text(self) -> str:
        """The schema as short JSON without titles, which repeat the names of classes and fields."""
        return json.dumps(without_titles(self.json_schema), separators=(",", ":"), sort_keys=True)

    @cached_property
    def parts(self) -> dict[str, str]:
        """Digest of each part of the content, by which a message names the parts that differ."""
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
        """sha256 of role, system text, prompt, labels and pixels of the pictures, and schema."""
        return digest(json.dumps(self.parts, sort_keys=True))


@dataclass(frozen=True)
class Usage:
    """Tokens of one call as counted by the server; `input` excludes cached tokens."""

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
    """Complete text from the model, which contains the JSON of the value."""
    usage: Usage
    """Total tokens of all calls for this response, including calls with rejected responses."""
    model: str


@runtime_checkable
class Model(Protocol):
    """Protocol of a model that responds to requests. `Panel` implements it."""

    async def ask(self, request: Request[T]) -> Response[T]:
        """Return the response to a request.

        Raises:
            ModelError: there is no valid response; the message states the reason and a remedy.
        """
        ...


@dataclass(frozen=True)
class Rejection:
    """An invalid response and the reason of its rejection; both are sent back to the model."""

    text: str
    reason: str

    def message(self, request: Request[Any]) -> str:
        """Return the message to the model, which repeats the schema."""
        return (
            f"That response cannot be used: {self.reason}\n\n"
            f"Respond again, complete and corrected. {response_rule(request)}"
        )


@dataclass(frozen=True)
class Reply:
    """One reply of a provider, which is not validated yet."""

    text: str
    usage: Usage | None
    """Tokens of the call; None if the server does not count them."""
    model: str
    stop: Literal["end", "length", "refusal"] = "end"
    detail: str = ""
    """Message of the server about a refusal."""

    def __post_init__(self) -> None:
        # Unpaired surrogates cannot be encoded, so replace them.
        valid_text = self.text.encode("utf-8", "replace").decode()
        object.__setattr__(self, "text", valid_text)


@runtime_checkable
class Provider(Protocol):
    """Protocol of a source of responses: a tape, a mailbox or a server's API."""

    name: str
    online: bool
    """If True, calls cost money and may fail; the panel limits them, and sends invalid responses
    back."""
    secrets: tuple[str, ...]
    """Strings that must never appear in output."""

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Make one call.

        Raises:
            ModelError: there is no response; the message states a remedy.
        """
        ...

    async def close(self) -> None:
        """Close all connections."""
        ...


def response_rule(request: Request[Any]) -> str:
    """Return instructions with the JSON schema, for servers that do not enforce a schema."""
    rule = "Give one JSON object and nothing else; it must fit this JSON schema:"
    return f"{rule}\n{request.schema_text}"


def without_titles(schema: Any) -> Any:
    """Return a JSON schema without the titles of its objects and fields."""
    if isinstance(schema, list):
        return [without_titles(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: without_titles(value)
        for key, value in schema.items()
        if key != "title" or not isinstance(value, str)
    }


async def ask_or_record(
    models: Model, request: Request[T], stage: str, fallbacks: list[Fallback]
) -> T | None:
    """Return a model's response; if the model fails, add a fallback and return None.

    Args:
        models: the models.
        request: a request that the run can do without.
        stage: name of the stage that is skipped if the request fails.
        fallbacks: list to which the stage and the reason of a failure are appended.

    Raises:
        BudgetError: the cost cap is reached.
        MissingResponseError: the recorded responses (a tape) do not contain the response.
    """
    try:
        return (await models.ask(request)).value
    except (BudgetError, MissingResponseError):
        raise
    except ModelError as error:
        fallbacks.append((stage, str(error)))
        return None


_FENCE = re.compile(r"```[A-Za-z0-9_-]*[ \t]*\r?\n(.*?)```", re.DOTALL)
_OPENING = re.compile(r"\{(?=\s*[\"}])")
_REASON_CHARS = 2000
MAX_CHARS, MAX_BLOCKS = 1_000_000, 20
"""Maximum number of characters of a text, and maximum number of fenced blocks that are read."""


class InvalidResponse(Exception):
    """Raised if a text contains no JSON object that fits the schema; the message says why."""


def read_response(text: str, schema: type[T]) -> T:
    """Validate the JSON object in a model's text.

    The text may be bare JSON, JSON in fenced blocks, or JSON within prose. The whole text, the
    fenced blocks, and the text from the first to the last brace are tried in this order, and the
    first valid object is returned.

    Raises:
        InvalidResponse: no object is valid; the message describes the first problem.
    """
    if len(text) > MAX_CHARS:
        raise InvalidResponse(
            f"the response has {len(text)} characters, at most {MAX_CHARS} are read"
        )
    reason = ""
    for part in _candidates(text):
        try:
            value = _loads(part)
        except RecursionError:
            reason = reason or "the JSON is nested too deeply"
            continue
        except ValueError as error:
            reason = reason or f"no JSON object in it ({error}); it starts {text.strip()[:80]!r}"
            continue
        if not isinstance(value, dict):
            reason = f"a JSON object is needed, got {type(value).__name__}"
            continue
        try:
            # Only validation from JSON converts lists to tuples and strings to enums.
            return schema.model_validate_json(json.dumps(value))
        except ValidationError as error:
            reason = _shorten(validation_message(error, schema))
    raise InvalidResponse(reason if text.strip() else "the response is empty")


def is_json(text: str) -> bool:
    """Return True if a text is exactly one JSON value, and is therefore complete."""
    try:
        _loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _candidates(text: str) -> Iterator[str]:
    yield text
    yield from (match[1] for match in islice(_FENCE.finditer(text), MAX_BLOCKS))
    if opening := _OPENING.search(text):
        # A slice to the last brace never takes a nested object of a broken one for the response.
        yield text[opening.start() : text.rfind("}") + 1]


def _loads(text: str) -> Any:
    return json.loads(text, parse_constant=_reject_constant)


def _reject_constant(constant: str) -> Any:
    raise ValueError(f"{constant} is not JSON")


def _shorten(reason: str) -> str:
    return reason if len(reason) <= _REASON_CHARS else reason[:_REASON_CHARS] + " ..."
