"""Generated hostile inputs, read in a fresh process."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.hostile_inputs import KINDS, Watcher


def read_in_a_process(first: int, count: int) -> list[dict]:
    """Return the outcomes of some seeds; memory of earlier tests does not count."""
    process = subprocess.run(
        [sys.executable, "-m", "tests.support.hostile_inputs", str(first), str(count)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return [json.loads(line) for line in process.stdout.splitlines()]


@pytest.fixture(scope="module")
def outcomes() -> list[dict]:
    return read_in_a_process(0, len(KINDS))


@pytest.mark.parametrize("seed", range(len(KINDS)), ids=list(KINDS))
def test_an_input_of_each_kind_is_contained(outcomes, seed):
    assert (outcomes[seed]["seed"], outcomes[seed]["wrong"]) == (seed, "")


@pytest.mark.slow
def test_many_inputs_are_contained():
    outcomes = read_in_a_process(len(KINDS), 20 * len(KINDS))
    assert len(outcomes) == 20 * len(KINDS)
    assert [outcome for outcome in outcomes if outcome["wrong"]] == []


def test_the_watcher_records_accesses_outside_the_folder(tmp_path):
    home, outside = tmp_path / "home", tmp_path / "outside"
    home.mkdir()
    outside.mkdir()
    watcher = Watcher()
    acts = [
        lambda: (outside / "a").write_text("a", encoding="utf-8"),
        lambda: os.rename(outside / "a", home / "a"),
        lambda: (outside / "b").mkdir(),
        lambda: os.rmdir(outside / "b"),
        lambda: os.open(home / ".." / "outside" / "c", os.O_WRONLY | os.O_CREAT),
        lambda: Path(outside / "c").unlink(),
    ]
    for act in acts:
        with watcher.watching(home) as accesses:
            act()
        assert len(accesses) == 1, accesses
    with watcher.watching(home) as accesses:
        (home / "a").write_text("a", encoding="utf-8")
        (tmp_path / "home" / "a").read_text(encoding="utf-8")
    assert accesses == []
