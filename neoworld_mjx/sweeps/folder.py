"""Output folder of a sweep: its rows, which survive an interruption, and what describes them."""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import arro3.io
from arro3.core import Array, DataType, Table
from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import RunError
from ..io import read_object, read_untrusted_text
from ..io.files import write_output
from ..io.text_files import strict_json, validation_message
from ..run_folder import LOCK, lock_folder, refuse_links
from .plan import plain_value
from .runs import COLUMNS, ITERATION_COLUMNS, KEYS, TERM, Key, Row

ROWS, ABOUT = "rows.jsonl", "sweep.json"
"""Names of the file to which completed runs are appended, and of the description of the sweep."""
RESULTS, HISTORIES = "results.parquet", "histories.parquet"
TABLE, CSV, FIGURE = "table.md", "table.csv", "figure.svg"
"""Names of the files that are written when the sweep ends: runs, iterations, and their summary."""
FORMAT = "neoworld-sweep/2"
_PARQUET_TYPES: dict[type, DataType] = {
    bool: DataType.bool(),
    int: DataType.int64(),
    float: DataType.float64(),
    str: DataType.utf8(),
}


class SweepFolder:
    """Output folder of a sweep, which is locked until it is closed.

    Use it in a `with` statement. If the sweep is resumed, `rows` contains the completed runs.
    """

    def __init__(self, path: Path | str, kind: str, *, resume: bool, overwrite: bool) -> None:
        """Create the folder, or continue in an existing one.

        Args:
            path: the folder.
            kind: "sweep" or "ablation".
            resume: keep the existing rows.
            overwrite: delete the files of an earlier sweep, but no other files.

        Raises:
            RunError: the path is a file, cannot be written, is in use, or contains files that must
                not be replaced.
        """
        self.path = Path(path)
        self.rows: list[Row] = []
        if self.path.exists() and not self.path.is_dir():
            raise RunError(f"{path} is a file; name a folder")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            refuse_links(self.path)
            existing = any(entry.name != LOCK for entry in self.path.iterdir())
            if existing:
                self._refuse_other_contents(kind)
            self._lock = lock_folder(self.path)
            try:
                if existing:
                    self._open_existing(kind, resume, overwrite)
                if not self.rows:
                    self.write_about({"format": FORMAT, "kind": kind, "finished": False})
            except BaseException:
                self._lock.close()
                raise
        except OSError as error:
            raise RunError(f"cannot write {path}: {error.strerror}") from None

    def __enter__(self) -> "SweepFolder":
        """Return this folder."""
        return self

    def __exit__(self, *error: object) -> None:
        """Unlock the folder."""
        self._lock.close()

    def _refuse_other_contents(self, kind: str) -> None:
        about = sweep_of(self.path)
        if about is None:
            raise RunError(f"{self.path} is not empty and holds no {kind}: name a new folder")
        if about["kind"] != kind:
            raise RunError(
                f"{self.path} holds another kind of run, {about['kind']}: name a new folder"
            )

    def _open_existing(self, kind: str, resume: bool, overwrite: bool) -> None:
        if overwrite:
            for name in (ROWS, RESULTS, HISTORIES, TABLE, CSV, FIGURE):
                (self.path / name).unlink(missing_ok=True)
        elif not resume:
            raise RunError(
                f"{self.path} holds a {kind}: continue with --resume, start over with --overwrite, "
                "or name a new folder"
            )
        else:
            self.rows = read_rows(self.path)

    def completed(self, expected: Mapping[Key, str]) -> dict[Key, Row]:
        """Return the rows that need not be computed again.

        Rows are found by their fingerprints, so the labels of their points may have changed.

        Args:
            expected: fingerprint of every requested run, by scene, point and seed.

        Raises:
            RunError: the folder contains rows of runs that are not requested. These rows would be
                lost.
        """
        rows = {row["fingerprint"]: row for row in self.rows}
        known = set(expected.values())
        lost = [
            row_key(row)
            for row in self.rows
            if row["fingerprint"] not in known and row_key(row) not in expected
        ]
        if lost:
            scene, point, seed = lost[0]
            raise RunError(
                f"{self.path} has {len(lost)} rows that this plan does not contain, such as scene "
                f"{scene}, point {point}, seed {seed}: use --overwrite, or name a new folder"
            )
        return {
            run: rows[fingerprint] for run, fingerprint in expected.items() if fingerprint in rows
        }

    def keep(self, rows: Sequence[Row]) -> None:
        """Replace the rows on the disk.

        Raises:
            RunError: the file cannot be written.
        """
        self.write(ROWS, "".join(map(_line, rows)))

    def add(self, row: Row) -> None:
        """Append a row to those on the disk.

        Raises:
            RunError: the file cannot be written.
        """
        try:
            with (self.path / ROWS).open("a", encoding="utf-8") as file:
                file.write(_line(row))
        except OSError as error:
            raise RunError(f"cannot write {self.path / ROWS}: {error.strerror}") from None

    def write_tables(self, rows: Sequence[Row], values: Sequence[str]) -> None:
        """Write all rows so far, and their iterations, as Parquet files.

        Args:
            rows: the runs, each with its iterations under "history".
            values: columns that distinguish points.

        Raises:
            RunError: a file cannot be written.
        """
        iterations = [
            {name: row[name] for name in KEYS} | step for row in rows for step in row["history"]
        ]
        further = (name for step in iterations for name in step if name not in ITERATION_COLUMNS)
        types = ITERATION_COLUMNS | dict.fromkeys(further, float)
        _write_parquet(self.path / HISTORIES, iterations, types)
        types = KEYS | {name: _column_type([row.get(name) for row in rows]) for name in values}
        types |= COLUMNS | dict.fromkeys(term_columns(rows), float)
        _write_parquet(self.path / RESULTS, rows, types)

    def write_about(self, about: Mapping[str, Any]) -> None:
        """Write sweep.json.

        Raises:
            RunError: the file cannot be written.
        """
        self.write(ABOUT, json.dumps(about, indent=1) + "\n")

    def write(self, name: str, text: str) -> None:
        """Write a text file.

        Raises:
            RunError: the file cannot be written.
        """
        write_output(self.path / name, text, RunError)


