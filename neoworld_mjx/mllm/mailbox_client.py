"""The other side of a mailbox: list its open requests, read one, and give a response.

The names of folders that callers pass are looked up among the open requests, so no path leads out
of the mailbox, and links are not followed.
"""

import time
from pathlib import Path
from typing import NamedTuple

from ..errors import ModelError, choices
from ..io.files import read_bytes, write_inside
from .mailbox import END, ERROR, PICTURES, WAITING
from .requests import MAX_BODY_BYTES, Picture

POLL_S = 0.05
"""Interval at which the mailbox is polled for the outcome of a response [s]."""


class OpenRequest(NamedTuple):
    """A request without a response."""

    id: str
    """Name of the request's folder, such as "0003-program-cup"."""
    title: str
    """Name and role of the request."""
    instructions: str
    """Instructions that many requests share, such as the guide to programs."""
    prompt: str
    schema: str
    """JSON schema of the response as text."""
    pictures: tuple[Picture, ...]
    """Pictures in the order of the request."""


def open_requests(mailbox: Path) -> list[str]:
    """Return the names of the folders of all requests that a run waits for, oldest first."""
    return [
        folder.name
        for folder in sorted(mailbox.glob("[0-9]*"))
        if (folder / WAITING).is_file()
        and not folder.is_symlink()
        and not (folder / "response.json").exists()
    ]


def forget_waiting(mailbox: Path) -> None:
    """Close the requests of an earlier run that was killed; the next run opens its own again."""
    for name in open_requests(mailbox):
        (mailbox / name / WAITING).unlink(missing_ok=True)


def read_request(mailbox: Path, name: str | None = None) -> OpenRequest:
    """Read an open request, by default the oldest one.

    Raises:
        ModelError: there is no such open request, or its files cannot be read.
    """
    folder = _folder(mailbox, name)
    try:
        files = sorted(folder.glob("[0-9]*-*.*g"), key=lambda path: int(path.stem.split("-")[0]))
        pictures = tuple(Picture(path.stem, _read(path)) for path in files)
        whole, schema = (_read(folder / name).decode() for name in ("prompt.md", "schema.json"))
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"request {folder.name} cannot be read: {error}") from None
    first, _, rest = whole.partition(PICTURES)
    title, _, instructions = first.partition("\n\n")
    prompt = rest.partition("\n\n## Request\n\n")[2].rpartition(END)[0]
    return OpenRequest(folder.name, title.strip("# "), instructions, prompt, schema, pictures)


def respond(mailbox: Path, name: str, text: str, *, timeout_s: float) -> str:
    """Give a response, and wait until the run accepts or rejects it.

    Args:
        mailbox: the folder of the mailbox.
        name: name of the open request.
        text: the response.
        timeout_s: maximum time until the run reads the response [s].

    Returns:
        The reason of a rejection; empty if the run accepts the response.

    Raises:
        ModelError: there is no such open request, the response is too long, or the run does not
            read it in time. In the last case, the response stays and is read later.
    """
    folder = _folder(mailbox, name)
    if len(text) > MAX_BODY_BYTES:
        raise ModelError(f"the response has {len(text)} characters; shorten it")
    try:
        (folder / ERROR).unlink(missing_ok=True)
        write_inside(mailbox, f"{folder.name}/response.json", text)
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if (folder / ERROR).exists():
                text = _read(folder / ERROR).decode("utf-8", "replace")
                # The last paragraph is about the mailbox's files.
                return text.partition("\n\n")[2].rpartition("\n\n")[0]
            if not (folder / WAITING).exists():
                return ""
            time.sleep(POLL_S)
    except OSError as error:
        raise ModelError(f"request {folder.name}: {error.strerror}: {error.filename}") from None
    raise ModelError(
        f"the run did not read the response to {folder.name} within {timeout_s:g} s; it stays in "
        "the mailbox, and the run reads it when it continues"
    )


def _folder(mailbox: Path, name: str | None) -> Path:
    names = open_requests(mailbox)
    if name is None and names:
        name = names[0]
    if name is None or name not in names:
        if name is not None and not names:
            raise ModelError(f"no request is open, got {name!r}")
        raise ModelError(
            "no request is open" if name is None else f"request: {choices(name, names)}"
        )
    return mailbox / name


def _read(path: Path) -> bytes:
    return read_bytes(path, MAX_BODY_BYTES, follow=False)
