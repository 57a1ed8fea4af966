"""Rows of Parquet files."""

import pytest
from neoworld_bench.row_files import RowFile, stored_rows
from neoworld_bench.rows import Row

from neoworld_mjx.errors import RunError


class Kept(Row):
    """A row."""

    name: str
    value: float | None


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
