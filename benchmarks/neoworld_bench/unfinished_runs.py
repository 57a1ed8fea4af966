"""Rows of a suite that has not finished: kept as they come, and taken over by the next run.

A run has a folder in the cache, named after the suite, its options, the commit and the machine. It
is deleted once the run has finished; an interrupted run leaves it, and the same command continues.
"""

import dataclasses
import hashlib
import json
import platform
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from neoworld_mjx import __version__
from neoworld_mjx.cache import cache_folder
from neoworld_mjx.config import Config
from neoworld_mjx.errors import RunError
from neoworld_mjx.sweeps.result import commit

from .rows import Row, collect, log

ROWS = "rows.jsonl"
NOT_OPTIONS = {"json", "quiet", "verbose", "debug", "config", "set"}
"""Fields of a command that do not change its rows, or are in the configuration."""


@contextmanager
def unfinished(options: Any, config: Config | None = None) -> Iterator[Path | None]:
    """Yield the folder of a run; None if the cache cannot be written.

    Args:
        options: of the suite.
        config: of the run, for suites that take one.
    """
    values = {
        field.name: repr(getattr(options, field.name))
        for field in dataclasses.fields(options)
        if field.name not in NOT_OPTIONS
    }
    plain = None if config is None else config.model_dump(mode="json")
    code = commit() or __version__
    identity = json.dumps([values, plain, code, platform.node()], sort_keys=True)
    name = type(options).__name__.removeprefix("Bench").lower()
    digest = hashlib.sha256(identity.encode()).hexdigest()[:16]
    folder = cache_folder() / "bench" / f"{name}-{digest}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        log.warning(f"rows are not kept until the end: {folder}: {error.strerror}")
        yield None
        return
    if any(folder.iterdir()):
        log.warning(f"continuing an interrupted run; delete {folder} to begin anew")
    try:
        yield folder
    except BaseException:
        if not any(folder.iterdir()):
            folder.rmdir()
        raise
    shutil.rmtree(folder, ignore_errors=True)


class KeptRows:
    """Rows of an unfinished run, by job; a line of a file for each job that has finished.

    Args:
        folder: of the run; None keeps nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self._file = None if folder is None else folder / ROWS
        self._jobs = {} if self._file is None or not self._file.exists() else _read(self._file)

    def rows(self, job: str, make: Callable[[], Iterable[Row]]) -> list[Any]:
        """Return a job's rows: those that the file has, or else new ones, which it then keeps.

        Args:
            job: name of the job, unique in its run.
            make: makes the rows.

        Raises:
            RunError: the file cannot be written.
        """
        kinds = {kind.__name__: kind for kind in _kinds(Row)}
        if job in self._jobs:
            return [kinds[kind].model_validate(row) for kind, row in self._jobs[job]]
        rows = collect(make())
        if self._file is not None:
            line = [job, [[type(row).__name__, row.model_dump()] for row in rows]]
            try:
                # A concurrent run with the same options may have finished and deleted it.
                self._file.parent.mkdir(parents=True, exist_ok=True)
                with self._file.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")
            except OSError as error:
                raise RunError(f"cannot write {self._file}: {error.strerror}") from None
        return rows

    def all(self, jobs: Mapping[str, Callable[[], Iterable[Row]]]) -> list[Any]:
        """Return the rows of all jobs, in order."""
        return [row for name, make in jobs.items() for row in self.rows(name, make)]


def _read(file: Path) -> dict[str, list[Any]]:
    jobs = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            name, rows = json.loads(line)
        except ValueError:
            break  # Written while the run was stopped.
        jobs[name] = rows
    # Without the torn line, behind which nothing could be appended.
    whole = "".join(json.dumps([name, rows]) + "\n" for name, rows in jobs.items())
    file.write_text(whole, encoding="utf-8")
    return jobs


def _kinds(kind: type[Row]) -> Iterator[type[Row]]:
    yield kind
    for below in kind.__subclasses__():
        yield from _kinds(below)
