"""Functions that read and write files in untrusted folders, and hash their contents.

Only regular files within a size limit are read, never pipes or devices. A file is written under a
temporary name and then renamed, so that a reader or a killed process never leaves a partial file.
Its parent folders are opened one by one without following symbolic links, so that a write never
leaves the folder.
"""

import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from pydantic import BaseModel

from ..errors import NeoWorldError

MIB = 1 << 20
IRREGULAR = "it is a pipe or device, not a regular file"
TEMPORARY_NAME = re.compile(r"^\.(?P<name>.+)\.[0-9a-f]{16}\.part$")
"""Temporary name of a file that is being written."""
_CHUNK = MIB
_MAX_ENTRIES = 200_000
_AS_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC


def read_bytes(path: Path, max_bytes: int, *, follow: bool = True) -> bytes:
    """Read a regular file.

    Args:
        path: the file, or a symbolic link to it.
        max_bytes: maximum size.
        follow: if False, refuse a symbolic link.

    Raises:
        OSError: the file cannot be read, is not a regular file, or is larger than `max_bytes`;
            `strerror` describes the problem.
    """
    with _open_descriptor(path, 0 if follow else os.O_NOFOLLOW) as handle:
        size = os.fstat(handle).st_size
        if size <= max_bytes:
            chunks, remaining = [], max_bytes + 1
            while remaining and (chunk := os.read(handle, min(remaining, max(size, 4096)))):
                chunks.append(chunk)
                remaining -= len(chunk)
            if remaining:
                return b"".join(chunks)
        size = max(size, max_bytes + 1)
        raise OSError(
            errno.EFBIG,
            f"it has {size / MIB:.3g} MiB; the limit is {max_bytes / MIB:g} MiB",
            str(path),
        )


def read_text(path: Path, max_bytes: int) -> str:
    """Read a regular file of UTF-8 text; see `read_bytes`.

    Raises:
        OSError: as in `read_bytes`, or if the file is not UTF-8.
    """
    try:
        return read_bytes(path, max_bytes).decode("utf-8")
    except UnicodeDecodeError:
        raise OSError(errno.EILSEQ, "it is not a text file", str(path)) from None


def write_atomic(path: Path, data: str | bytes) -> None:
    """Write a file atomically: a reader sees the old or the new content, even after a crash.

    An existing symbolic link at the path is replaced, not followed; the folder may be a link.

    Raises:
        OSError: the file cannot be written.
    """
    write_inside(path.parent, path.name, data)


def write_output(path: Path, data: str | bytes, error: type[NeoWorldError]) -> None:
    """Write a file as `write_atomic` does, but report a failure as an error of a given class.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be written.
    """
    try:
        write_atomic(path, data)
    except OSError as problem:
        raise error(f"cannot write {path}: {problem.strerror}") from None


def write_inside(folder: Path, name: str, data: str | bytes, *, sync: bool = True) -> None:
    """Write a file below a folder as `write_atomic` does, creating missing subfolders.

    Args:
        folder: an existing folder.
        name: relative path of the file, with "/" as separator.
        data: the content.
        sync: if False, let the system flush the file to the disk later.

    Raises:
        OSError: the file cannot be written, its path leads out of the folder or through a link, or
            a folder, pipe or device exists at the path.
    """
    with _open_parent(folder, name) as (parent, last):
        _check_replaceable(parent, last, folder / name)
        part = f".{last}.{secrets.token_hex(8)}.part"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            with os.fdopen(os.open(part, flags, 0o666, dir_fd=parent), "wb") as handle:
                handle.write(data.encode() if isinstance(data, str) else data)
                handle.flush()
                if sync:
                    os.fsync(handle.fileno())
            os.replace(part, last, src_dir_fd=parent, dst_dir_fd=parent)
        except BaseException:
            with suppress(OSError):
                os.unlink(part, dir_fd=parent)
            raise
        if sync:
            os.fsync(parent)


def _check_replaceable(parent: int, last: str, path: Path) -> None:
    """Raise an OSError if a folder, pipe or device exists at the path of a file.

    A rename would replace even a device file, which other programs may need.
    """
    with suppress(FileNotFoundError):
        mode = os.stat(last, dir_fd=parent, follow_symlinks=False).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "it is a folder; name a file", str(path))
        if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode)):
            raise OSError(errno.EINVAL, IRREGULAR, str(path))