def sweep_of(path: Path) -> dict[str, Any] | None:
    """Return the content of a folder's sweep.json; None if the folder contains no sweep."""
    try:
        about = read_object(path / ABOUT, RunError)
    except RunError:
        return None
    known = about.get("format") == FORMAT and isinstance(about.get("kind"), str)
    return about if known else None


def read_rows(path: Path | str) -> list[Row]:
    """Read the runs in the folder of a sweep, each with its iterations under "history".

    The list is empty if the sweep ended before its first run was complete. A last line that a
    killed process left incomplete is not a row.

    Raises:
        RunError: the file cannot be read, or a line of it is no row.
    """
    file = Path(path) / ROWS
    if not file.exists():
        return []
    lines = read_untrusted_text(file, RunError).split("\n")[:-1]
    try:
        return [_KeptRow.model_validate_json(line).model_dump() for line in lines]
    except ValidationError as error:
        reason = validation_message(error, _KeptRow)
        raise RunError(f"{file} is damaged: {reason}; start over with --overwrite") from None


class _KeptRow(BaseModel):
    """A row as a line of rows.jsonl; its values are those of `runs.compute`."""

    model_config = ConfigDict(extra="allow")

    scene: str
    point: str
    seed: int
    fingerprint: str
    history: list[dict[str, float | None]]


def _line(row: Row) -> str:
    return json.dumps(strict_json(row)) + "\n"


def row_key(row: Mapping[str, Any]) -> Key:
    """Return the key of a row: scene, point and seed."""
    return row["scene"], row["point"], row["seed"]


def term_columns(rows: Sequence[Row]) -> list[str]:
    """Return the columns of the reward terms that not every run has, in their order in the rows."""
    return list(dict.fromkeys(name for row in rows for name in row if name.startswith(TERM)))


def _write_parquet(path: Path, rows: Sequence[Row], column_types: Mapping[str, type]) -> None:
    columns: dict[str, Any] = {
        name: Array([_cell(row.get(name), kind) for row in rows], type=_PARQUET_TYPES[kind])
        for name, kind in column_types.items()
    }
    data = io.BytesIO()
    arro3.io.write_parquet(Table.from_pydict(columns), data, compression="zstd(3)")
    write_output(path, data.getvalue(), RunError)


def _column_type(values: Sequence[Any]) -> type:
    """Return the type of a column that can contain all values of an axis."""
    types = {type(plain_value(value)) for value in values if value is not None}
    if types == {int, float}:
        return float
    return types.pop() if len(types) == 1 else str


def _cell(value: Any, kind: type) -> Any:
    if value is None:
        return None
    return kind(plain_value(value) if kind is str else value)
