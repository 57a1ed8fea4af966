"""Mailbox: each request becomes a folder, into which a person or a program writes the response.

    0003-program-cup/
        prompt.md       the request and instructions for the response
        1-photo.png     the pictures, in the order of the request
        schema.json     the JSON schema of the response
        request.json    key, role and name of the request
        response.json   the response, which the person or program writes
        error.md        the reason why the last response was rejected
        waiting.md      exists while a run waits for the response
        response.rejected-1.json    a rejected response

Several requests can wait at the same time. A resumed run finds the folder of a request by the
request's key, and uses a response that is already there. A program may write response.json in
place: incomplete JSON is not read while the file still changes.
"""

import asyncio
import json
import logging
import os
import re
import shutil
import stat
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from ..config import RoleOptions
from ..errors import ModelError
from ..io import read_model
from ..io.files import irregular_entry, read_bytes, write_inside
from ..io.names import file_name
from .requests import (
    MAX_BODY_BYTES,
    InvalidResponse,
    Rejection,
    Reply,
    Request,
    Usage,
    is_json,
    read_response,
)

_log = logging.getLogger(__name__)
PACKAGE = __name__.partition(".")[0]
"""Name of the package and of its logger."""
RESPONSE, ERROR, TICKET, WAITING = "response.json", "error.md", "request.json", "waiting.md"
POLL_S = 0.2
"""Interval at which the folders are polled [s]."""
PICTURES, END = "\n\n## Pictures\n\n", "\n\n## Response\n\n"
"""Headings of prompt.md; the first one ends the instructions, and the second the request."""
UNCHANGED_S = 3.0
"""Age of a file from which on incomplete JSON in it is rejected [s]."""


class _Ticket(BaseModel):
    key: str
    role: str
    name: str


