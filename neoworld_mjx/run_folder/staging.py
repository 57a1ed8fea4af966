"""The files of a run folder: its lock, moving a finished step's files in, and disk errors."""

import contextlib
import errno
import fcntl
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TextIO

from ..errors import ExportError, RunError
from ..files import content_hash, disk_full, sync_folder

LOCK, STAGING = ".lock", ".staging"
_OWN = {LOCK, STAGING, ".run.json.part"}


def check_claimable(folder: Path) -> None:
    """Refuse a folder that holds anything but a run, before a byte is written to it.

    Raises:
        RunError: the folder holds other files, or cannot be read.
    """
    if not folder.is_dir() or (folder / "run.json").exists():
        return
    try:
        foreign = sorted({entry.name for entry in folder.iterdir()} - _OWN)
    except OSError as error:
        raise RunError(f"cannot read {folder}: {error.strerror}") from None
    if foreign:
        raise RunError(
            f"{folder} is not empty and not a run folder (it holds {foreign[0]}); "
            "name a new or empty folder"
        )


def lock_folder(folder: Path) -> TextIO:
    """Lock a folder until the returned file is closed.

    Raises:
        RunError: another process holds the lock.
    """
    handle = (folder / LOCK).open("a+")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        handle.seek(0)
        owner = handle.read().strip() or "unknown"
        handle.close()
        raise RunError(
            f"{folder} is in use by another run (process {owner}); wait for it or name another "
            "folder"
        ) from None
    handle.truncate(0)
    handle.write(str(os.getpid()))
    handle.flush()
    return handle


def move_in(staged: Path, folder: Path) -> dict[str, str]:
    """Flush the files of a staging folder and move them into the run folder.

    Returns:
        The content hash of each file, by its path in the run folder.
    """
    hashes = {}
    for path in sorted(path for path in staged.rglob("*") if path.is_file()):
        with path.open("rb") as handle:
            os.fsync(handle.fileno())
        hashes[path.relative_to(staged).as_posix()] = content_hash(path)
    for name in hashes:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged / name, folder / name)
    for parent in sorted({(folder / name).parent for name in hashes}):
        sync_folder(parent)
    shutil.rmtree(staged, ignore_errors=True)
    return hashes


def set_aside(folder: Path, name: str) -> Path:
    """Move an edited file under `replaced/`, beside earlier ones; return its new path."""
    aside = folder / "replaced" / name
    while aside.exists():
        aside = aside.with_name(f"{aside.name}.old")
    aside.parent.mkdir(parents=True, exist_ok=True)
    os.replace(folder / name, aside)
    return aside


def delete_files(folder: Path, names: Iterable[str]) -> None:
    """Delete files of a run folder, and the folders that this leaves empty."""
    for path in map(folder.joinpath, names):
        path.unlink(missing_ok=True)
        for parent in path.parents:
            if parent == folder or not parent.is_dir() or any(parent.iterdir()):
                break
            parent.rmdir()


@contextlib.contextmanager
def disk_errors(folder: Path, *, anywhere: bool = False) -> Iterator[None]:
    """Turn a full or read-only disk into a RunError.

    Args:
        folder: the run folder.
        anywhere: whether errors of files outside of the folder are turned too.
    """
    try:
        yield
    except (OSError, RuntimeError, ExportError) as error:
        code = error.errno if isinstance(error, OSError) else None
        # Some writers hide a full disk in an error of their own.
        if code in (errno.ENOSPC, errno.EDQUOT) or disk_full(folder):
            raise RunError(
                f"no space left on the disk of {folder}: free some, then go on with --resume"
            ) from error
        named = str(getattr(error, "filename", None) or folder)
        if isinstance(error, OSError) and (anywhere or named.startswith(str(folder))):
            raise RunError(
                f"cannot write {named}: {error.strerror}; name a folder that you may write to"
            ) from error
        raise
