"""Files read and written without trust in the folder that they lie in, and hashes of contents.

A file is read only if it is a regular one and no larger than allowed: never a pipe or a device.
It is written under a new name and then renamed, so that no reader and no kill ever finds half of
one, and through folders opened one by one without following links, so that nothing outside of the
folder is touched.
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

MIB = 1 << 20
PART = re.compile(r"^\.(?P<name>.+)\.[0-9a-f]{16}\.part$")
"""Name of a file while it is written."""
_CHUNK = MIB
_MAX_ENTRIES = 200_000
_AS_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """Read a regular file.

    Args:
        path: the file; it may be a link to one.
        max_bytes: largest size that is read.

    Raises:
        OSError: it cannot be read, is no regular file or is larger; `strerror` says what to do.
    """
    with _opened(path) as handle:
        size = os.fstat(handle).st_size
        if size <= max_bytes:
            chunks, left = [], max_bytes + 1
            while left and (chunk := os.read(handle, min(left, max(size, 4096)))):
                chunks.append(chunk)
                left -= len(chunk)
            if left:
                return b"".join(chunks)
        size = max(size, max_bytes + 1)
        raise OSError(
            errno.EFBIG,
            f"it has {size / MIB:.3g} MiB and at most {max_bytes / MIB:g} are read",
            str(path),
        )


def read_text(path: Path, max_bytes: int) -> str:
    """Read a regular file of UTF-8 text; see `read_bytes`.

    Raises:
        OSError: as `read_bytes`; also if it holds no UTF-8 text.
    """
    try:
        return read_bytes(path, max_bytes).decode("utf-8")
    except UnicodeDecodeError:
        raise OSError(errno.EILSEQ, "it is not a text file", str(path)) from None


def write_atomic(path: Path, data: str | bytes) -> None:
    """Write a file so that a reader finds the old or the new content, whenever this is killed.

    A link of that name is replaced, not followed; its folder may be a link.

    Raises:
        OSError: it cannot be written.
    """
    write_inside(path.parent, path.name, data)


def write_inside(folder: Path, name: str, data: str | bytes) -> None:
    """Write a file of a folder as `write_atomic` does, and the folders between them.

    Args:
        folder: an existing folder.
        name: path in it, with "/".
        data: the content.

    Raises:
        OSError: it cannot be written, or its path leads out of the folder or over a link.
    """
    with open_parent(folder, name, create=True) as (parent, last):
        part = f".{last}.{secrets.token_hex(8)}.part"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            with os.fdopen(os.open(part, flags, 0o666, dir_fd=parent), "wb") as handle:
                handle.write(data.encode() if isinstance(data, str) else data)
                handle.flush()
                os.fsync(handle.fileno())
            os.replace(part, last, src_dir_fd=parent, dst_dir_fd=parent)
        except BaseException:
            with suppress(OSError):
                os.unlink(part, dir_fd=parent)
            raise
        os.fsync(parent)


@contextmanager
def open_parent(folder: Path, name: str, *, create: bool = False) -> Iterator[tuple[int, str]]:
    """Open the folder that holds a file of another folder, without following links below that.

    Args:
        folder: an existing folder.
        name: path of the file in it, with "/"; the file need not exist.
        create: whether to make missing folders.

    Yields:
        The open folder's descriptor and the file's last name.

    Raises:
        OSError: the path leads out of the folder, over a link or over a file; a folder is missing.
    """
    if not stays_inside(name):
        raise OSError(errno.EINVAL, "its path leads out of the folder", str(folder / name))
    *heads, last = PurePosixPath(name).parts
    at = os.open(folder, _AS_FOLDER)
    try:
        for head in heads:
            if create:
                with suppress(FileExistsError):
                    os.mkdir(head, dir_fd=at)
            try:
                below = os.open(head, _AS_FOLDER | os.O_NOFOLLOW, dir_fd=at)
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.ENOTDIR):
                    error.strerror = f"{head} in its path is a link or a file"
                error.filename = str(folder / name)
                raise
            os.close(at)
            at = below
        yield at, last
    except OSError as error:
        if not isinstance(error.filename, str) or not os.path.isabs(error.filename):
            error.filename, error.filename2 = str(folder / name), None
        raise
    finally:
        os.close(at)


def stays_inside(name: str) -> bool:
    """Tell whether a path with "/", as a file gives it, can only mean something in its folder."""
    parts = name.split("/")
    return not (set(parts) & {"", ".", ".."} or "\0" in name or "\\" in name)


def irregular_entry(folder: Path) -> tuple[str, str] | None:
    """Return the first entry below a folder that is neither file nor folder, and its kind.

    Returns:
        Its path in the folder and "a link", "a pipe or device" or "too many files"; None if all
        are files and folders.

    Raises:
        OSError: a folder cannot be read.
    """
    waiting, count = [""], 0
    while waiting:
        at = waiting.pop()
        with os.scandir(folder / at) as entries:
            for entry in sorted(entries, key=lambda entry: entry.name):
                name = f"{at}/{entry.name}" if at else entry.name
                count += 1
                if entry.is_symlink():
                    return name, "a link"
                if count > _MAX_ENTRIES:
                    return name, f"one of more than {_MAX_ENTRIES} files"
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(name)
                elif not entry.is_file(follow_symlinks=False):
                    return name, "a pipe or device"
    return None


def content_hash(value: object) -> str:
    """Return the SHA-256 of a file's or folder's contents, of bytes, of a model or a JSON value.

    Raises:
        FileNotFoundError: a path is missing.
        OSError: a path cannot be read, or is no regular file.
    """
    digest = hashlib.sha256()
    if isinstance(value, Path) and value.is_dir():
        for file in sorted(p for p in value.rglob("*") if p.is_file()):
            digest.update(f"{file.relative_to(value).as_posix()}\0{content_hash(file)}\n".encode())
    elif isinstance(value, Path):
        with _opened(value) as handle:
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
    """Tell whether the disk under a path has less than 64 KiB left."""
    try:
        return shutil.disk_usage(path).free < 65536
    except OSError:
        return False


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    # Without O_NONBLOCK the call would wait for whoever writes into a pipe.
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "it is a folder; name a file", str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is no regular file but a pipe or device", str(path))
        yield handle
    finally:
        os.close(handle)