@contextmanager
def _open_parent(folder: Path, name: str) -> Iterator[tuple[int, str]]:
    """Open or create the parent folder of a file below a folder, without following links.

    Yields:
        File descriptor of the parent folder, and the file's base name.
    """
    if not stays_inside(name):
        raise OSError(errno.EINVAL, "its path leads out of the folder", str(folder / name))
    *heads, last = PurePosixPath(name).parts
    parent = os.open(folder, _AS_FOLDER)
    try:
        for head in heads:
            with suppress(FileExistsError):
                os.mkdir(head, dir_fd=parent)
            try:
                child = os.open(head, _AS_FOLDER | os.O_NOFOLLOW, dir_fd=parent)
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.ENOTDIR):
                    error.strerror = f"{head} in its path is a link or a file"
                error.filename = str(folder / name)
                raise
            os.close(parent)
            parent = child
        yield parent, last
    except OSError as error:
        if not isinstance(error.filename, str) or not os.path.isabs(error.filename):
            error.filename, error.filename2 = str(folder / name), None
        raise
    finally:
        os.close(parent)


def stays_inside(name: str) -> bool:
    """Return True if a relative path (separator "/") from an untrusted file stays in its folder."""
    parts = name.split("/")
    return not (set(parts) & {"", ".", ".."} or "\0" in name or "\\" in name)


def irregular_entry(folder: Path) -> tuple[str, str] | None:
    """Return the path and the kind of the first entry below a folder that is not accepted.

    Accepted are at most `_MAX_ENTRIES` regular files and folders.

    Returns:
        Relative path of the entry, and a phrase that describes its kind, such as "a link"; None if
        all entries are accepted.

    Raises:
        OSError: a folder cannot be read.
    """
    pending, count = [""], 0
    while pending:
        prefix = pending.pop()
        with os.scandir(folder / prefix) as entries:
            for entry in sorted(entries, key=lambda entry: entry.name):
                name = f"{prefix}/{entry.name}" if prefix else entry.name
                count += 1
                if entry.is_symlink():
                    return name, "a link"
                if count > _MAX_ENTRIES:
                    return name, f"one of more than {_MAX_ENTRIES} files"
                if entry.is_dir(follow_symlinks=False):
                    pending.append(name)
                elif not entry.is_file(follow_symlinks=False):
                    return name, "a pipe or device"
    return None


def content_hash(value: object) -> str:
    """Return the SHA-256 hex digest of a file, a folder, bytes, a pydantic model or a JSON value.

    Raises:
        FileNotFoundError: a path is missing.
        OSError: a file cannot be read, or is not a regular file.
    """
    digest = hashlib.sha256()
    if isinstance(value, Path) and value.is_dir():
        for file in sorted(p for p in value.rglob("*") if p.is_file()):
            digest.update(f"{file.relative_to(value).as_posix()}\0{content_hash(file)}\n".encode())
    elif isinstance(value, Path):
        with _open_descriptor(value) as handle:
            while chunk := os.read(handle, _CHUNK):
                digest.update(chunk)
    elif isinstance(value, bytes):
        digest.update(value)
    elif isinstance(value, BaseModel):
        digest.update(json.dumps(value.model_dump(mode="json"), sort_keys=True).encode())
    else:
        digest.update(json.dumps(value, sort_keys=True).encode())
    return digest.hexdigest()


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def disk_full(path: Path) -> bool:
    """Return True if the file system of a path has less than 64 KiB of free space."""
    try:
        return shutil.disk_usage(path).free < 65536
    except OSError:
        return False


@contextmanager
def _open_descriptor(path: Path, flags: int = 0) -> Iterator[int]:
    # Without O_NONBLOCK, opening a pipe blocks until a writer appears.
    flags |= os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        handle = os.open(path, flags)
    except OSError as error:
        if error.errno == errno.ELOOP and flags & os.O_NOFOLLOW:
            raise OSError(errno.ELOOP, "it is a link, not a regular file", str(path)) from None
        raise
    try:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "it is a folder; name a file", str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, IRREGULAR, str(path))
        yield handle
    finally:
        os.close(handle)
