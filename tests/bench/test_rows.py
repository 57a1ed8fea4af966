"""Rows of results: kept as they come, and taken over by the same command."""

import pytest
from neoworld_bench import suites
from neoworld_bench.rows import ROWS, Row, RowStore, kept_rows


class CountedRow(Row):
    """A row."""

    name: str
    value: float | None


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "bench"


def jobs(made, stop_at=None):
    def make(name):
        def rows():
            if name == stop_at:
                raise KeyboardInterrupt
            made.append(name)
            yield CountedRow(name=name, value=0.1 + len(name))
            yield CountedRow(name=name, value=None)

        return rows

    return {name: make(name) for name in ("a", "bb", "ccc")}


def run(made, stop_at=None, options=None, config=None):
    with kept_rows(options or suites.Rescues(), config) as store:
        return store.all(jobs(made, stop_at))


def test_an_interrupted_run_continues_and_a_finished_one_leaves_nothing(cache):
    made = []
    with pytest.raises(KeyboardInterrupt):
        run(made, stop_at="ccc")
    assert made == ["a", "bb"] and len(list(cache.iterdir())) == 1
    rows = run(made)
    assert made == ["a", "bb", "ccc"]
    assert [(row.name, row.value) for row in rows] == [
        *(("a", 1.1), ("a", None), ("bb", 2.1), ("bb", None), ("ccc", 3.1), ("ccc", None))
    ]
    assert list(cache.iterdir()) == []


def test_rows_replace_those_with_the_same_key(tmp_path):
    file = tmp_path / "new" / ROWS
    store = RowStore(file)
    for name, value in (("a", 1.0), ("b", None), ("a", float("inf"))):
        store.put(name, [CountedRow(name=name, value=value)])
    for read in (store, RowStore(file)):
        assert [(row.name, row.value) for row in read.of(CountedRow)] == [
            ("b", None),
            ("a", float("inf")),
        ]
    assert RowStore(None).of(CountedRow) == []
