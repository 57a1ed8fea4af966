"""Tapes: recorded responses in one JSON file, keyed by the content of their requests.

    {"format": 1, "photo": sha256 of the photo's file, "made": origin of the responses,
     "date": date of the responses,
     "answers": {key: {"role", "name", "model", "parts", "answer"}, ...}}

Keys depend on the decoded pixels of the pictures. A tape therefore remains valid with another PNG
encoder, but not with a renderer that changes a pixel. The order of the requests does not matter.
Entries are sorted, so recording the same responses gives the same bytes.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from ..config import RoleOptions
from ..errors import MissingResponseError, ModelError, open_files_exhausted
from ..io import read_model
from ..io.files import write_atomic
from .requests import Rejection, Reply, Request, Usage

SUFFIX = ".tape.json"


class Entry(BaseModel):
    """One response on a tape."""

    model_config = ConfigDict(extra="forbid")

    role: str
    name: str
    model: str = ""
    """Model that gave the response."""
    parts: dict[str, str] = {}
    """Digests of the request's parts, so that an error message can name the parts that differ."""
    answer: dict[str, Any] | str
    """The response as a JSON object, or its raw text if it is not a JSON object."""

    @property
    def text(self) -> str:
        """The response as text."""
        return self.answer if isinstance(self.answer, str) else json.dumps(self.answer)


class Tape(BaseModel):
    """Recorded responses (a tape) in memory."""

    model_config = ConfigDict(extra="forbid")

    format: int = Field(1, ge=1, le=1)
    photo: str | None = None
    """sha256 of the photo's file."""
    made: str = ""
    """Origin of the responses, in words."""
    date: str = ""
    """Date of the responses; empty if unknown."""
    answers: dict[str, Entry] = {}

    @property
    def prompts(self) -> str:
        """Version of the prompts: digest of the system texts and schemas of all entries."""
        entries = self.answers.values()
        parts = {entry.parts.get(part, "") for entry in entries for part in ("system", "schema")}
        return hashlib.sha256(" ".join(sorted(parts)).encode()).hexdigest()[:8]

    @classmethod
    def load(cls, path: Path) -> "Tape":
        """Read a tape.

        Raises:
            ModelError: the file cannot be read or is not a tape.
        """
        return read_model(path, cls, ModelError, "a tape")

    def save(self, path: Path) -> None:
        """Write the tape atomically.

        Raises:
            ModelError: the file cannot be written.
        """
        data = self.model_dump()
        if not self.date:
            del data["date"]
        order = sorted(self.answers, key=lambda key: (self.answers[key].name, key))
        data["answers"] = {key: data["answers"][key] for key in order}
        text = json.dumps(data, indent=1, ensure_ascii=False) + "\n"
        path = Path(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, text)
        except OSError as error:
            raise ModelError(f"cannot write tape {path}: {error.strerror}") from None

    def put(self, request: Request[Any], text: str, model: str) -> None:
        """Add a response under the request's key."""
        self.answers[request.key] = Entry(
            role=request.role,
            name=request.name,
            model=model,
            parts={part: value[:16] for part, value in request.parts.items()},
            answer=_object_or_text(text),
        )

    def get(self, request: Request[Any]) -> Entry | None:
        """Return the entry of a request; None if the tape has none."""
        return self.answers.get(request.key)

    def differences(self, request: Request[Any]) -> str:
        """Describe which parts of a request differ from the entry with the request's name."""
        named = [entry for entry in self.answers.values() if entry.name == request.name]
        if not named:
            names = sorted({entry.name for entry in self.answers.values()})
            return f"the tape contains: {', '.join(names) or 'nothing'}"
        differing = min((_differing(entry, request) for entry in named), key=len)
        return f"its entry {request.name!r} differs in: {', '.join(differing) or 'the key'}"


class Replay:
    """Provider of the responses on a tape."""

    name = "replay"
    online = False
    secrets: tuple[str, ...] = ()

    def __init__(self, tape: Tape, path: Path | str) -> None:
        self._tape = tape
        self._path = path

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Return the recorded response.

        Raises:
            MissingResponseError: the tape does not contain the response.
        """
        del role, rejected
        entry = self._tape.get(request)
        if entry is None:
            raise MissingResponseError(
                f"tape {self._path} has no response for {request.name!r} (role {request.role}, "
                f"key {request.key[:16]}); {self._tape.differences(request)}. Record it again with "
                f"another provider, or undo the change"
            )
        return Reply(entry.text, Usage(), entry.model or "tape")

    async def close(self) -> None:
        """Do nothing, because a tape has no connections."""


def find_tape(photo_sha256: str | None, paths: Iterable[Path]) -> tuple[Tape, Path] | None:
    """Find the tape of a photo, and return the tape and its path; None if there is none.

    Args:
        photo_sha256: sha256 of the photo's file.
        paths: tapes, and folders in which each file that ends in .tape.json is a tape. A tape given
            by its path is returned for any photo, because its keys decide which requests it
            answers.

    Raises:
        ModelError: a tape given by its path cannot be read.
    """
    for given_path in map(Path, paths):
        if not given_path.is_dir():
            if given_path.exists() or given_path.name.endswith(SUFFIX):
                return Tape.load(given_path), given_path
            continue
        for path in sorted(given_path.glob(f"*{SUFFIX}")):
            try:
                tape = Tape.load(path)
            except ModelError as error:
                if open_files_exhausted(error.__context__):
                    raise
                continue  # A broken tape of another photo must not stop this run.
            if photo_sha256 is not None and tape.photo == photo_sha256:
                return tape, path
    return None


def _object_or_text(text: str) -> dict[str, Any] | str:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return value if isinstance(value, dict) else text


def _differing(entry: Entry, request: Request[Any]) -> list[str]:
    return [part for part, value in request.parts.items() if entry.parts.get(part) != value[:16]]
