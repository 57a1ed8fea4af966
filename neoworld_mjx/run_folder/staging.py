"""Files of a run folder: the lock, moves of finished files into place, and earlier versions.

A step may replace a file of an earlier step, for example the scene tree or the program of an
object. The earlier version is kept next to the file as history/STEP/NAME, where STEP is the step
that wrote it, and stays an output of this step. The steps are those of run.json, by name.
"""

import contextlib
import errno
import fcntl
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, TextIO

from ..errors import ExportError, RunError
from ..io.files import (
    TEMPORARY_NAME,
    content_hash,
    disk_full,
    irregular_entry,
    sync_folder,
    write_inside,
)
from ..names import STEPS

LOCK, STAGING = ".lock", ".staging"
_OBJECT = r"objects/\w+"
_FILES: dict[str, str] = {
    "parse": r"(tree|parse|annotation|given|known)\.json|photo\.png|pictures/parse\.png"
    rf"|{_OBJECT}/spec\.json"
    r"|evidence/(evidence\.json|depth\.npy|confidence\.npy|masks\.png)"
    r"|views/(views\.json|boxes\.json|\d+\.png)",
    "program": rf"tree\.json|{_OBJECT}/(spec\.json|program\.json|\w+\.py)",
    "verify": rf"{_OBJECT}/(spec|program|verify|program\.patch)\.json|{_OBJECT}/program\.py",
    "compose": rf"tree\.json|compose/\w+\.json|pictures/\w+\.png"
    rf"|{_OBJECT}/(spec\.json|program\.py)",
    "refine": r"scene\.json|refine/(history\.npz|result\.json)",
    "export": r"pictures/after\.png|package\.xml|drives\.xml|scene\.(xml|usda|sdf|dmd\.yaml)"
    rf"|{_OBJECT}/(object\.\w+|drives\.xml|(meshes|textures)/[\w.-]+)",
}
"""Pattern of the paths that each step writes. Only these files are ever moved or deleted."""


def writes(part: str, name: str) -> bool:
    """Return True if a part of a step may write a file, or its version in the history."""
    step = step_of(part)
    path = PurePosixPath(name)
    if path.parent.parts[-2:] == ("history", step):
        name = (path.parents[2] / path.name).as_posix()
    return step in _FILES and re.fullmatch(_FILES[step], name) is not None


def check_claimable(folder: Path) -> None:
    """Refuse a folder that contains anything but a run, before writing to it.

    Raises:
        RunError: the folder contains other files, links or devices, or cannot be read.
    """
    if not folder.is_dir():
        return
    refuse_links(folder)
    if (folder / "run.json").exists():
        return
    try:
        names = {entry.name for entry in folder.iterdir()}
    except OSError as error:
        raise RunError(f"cannot read {folder}: {error.strerror}") from None
    run_files = {LOCK, STAGING, *(name for name in names if _is_part_of_run_json(name))}
    foreign = sorted(names - run_files)
    if foreign:
        raise RunError(
            f"{folder} is not empty and not a run folder (it contains {foreign[0]}); "
            "name a new or empty folder"
        )


def _is_part_of_run_json(name: str) -> bool:
    part = TEMPORARY_NAME.match(name)
    return part is not None and part["name"] == "run.json"


def refuse_links(folder: Path) -> None:
    """Refuse a folder that contains links, pipes or devices, which may lead to outside files.

    The folder itself may be a link.

    Raises:
        RunError: the folder contains a link, a pipe or a device, or cannot be read.
    """
    try:
        irregular = irregular_entry(folder)
    except OSError as error:
        path = error.filename or folder
        raise RunError(
            f"cannot read {path}: {error.strerror}; name a folder that you may write to"
        ) from None
    if irregular is not None:
        name, kind = irregular
        raise RunError(
            f"{folder} contains {name!r}, which is {kind}; a run folder contains only regular "
            "files and folders: remove it, or copy the folder without it"
        )


def lock_folder(folder: Path) -> TextIO:
    """Lock a folder without links until the returned file is closed.

    Raises:
        RunError: another process holds the lock.
        OSError: the lock file cannot be written.
    """
    handle = (folder / LOCK).open("a+", encoding="utf-8")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        handle.seek(0)
        owner = handle.read(20).strip() or "unknown"
        handle.close()
        raise RunError(
            f"{folder} is in use by another run (process {owner}); wait for it or name another "
            "folder"
        ) from None
    handle.truncate(0)
    handle.write(str(os.getpid()))
    handle.flush()
    return handle


