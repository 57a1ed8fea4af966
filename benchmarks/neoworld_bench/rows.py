"""Rows of results, and the file in which they are kept until a run has finished.

A repeated command continues an interrupted run. A run keeps its rows in a folder of the cache,
named after the suite, its options, the commit and the machine, and deletes it at the end.
"""

import dataclasses
import hashlib
import json
import logging
import platform
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from neoworld_mjx import __version__
from neoworld_mjx.cache import cache_folder
from neoworld_mjx.config import Config
from neoworld_mjx.errors import RunError
from neoworld_mjx.io.text_files import read_untrusted_text
from neoworld_mjx.sweeps.result import commit

log = logging.getLogger(__name__)

ROWS = "rows.jsonl"
"""Name of the file of rows in a folder of results."""
NOT_OPTIONS = {"json", "quiet", "verbose", "debug", "config", "set"}
"""Fields of a command that do not change its rows, or are in the configuration."""


class Row(BaseModel):
    """Base of the rows of results: frozen, closed against unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True)


R = TypeVar("R", bound=Row)
_Model = TypeVar("_Model", bound=BaseModel)


class RowStore:
    """Rows by key, in a file with a line of JSON for each key; of equal keys, the last line counts.

    A line is appended as soon as its rows are known. A line that was torn when the run was stopped
    is dropped.
    """

    def __init__(self, file: Path | None) -> None:
        """Read the rows of a file, and create its folder; None keeps rows in memory alone.

        Raises:
            RunError: the folder cannot be made, or the file cannot be read.
        """
        self.file = file
        self._lines: dict[str, list[list[Any]]] = {}
        if file is None:
            return
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(f"cannot make {file.parent}: {error.strerror}") from None
        if file.exists():
            self._read(file)

    @property
    def folder(self) -> Path | None:
        """Folder of the file."""
        return None if self.file is None else self.file.parent

    def put(self, key: str, rows: Sequence[Row]) -> None:
        """Keep rows in place of those with the same key.

        Raises:
            RunError: the file cannot be written.
        """
        self._lines.pop(key, None)
        self._lines[key] = [[type(row).__name__, row.model_dump()] for row in rows]
        if self.file is None:
            return
        try:
            # A concurrent run with the same options may have finished and deleted the folder.
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with self.file.open("a", encoding="utf-8") as file:
                file.write(json.dumps([key, self._lines[key]]) + "\n")
        except OSError as error:
            raise RunError(f"cannot write {self.file}: {error.strerror}") from None

    def rows(self, key: str, make: Callable[[], Iterable[Row]]) -> list[Any]:
        """Return the rows of a key: those that are kept, or else new ones, which are then kept.

        Args:
            key: unique in the run.
            make: makes the rows.
        """
        if key in self._lines:
            kinds = {kind.__name__: kind for kind in _kinds(Row)}
            return [self._row(kinds[kind], row) for kind, row in self._lines[key]]
        made = collect(make())
        self.put(key, made)
        return made

    def all(self, jobs: Mapping[str, Callable[[], Iterable[Row]]]) -> list[Any]:
        """Return the rows of all jobs, in order; see `rows`."""
        return [row for key, make in jobs.items() for row in self.rows(key, make)]

    def of(self, kind: type[R]) -> list[R]:
        """Return all kept rows of a kind.

        Raises:
            RunError: rows of the kind have other fields.
        """
        return [
            self._row(kind, row)
            for rows in self._lines.values()
            for name, row in rows
            if name == kind.__name__
        ]

    def _row(self, kind: type[R], row: Any) -> R:
        try:
            return kind.model_validate(row)
        except ValidationError as error:
            problem = error.errors()[0]
            where = ".".join(map(str, problem["loc"]))
            raise RunError(
                f"{self.file} has a {kind.__name__} of another version, {where}: {problem['msg']}; "
                "name a new folder"
            ) from None

    def _read(self, file: Path) -> None:
        lines = read_untrusted_text(file, RunError, "rows").splitlines()
        for line in lines:
            try:
                key, rows = json.loads(line)
                self._lines.pop(str(key), None)
                self._lines[str(key)] = [[str(kind), row] for kind, row in rows]
            except (ValueError, TypeError):
                if line is not lines[-1]:
                    raise RunError(f"{file} is no file of rows: name a new folder") from None
                whole = "".join(json.dumps([*pair]) + "\n" for pair in self._lines.items())
                file.write_text(whole, encoding="utf-8")


def _kinds(kind: type[Row]) -> Iterator[type[Row]]:
    yield kind
    for below in kind.__subclasses__():
        yield from _kinds(below)


@contextmanager
def kept_rows(options: Any, config: Config | None = None) -> Iterator[RowStore]:
    """Yield the rows of a run that an earlier, interrupted one has made; delete them at the end.

    Args:
        options: of the suite.
        config: of the run, for suites that take one.
    """
    values = {
        field.name: repr(getattr(options, field.name))
        for field in dataclasses.fields(options)
        if field.name not in NOT_OPTIONS
    }
    plain_config = None if config is None else config.model_dump(mode="json")
    code = commit() or __version__
    identity = json.dumps([values, plain_config, code, platform.node()], sort_keys=True)
    name = type(options).__name__.removeprefix("Bench").lower()
    digest = hashlib.sha256(identity.encode()).hexdigest()[:16]
    folder = cache_folder() / "bench" / f"{name}-{digest}"
    try:
        store = RowStore(folder / ROWS)
    except RunError as error:
        log.warning(f"rows are not kept until the end: {error}")
        yield RowStore(None)
        return
    if any(folder.iterdir()):
        log.warning(f"continuing an interrupted run; delete {folder} to begin anew")
    try:
        yield store
    except BaseException:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
        raise
    shutil.rmtree(folder, ignore_errors=True)


def collect(rows: Iterable[_Model]) -> list[_Model]:
    """Return all rows, and log each as soon as it is known."""
    collected = []
    for row in rows:
        collected.append(row)
        fields = {k: v for k, v in row.model_dump().items() if v not in (None, "", [], "ok")}
        log.info(", ".join(f"{key} {_short(value)}" for key, value in fields.items()))
    return collected


def plain(rows: Iterable[BaseModel]) -> list[dict[str, Any]]:
    """Return rows as JSON."""
    return [row.model_dump() for row in rows]


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
