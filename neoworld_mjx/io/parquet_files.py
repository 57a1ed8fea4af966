"""Reader and writer of Parquet files whose columns have plain types."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import arro3.io
from arro3.core import Array, DataType, Table

from ..errors import NeoWorldError, RunError
from .files import MIB, read_bytes, write_output
from .limited_worker import call_limited, file_bounds
from .text_files import MAX_VALUES

MAX_ROWS = 500_000
_TYPES: dict[type, Any] = {
    bool: DataType.bool(),
    int: DataType.int64(),
    float: DataType.float64(),
    str: DataType.utf8(),
}


def write_rows(
    path: Path,
    rows: Sequence[Mapping[str, Any]],
    kinds: Mapping[str, type],
    error: type[NeoWorldError],
) -> None:
    """Write rows to a Parquet file, and replace an existing file atomically.

    Args:
        path: the file.
        rows: value of each column, for each row; a value has the column's type or is None.
        kinds: type of each column (bool, int, float or str), in the order of the columns.
        error: class of the error to raise.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be written.
    """
    table = Table.from_pydict(
        {
            name: Array([row.get(name) for row in rows], type=_TYPES[kind])
            for name, kind in kinds.items()
        }
    )
    data = io.BytesIO()
    arro3.io.write_parquet(table, data, compression="zstd(3)")
    write_output(path, data.getvalue(), error)


def read_rows(
    path: Path, required: Sequence[str], error: type[NeoWorldError]
) -> list[dict[str, Any]]:
    """Return the rows of a Parquet file.

    Args:
        path: the file.
        required: columns that the file must have.
        error: class of the error to raise.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be read, is not a Parquet file, is
            damaged, lacks a column, or has over `MAX_ROWS` rows or `MAX_VALUES` values.
    """
    # A file of a few bytes can expand to any number of rows.
    return call_limited(_read_rows, path, tuple(required), error=error)


def _read_rows(path: Path, required: Sequence[str]) -> list[dict[str, Any]]:
    try:
        data = read_bytes(path, file_bounds().max_file_mib * MIB)
    except OSError as failure:
        raise RunError(f"cannot read {path}: {failure.strerror}") from None
    if data[:4] != b"PAR1" or data[-4:] != b"PAR1":
        raise RunError(f"{path} is not a Parquet file")
    rows: list[dict[str, Any]] = []
    try:
        reader = arro3.io.read_parquet(io.BytesIO(data))
        names = list(reader.schema.names)
        for batch in reader:
            count = len(rows) + batch.num_rows
            if count > MAX_ROWS or count * len(names) > MAX_VALUES:
                raise RunError(f"{path} holds over {MAX_ROWS} rows, or over {MAX_VALUES} values")
            columns = [column.to_pylist() for column in batch.columns]
            rows += [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
    except (KeyboardInterrupt, SystemExit, MemoryError, RunError):
        raise
    except BaseException as failure:  # A panic of the Rust reader raises no Exception.
        raise RunError(
            f"{path} is damaged ({type(failure).__name__}); start over with --overwrite"
        ) from None
    missing = sorted(set(required) - set(names))
    if missing:
        raise RunError(f"{path} has no column {missing[0]}; start over with --overwrite")
    return rows
