"""Parquet files of rows, and processes that compute rows."""

import os
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Generic, TypeVar

from neoworld_mjx.errors import RunError
from neoworld_mjx.io.parquet_files import read_rows, write_rows

from .rows import Row, column_types

R = TypeVar("R", bound=Row)
Job = TypeVar("Job")
Made = TypeVar("Made")


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


def check_level(kept: RowFile[Any], noise: str) -> None:
    """Raise a RunError if a file has rows with another noise level."""
    for other in sorted({row.noise for row in kept.rows} - {noise}):
        raise RunError(
            f"{kept.file} has rows of --noise {other}: take another folder for --noise {noise}"
        )


def sized(workers: int) -> tuple[int, int]:
    """Return the number of processes, one for every two cores if 0, and the threads of each."""
    cores = os.cpu_count() or 1
    workers = workers or max(1, cores // 2)
    return workers, max(1, cores // workers)


def made_by_jobs(
    work: Callable[[Job], Iterable[Made]], jobs: Sequence[Job], workers: int
) -> Iterator[Made]:
    """Run jobs in separate processes, and yield results as they complete.

    Args:
        work: what to do, a function of a module; with one worker it is done here.
        jobs: what it is given.
        workers: number of processes.

    Raises:
        RunError: a process died.
    """
    if workers == 1:
        for job in jobs:
            yield from work(job)
        return
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        futures = [pool.submit(partial(_listed, work), job) for job in jobs]
        try:
            for future in as_completed(futures):
                yield from future.result()
        except BrokenProcessPool:
            raise RunError(
                "a process died, for want of memory perhaps; take fewer --workers, the rows that "
                "are there are kept"
            ) from None
        finally:
            # Whatever ends this early, such as Ctrl-C, ends what has not begun, too.
            pool.shutdown(wait=False, cancel_futures=True)


def _listed(work: Callable[[Job], Iterable[Made]], job: Job) -> list[Made]:
    from neoworld_mjx.cache import keep_compilations

    keep_compilations()
    return list(work(job))
