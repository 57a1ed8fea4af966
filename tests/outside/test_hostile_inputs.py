"""A few of the generated hostile inputs; `python -m benchmarks inputs` reads a thousand."""

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.hostile_inputs import KINDS, Watcher, contained


@pytest.mark.parametrize("seed", range(2 * len(KINDS)))
def test_generated_inputs_are_contained(seed):
    assert contained(seed).wrong == ""


@settings(max_examples=20, deadline=None, derandomize=True, database=None)
@given(st.integers(min_value=0, max_value=10**9))
def test_inputs_of_any_seed_are_contained(seed):
    assert contained(seed).wrong == ""


def test_the_watcher_sees_what_is_touched_outside(tmp_path):
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
        with watcher.watching(home) as seen:
            act()
        assert len(seen) == 1, seen
    with watcher.watching(home) as seen:
        (home / "a").write_text("a", encoding="utf-8")
        (tmp_path / "home" / "a").read_text(encoding="utf-8")
    assert seen == []
