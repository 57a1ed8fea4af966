"""The mailbox: every request becomes a folder, and whoever looks into it writes the answer.

    0003-program-cup/
        prompt.md       what is asked, and what to answer
        1-photo.png     the pictures, in the order of the request
        schema.json     the JSON schema of the answer
        request.json    key, role and name of the request
        response.json   the answer, to be written by whoever answers
        error.md        why the last response was rejected, if one was
        response.rejected-1.json

Requests wait side by side. A folder of an interrupted run is taken up again by its key, with its
response if it has one. Writing response.json in place is fine: while it is no whole JSON and still
changes, it counts as unfinished.
"""

import asyncio
import json
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from ..config import RoleOptions
from ..errors import ModelError
from .answers import InvalidAnswer, is_json, read_answer
from .model import Rejection, Reply, Request, Usage

_POLL_S = 0.2
_SETTLED_S = 3.0
"""A response that is no whole JSON counts as finished when it has not changed for so long."""


class _Ticket(BaseModel):
    key: str
    role: str
    name: str


class Mailbox:
    """The provider whose answers are written into folders by a person or another program.

    Args:
        folder: where the requests' folders go; made if it is not there.
        timeout_s: how long one request waits, in seconds; None waits for ever.
        poll_s: how often the folders are looked at, in seconds.
        settled_s: how long a response that is no JSON must have been unchanged to be rejected.
        say: gets the line that tells where answers are awaited; default: standard error.
    """

    name = "mailbox"
    online = False
    secrets: tuple[str, ...] = ()

    def __init__(
        self,
        folder: Path,
        *,
        timeout_s: float | None = None,
        poll_s: float = _POLL_S,
        settled_s: float = _SETTLED_S,
        say: Callable[[str], object] | None = None,
    ) -> None:
        self._folder = Path(folder)
        self._timeout_s = timeout_s
        self._poll_s = poll_s
        self._settled_s = settled_s
        self._say = say or (lambda line: sys.stderr.write(line + "\n"))
        self._said = False

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Put the request into a folder and wait for a response that validates.

        Raises:
            ModelError: the folder cannot be written, or the time is up.
        """
        del role, rejected
        try:
            folder = self._find(request) or self._put(request)
            if not self._said and not (folder / "response.json").exists():
                self._said = True
                self._say(
                    f"waiting for answers: write response.json into each folder of {self._folder}"
                )
            text = await asyncio.wait_for(self._response(request, folder), self._timeout_s)
        except TimeoutError:
            raise ModelError(
                f"{request.name}: no valid response.json in {self._folder} within "
                f"{self._timeout_s:g} s; write it and resume the run"
            ) from None
        except OSError as error:
            raise ModelError(
                f"{request.name}: mailbox {self._folder}: {error.strerror}: {error.filename}"
            ) from None
        return Reply(text, Usage(), "mailbox")

    async def close(self) -> None:
        """Do nothing; the folders stay."""

    def _find(self, request: Request[Any]) -> Path | None:
        """Find the folder that asks this very request already."""
        for ticket in sorted(self._folder.glob("[0-9]*/request.json")):
            try:
                if _Ticket.model_validate_json(ticket.read_bytes()).key == request.key:
                    return ticket.parent
            except (OSError, ValueError):
                continue
        return None

    def _put(self, request: Request[Any]) -> Path:
        """Write a request's folder under a hidden name first, so that none is seen half-written."""
        self._folder.mkdir(parents=True, exist_ok=True)
        slug = _slug(request.name) or request.role
        partial = self._folder / f".partial-{request.key[:16]}"
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        files = [
            f"{number}-{_slug(picture.label) or 'picture'}{picture.suffix}"
            for number, picture in enumerate(request.pictures, start=1)
        ]
        for name, picture in zip(files, request.pictures, strict=True):
            (partial / name).write_bytes(picture.data)
        _write(partial / "prompt.md", _prompt(request, files))
        _write(partial / "schema.json", json.dumps(request.json_schema, indent=1) + "\n")
        ticket = _Ticket(key=request.key, role=request.role, name=request.name)
        _write(partial / "request.json", ticket.model_dump_json(indent=1) + "\n")
        numbers = [int(m[1]) for p in self._folder.iterdir() if (m := re.match(r"(\d+)-", p.name))]
        folder = self._folder / f"{max(numbers, default=0) + 1:04d}-{slug}"
        return partial.rename(folder)

    async def _response(self, request: Request[Any], folder: Path) -> str:
        path = folder / "response.json"
        seen: tuple[int, int] | None = None
        since = 0.0
        while True:
            stamp = _stamp(path)
            now = asyncio.get_running_loop().time()
            if stamp != seen:
                seen, since = stamp, now
            if stamp is not None:
                text = path.read_text(encoding="utf-8", errors="replace")
                whole = is_json(text)
                try:
                    read_answer(text, request.schema)
                except InvalidAnswer as error:
                    if whole or now - since >= self._settled_s:
                        self._reject(folder, str(error))
                        seen = None
                else:
                    (folder / "error.md").unlink(missing_ok=True)
                    return text
            await asyncio.sleep(self._poll_s)

    def _reject(self, folder: Path, reason: str) -> None:
        count = 1 + sum(1 for _ in folder.glob("response.rejected-*.json"))
        kept = f"response.rejected-{count}.json"
        (folder / "response.json").rename(folder / kept)
        _write(
            folder / "error.md",
            f"# Response {count} was rejected\n\n{reason}\n\n"
            f"It was moved to {kept}. Write a corrected response.json that fits schema.json.\n",
        )


def _prompt(request: Request[Any], files: Sequence[str]) -> str:
    pictures = "\n".join(
        f"- {name}: {picture.label} ({picture.size[0]} x {picture.size[1]} px)"
        for name, picture in zip(files, request.pictures, strict=True)
    )
    return (
        f"# {request.name} ({request.role})\n\n{request.system}\n\n"
        f"## Pictures\n\n{pictures or 'none'}\n\n## Request\n\n{request.prompt}\n\n"
        f"## Answer\n\nWrite one JSON object that fits schema.json to response.json in this "
        f"folder. If it does not fit, error.md says why and the run waits again.\n"
    )


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_mtime_ns, status.st_size


def _slug(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._]+", "-", text).strip("-.")[:60]


def _write(path: Path, text: str) -> None:
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
