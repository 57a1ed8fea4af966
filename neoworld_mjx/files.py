"""Files written so that no reader and no kill ever finds half of one, and hashes of contents."""

import hashlib
import json
import os
import shutil
from pathlib import Path

from pydantic import BaseModel


def write_atomic(path: Path, data: str | bytes) -> None:
    """Write a file so that a reader finds the old or the new content, whenever this is killed."""
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("wb") as handle:
            handle.write(data.encode() if isinstance(data, str) else data)
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def content_hash(value: object) -> str:
    """Return the SHA-256 of a file's or folder's contents, of bytes, of a model or a JSON value.

    Raises:
        FileNotFoundError: a path is missing.
    """
    digest = hashlib.sha256()
    if isinstance(value, Path) and value.is_dir():
        for file in sorted(p for p in value.rglob("*") if p.is_file()):
            digest.update(f"{file.relative_to(value).as_posix()}\0{content_hash(file)}\n".encode())
    elif isinstance(value, Path):
        digest.update(value.read_bytes())
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
