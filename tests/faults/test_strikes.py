"""One fault of each kind.

The slow ones have fast tests of their own: a server that is slow or answers nonsense in tests/mllm,
clocks in tests/program/test_call_clock.py, two runs on a folder in tests/test_run_folder.py.
"""

import json
import os
import subprocess
import sys

import pytest

from tests.faults.strikes import FAULTS, SEARCH_FAULTS

FEW = FAULTS.index("slow provider")
"""Number of the faults whose runs the default suite strikes: kills, disks and a lost provider."""


def strikes(first: int, count: int, *until: str) -> dict[str, dict]:
    """Return the outcomes of seeds, from a process without threads, which can be forked."""
    return {row["fault"]: row for row in rows_of("tests.faults.strikes", first, count, *until)}


def rows_of(module: str, first: int, count: int, *words: str) -> list[dict]:
    """Return the rows that a module prints for seeds."""
    command = [sys.executable, "-m", module, str(first), str(count), *words]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": "."}
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def struck():
    """The outcomes of the first seeds."""
    return strikes(0, FEW)


@pytest.fixture(scope="module")
def other_struck():
    """The outcomes of the next seeds."""
    return strikes(FEW, len(FAULTS) - FEW)


@pytest.mark.parametrize("fault", FAULTS[:FEW])
def test_a_run_resumes_after_a_fault_with_the_same_files(struck, fault):
    assert struck[fault]["wrong"] == "", struck[fault]


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS[FEW:])
def test_a_run_resumes_after_another_fault_with_the_same_files(other_struck, fault):
    assert other_struck[fault]["wrong"] == "", other_struck[fault]


@pytest.mark.slow
def test_a_search_continues_if_the_engine_returns_nan():
    fault = "engine NaN"
    row = strikes(SEARCH_FAULTS.index(fault), 1, "refine")[fault]
    assert row["moment"] == "a rollout" and row["wrong"] == "", row


@pytest.mark.slow
def test_a_search_that_ctrl_c_interrupts_is_resumed():
    (row,) = rows_of("tests.faults.interrupted_searches", 0, 1, "coffee.png")
    assert (row["moment"], row["wrong"]) == ("in the refinement", ""), row