def clear_unfinished(folder: Path) -> None:
    """Delete unfinished files and the staging folders of a killed process."""
    shutil.rmtree(folder / STAGING, ignore_errors=True)
    for entry in folder.iterdir():
        if TEMPORARY_NAME.match(entry.name):
            entry.unlink(missing_ok=True)


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
    """Move an edited file to `replaced/`, without overwriting earlier ones; return its new path."""
    aside = f"replaced/{name}"
    while (folder / aside).exists():
        aside += ".old"
    (folder / aside).parent.mkdir(parents=True, exist_ok=True)
    os.replace(folder / name, folder / aside)
    return folder / aside


def delete_files(folder: Path, names: Iterable[str]) -> None:
    """Delete files of a run folder, and the folders that this leaves empty."""
    for name in names:
        (folder / name).unlink(missing_ok=True)
        for parent in PurePosixPath(name).parents[:-1]:
            try:
                (folder / parent).rmdir()
            except FileNotFoundError:
                continue
            except OSError:  # It is not empty.
                break


@contextlib.contextmanager
def disk_errors(folder: Path, *, include_outside: bool = False) -> Iterator[None]:
    """Turn a full or read-only disk into a RunError.

    Args:
        folder: the run folder.
        include_outside: if True, also convert errors of files outside the folder.
    """
    try:
        yield
    except (OSError, RuntimeError, ExportError) as error:
        code = error.errno if isinstance(error, OSError) else None
        # Some writers report a full disk as another error.
        if code in (errno.ENOSPC, errno.EDQUOT) or disk_full(folder):
            raise RunError(
                f"no space left on the disk of {folder}: free some, then continue with --resume"
            ) from error
        path = str(getattr(error, "filename", None) or folder)
        if isinstance(error, OSError) and (include_outside or path.startswith(str(folder))):
            raise RunError(
                f"cannot write {path}: {error.strerror}; name a folder that you may write to"
            ) from error
        raise


Steps = Mapping[str, dict[str, Any]]


def step_of(name: str) -> str:
    """Return the step of a part of a step, such as "program" of "program/cup"."""
    return name.split("/", maxsplit=1)[0]


def history_path(step: str, name: str) -> str:
    """Return the path of the version of a file that a step wrote and a later step replaced."""
    path = PurePosixPath(name)
    return (path.parent / "history" / step / path.name).as_posix()


def versions(steps: Steps, name: str) -> list[tuple[str, str]]:
    """Return the versions of a file, oldest first: the part of a step that wrote it, and its path.

    The last version is the file itself, unless no step has written it since the earlier ones.
    """
    paths = [*(history_path(step, name) for step in STEPS), name]
    return [
        (part, path) for path in paths for part, entry in steps.items() if path in entry["outputs"]
    ]


def path_before(steps: Steps, step: str, name: str) -> str:
    """Return the path of the version of a file that the steps before `step` left."""
    earlier = STEPS[: [*STEPS].index(step)]
    found = [path for part, path in versions(steps, name) if step_of(part) in earlier]
    return found[-1] if found else name


def later_writers(steps: Steps, part: str, names: Iterable[str]) -> set[str]:
    """Return the parts of later steps that replaced files that a part of a step writes again."""
    later = STEPS[[*STEPS].index(step_of(part)) + 1 :]
    return {
        writer
        for name in names
        for writer, path in versions(steps, name)
        if path == name and step_of(writer) in later
    }


def keep_versions(folder: Path, steps: Steps, part: str, names: Iterable[str]) -> bool:
    """Copy the files that a part of a step will replace to their paths in the history.

    The copies become outputs of the steps that wrote the files. Return True if there are any.
    """
    kept = False
    for name in names:
        for writer, path in versions(steps, name):
            if path == name and writer != part:
                version, outputs = history_path(step_of(writer), name), steps[writer]["outputs"]
                write_inside(folder, version, (folder / name).read_bytes())
                outputs[version] = outputs.pop(name)
                kept = True
    return kept


def replaced_files(steps: Steps) -> set[str]:
    """Return the paths of all files that have an earlier version in the history."""
    names = set()
    for entry in steps.values():
        for version in map(PurePosixPath, entry["outputs"]):
            if version.parent.parent.name == "history":
                names.add((version.parents[2] / version.name).as_posix())
    return names
