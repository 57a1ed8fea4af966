"""Earlier versions of files that a later step of a run has replaced.

A step may replace a file of an earlier step, for example the scene tree or the program of an
object. The earlier version is kept next to the file as history/STEP/NAME, where STEP is the step
that wrote it, and stays an output of this step. The steps are those of run.json, by name.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from ..io.files import write_inside
from ..step_names import STEPS

Steps = Mapping[str, dict[str, Any]]


def step_of(name: str) -> str:
    """Return the step of a part of a step, such as "program" of "program/cup"."""
    return name.split("/", maxsplit=1)[0]


def history_path(step: str, name: str) -> str:
    """Return the path of the version of a file that a step wrote and a later step replaced."""
    path = PurePosixPath(name)
    return (path.parent / "history" / step / path.name).as_posix()


def path_before(steps: Steps, step: str, name: str) -> str:
    """Return the path of the version of a file that the steps before `step` left."""
    earlier = STEPS[: [*STEPS].index(step)]
    writer = _writer(steps, name)
    if writer is None or step_of(writer) not in earlier:
        for other in reversed(earlier):
            if _writer(steps, history_path(other, name)) is not None:
                return history_path(other, name)
    return name


def later_writers(steps: Steps, part: str, names: Iterable[str]) -> set[str]:
    """Return the parts of later steps that replaced files that a part of a step writes again."""
    later = STEPS[[*STEPS].index(step_of(part)) + 1 :]
    writers = {_writer(steps, name) for name in names}
    return {writer for writer in writers if writer is not None and step_of(writer) in later}


def keep_versions(folder: Path, steps: Steps, part: str, names: Iterable[str]) -> bool:
    """Copy the files that a part of a step will replace to their paths in the history.

    The copies become outputs of the steps that wrote the files. Return True if there are any.
    """
    kept = False
    for name in names:
        writer = _writer(steps, name)
        if writer is not None and writer != part:
            version, outputs = history_path(step_of(writer), name), steps[writer]["outputs"]
            write_inside(folder, version, (folder / name).read_bytes())
            outputs[version] = outputs.pop(name)
            kept = True
    return kept


def earlier_versions(steps: Steps, names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Return the last earlier version of each file that has one: its writer and its path."""
    found = {}
    for name in names:
        for step in STEPS:
            version = history_path(step, name)
            writer = _writer(steps, version)
            if writer is not None:
                found[name] = writer, version
    return found


def replaced_files(steps: Steps) -> set[str]:
    """Return the paths of all files that have an earlier version in the history."""
    names = set()
    for entry in steps.values():
        for version in map(PurePosixPath, entry["outputs"]):
            if version.parent.parent.name == "history":
                names.add((version.parents[2] / version.name).as_posix())
    return names


def has_writer(steps: Steps, name: str) -> bool:
    """Return True if the outputs of a step contain a file."""
    return _writer(steps, name) is not None


def _writer(steps: Steps, name: str) -> str | None:
    """Return the part of a step whose outputs contain a file."""
    return next((part for part, entry in steps.items() if name in entry["outputs"]), None)
