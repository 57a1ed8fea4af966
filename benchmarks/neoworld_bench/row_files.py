"""Parquet files of rows."""

from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

from neoworld_mjx.errors import RunError
from neoworld_mjx.io.parquet_files import read_rows, write_rows

from .rows import Row, column_types

R = TypeVar("R", bound=Row)


class RowFile(Generic[R]):
    """Rows of one kind, in a file that is rewritten with every new row; None stores no file."""

    def __init__(self, file: Path | None, kind: type[R], key: Callable[[R], Hashable]) -> None:
        """Read existing rows, and create the folder.

        Raises:
            RunError: the folder cannot be made, or the file cannot be read.
        """
        self.file, self._kind, self._key = file, kind, key
        self.rows: list[R] = []
        if file is None:
            return
        if file.exists():
            self.rows = stored_rows(file, kind)
            return
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(f"cannot make {file.parent}: {error.strerror}") from None

    def put(self, rows: Sequence[R], *, in_place_of: Hashable) -> None:
        """Add rows in place of those with a key.

        Raises:
            RunError: the file cannot be written.
        """
        self.rows = [row for row in self.rows if self._key(row) != in_place_of] + list(rows)
        if self.file is not None:
            plain = [row.model_dump() for row in self.rows]
            write_rows(self.file, plain, column_types(self._kind), RunError)


def stored_rows(file: Path, kind: type[R]) -> list[R]:
    """Read the rows of a file.

    Raises:
        RunError: it cannot be read, or has rows of another kind.
    """
    rows = read_rows(file, list(column_types(kind)), RunError)
    return [kind.model_validate(row) for row in rows]


def check_level(file: RowFile[Any], noise: str) -> None:
    """Raise a RunError if a file has rows with another noise level."""
    for other in sorted({row.noise for row in file.rows} - {noise}):
        raise RunError(
            f"{file.file} has rows of --noise {other}: take another folder for --noise {noise}"
        )