class Mailbox:
    """Provider of responses that a person or another program writes into folders.

    Each request is announced by a line in the package's log, or on standard error if the log has no
    handler.

    Args:
        folder: folder in which each request gets a folder; created if missing.
        timeout_s: maximum time to wait for a response [s]. If None, there is no limit.
    """

    name = "mailbox"
    online = False
    secrets: tuple[str, ...] = ()

    def __init__(self, folder: Path, *, timeout_s: float | None = None) -> None:
        self._folder = Path(folder)
        self._timeout_s = timeout_s
        self._order = asyncio.Lock()

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Write the request into a folder and wait for a valid response.

        Raises:
            ModelError: the folder cannot be written, it was removed or replaced during the wait, or
                the wait took longer than `timeout_s`.
        """
        del role, rejected
        try:
            # Write one folder at a time, so that folders are numbered in the order of the requests.
            async with self._order:
                folder = await asyncio.to_thread(self._folder_of, request)
            if not os.path.lexists(folder / RESPONSE):
                waits = f"{request.name} ({request.role}) waits for {folder / RESPONSE}"
                _announce(f"mailbox: {waits}")
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
        """Do nothing, because a mailbox has no connections."""

    def _folder_of(self, request: Request[Any]) -> Path:
        """Return the folder of a request, which an earlier run may have written."""
        if self._folder.is_dir() and (entry := irregular_entry(self._folder)):
            name, kind = entry
            raise ModelError(f"mailbox {self._folder}: {name} is {kind}; remove it")
        for ticket in sorted(self._folder.glob(f"[0-9]*/{TICKET}")):
            try:
                if read_model(ticket, _Ticket, ModelError, "a request").key == request.key:
                    return ticket.parent
            except ModelError:
                continue
        return self._put(request)

    def _put(self, request: Request[Any]) -> Path:
        """Write a request's folder under a hidden name, and rename it when it is complete."""
        self._folder.mkdir(parents=True, exist_ok=True)
        slug = file_name(request.name) or request.role
        partial = self._folder / f".partial-{request.key[:16]}"
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        files = [
            f"{number}-{file_name(picture.label) or 'picture'}{picture.suffix}"
            for number, picture in enumerate(request.pictures, start=1)
        ]
        for name, picture in zip(files, request.pictures, strict=True):
            write_inside(self._folder, f"{partial.name}/{name}", picture.data)
        ticket = _Ticket(key=request.key, role=request.role, name=request.name)
        for name, text in (
            ("prompt.md", _prompt(request, files)),
            ("schema.json", json.dumps(request.json_schema, indent=1) + "\n"),
            (TICKET, ticket.model_dump_json(indent=1) + "\n"),
        ):
            write_inside(self._folder, f"{partial.name}/{name}", text)
        begun = (re.match(r"(\d{1,9})-", path.name) for path in self._folder.iterdir())
        number = max((int(match[1]) for match in begun if match), default=0) + 1
        while os.path.lexists(folder := self._folder / f"{number:04d}-{slug}"):
            number += 1
        return partial.rename(folder)

    async def _response(self, request: Request[Any], folder: Path) -> str:
        """Wait for a valid response in a folder, which must stay the same one."""
        own, path = os.stat(folder, follow_symlinks=False), folder / RESPONSE
        waiting = f"{folder.name}/{WAITING}"
        _check_same(folder, own)
        write_inside(self._folder, waiting, "A run waits for a response.\n")
        try:
            while True:
                _check_same(folder, own)
                with suppress(FileNotFoundError):  # There is no response yet, or no more.
                    data = read_bytes(path, MAX_BODY_BYTES, follow=False)
                    text = data.decode("utf-8", errors="replace")
                    try:
                        read_response(text, request.schema)
                    except InvalidResponse as error:
                        if abs(time.time() - path.stat().st_mtime) >= UNCHANGED_S or is_json(text):
                            self._reject(folder, str(error))
                    else:
                        (folder / ERROR).unlink(missing_ok=True)
                        return text
                await asyncio.sleep(POLL_S)
        finally:
            with suppress(OSError, ModelError):
                _check_same(folder, own)
                (folder / WAITING).unlink()

    def _reject(self, folder: Path, reason: str) -> None:
        """Rename the response in a folder, and write the reason."""
        count = 1 + len(list(folder.glob("response.rejected-*")))
        rejected_name = f"response.rejected-{count}.json"
        (folder / RESPONSE).rename(folder / rejected_name)
        text = (
            f"# Response {count} was rejected\n\n{reason}\n\nIt was moved to {rejected_name}. "
            f"Write a corrected {RESPONSE} that fits schema.json.\n"
        )
        write_inside(self._folder, f"{folder.name}/{ERROR}", text)


def _check_same(folder: Path, own: os.stat_result) -> None:
    """Raise a ModelError if another folder, a link or nothing has taken the place of a folder."""
    with suppress(OSError):
        now = os.stat(folder, follow_symlinks=False)
        if stat.S_ISDIR(now.st_mode) and os.path.samestat(own, now) and (folder / TICKET).exists():
            return
    raise ModelError(
        f"{folder} was removed or replaced while the run waited for its response; resume the run, "
        "which writes the request again"
    )


def _announce(line: str) -> None:
    if logging.getLogger(PACKAGE).handlers:
        _log.info("%s", line)
    else:
        sys.stderr.write(line + "\n")


def _prompt(request: Request[Any], files: Sequence[str]) -> str:
    pictures = "\n".join(
        f"- {name}: {picture.label} ({picture.size[0]} x {picture.size[1]} px)"
        for name, picture in zip(files, request.pictures, strict=True)
    )
    previewed = (
        " Before that, `neoworld preview draft.json` draws the 3D boxes of a response on the "
        "photograph and lists what the checks find; draft.json must be in this folder."
    )
    return (
        f"# {request.name} ({request.role})\n\n{request.system}"
        f"{PICTURES}{pictures or 'none'}\n\n## Request\n\n{request.prompt}"
        f"{END}Write one JSON object that fits schema.json to response.json in this "
        f"folder. If it does not fit, error.md says why and the run waits again."
        f"{previewed if request.role == 'reasoner' else ''}\n"
    )
