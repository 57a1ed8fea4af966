"""Rows of Parquet files, and the processes that compute them."""

import os

import pytest
from neoworld_bench.row_files import RowFile, made_by_jobs, sized, stored_rows
from neoworld_bench.rows import Row

from neoworld_mjx.errors import RunError


class Kept(Row):
    """A row."""

    name: str
    value: float | None


def squares(number: int) -> list[int]:
    return [number, number**2]


def dying(number: int) -> list[int]:
    os._exit(number)


def test_rows_replace_those_with_the_same_key(tmp_path):
    file = tmp_path / "new" / "rows.parquet"
    kept = RowFile(file, Kept, lambda row: row.name)
    kept.put([Kept(name="a", value=1.0)], in_place_of="a")
    kept.put([Kept(name="b", value=None)], in_place_of="b")
    kept.put([Kept(name="a", value=3.0)], in_place_of="a")
    assert stored_rows(file, Kept) == kept.rows == RowFile(file, Kept, lambda r: r.name).rows
    assert {(row.name, row.value) for row in kept.rows} == {("a", 3.0), ("b", None)}
    nowhere = RowFile(None, Kept, lambda row: row.name)
    nowhere.put(kept.rows, in_place_of=None)
    assert nowhere.rows == kept.rows
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="cannot make"):
        RowFile(tmp_path / "file" / "rows.parquet", Kept, lambda row: row.name)


def test_one_worker_runs_jobs_in_this_process():
    assert list(made_by_jobs(squares, [2, 3], 1)) == [2, 4, 3, 9]
    workers, threads = sized(0)
    assert workers >= 1 and threads >= 1 and sized(10_000)[1] == 1


@pytest.mark.slow
def test_several_workers_run_jobs_in_processes():
    assert sorted(made_by_jobs(squares, [2, 3], 2)) == [2, 3, 4, 9]
    with pytest.raises(RunError, match="a process died"):
        list(made_by_jobs(dying, [3, 4], 2))
