"""Rows by seed: kept in a log, joined from shards, and never lost to a crash or a hang."""

import pytest

from benchmarks import seed_rows
from benchmarks.seed_rows import log_row, logged_rows, rows_of_seeds

MODULE = """
import json, os, sys, time
first, count = int(sys.argv[1]), int(sys.argv[2])
for seed in range(first, first + count):
    if seed == 3 and "crash" in sys.argv:
        sys.exit("the reason\\x1b[31m")
    if seed == 3 and "spin" in sys.argv:
        if os.fork():
            time.sleep(100)
        while True:
            pass
    if seed == 3 and "sleep" in sys.argv:
        time.sleep(float(sys.argv[-1]))
    print(json.dumps({"seed": seed, "pid": os.getpid(), "wrong": ""}), flush=True)
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "rows_by_seed.py").write_text(MODULE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "rows_by_seed"


def test_a_shard_continues_and_joined_shards_are_the_whole(module, tmp_path):
    shards = [tmp_path / "0.jsonl", tmp_path / "1.jsonl"]
    first = rows_of_seeds(module, range(2), file=shards[0])
    with shards[0].open("a") as torn:
        torn.write('{"seed": 2, "wr')
    rows = rows_of_seeds(module, range(4), file=shards[0])
    assert rows[:2] == first
    assert rows[2]["pid"] != first[0]["pid"]
    assert [row["seed"] for row in rows] == [0, 1, 2, 3]
    rows_of_seeds(module, range(5, 8), file=shards[1])
    joined = tmp_path / "all.jsonl"
    joined.write_text("".join(shard.read_text() for shard in shards))
    whole = rows_of_seeds(module, range(9), file=joined)
    assert [row["seed"] for row in whole] == list(range(9))
    assert whole[:4] == rows
    # 4 and 8 were missing; each was made by a process of its own.
    assert len({row["pid"] for row in whole}) == 5


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("crash", "ended with code 1: the reason"),
        ("spin", "no result within 0.5 s of processor time"),
        ("sleep", "no result within 4 s"),
    ],
)
def test_a_crash_or_hang_is_a_row_and_the_others_follow(module, monkeypatch, tmp_path, word, said):
    monkeypatch.setattr(seed_rows, "HANG_S", 0.5)
    monkeypatch.setattr(seed_rows, "WALL_S", 4.0 if word == "sleep" else 600.0)
    rows = rows_of_seeds(module, range(2, 6), (word, "100"), tmp_path / "log.jsonl")
    assert [row["seed"] for row in rows] == [2, 3, 4, 5]
    assert said in rows[1]["wrong"]
    assert "\x1b" not in rows[1]["wrong"]
    assert [row["wrong"] for row in (rows[0], *rows[2:])] == ["", "", ""]


def test_time_in_which_others_use_the_core_is_not_counted(module, monkeypatch):
    monkeypatch.setattr(seed_rows, "HANG_S", 0.5)
    assert [row["wrong"] for row in rows_of_seeds(module, range(2, 5), ("sleep", "3"))] == [""] * 3


def test_a_log_of_other_rows(tmp_path):
    log_row(None, {"key": 1})
    log_row(tmp_path / "log", {"key": 1})
    assert logged_rows(tmp_path / "log") == [{"key": 1}]
    assert logged_rows(None) == logged_rows(tmp_path / "missing") == []
