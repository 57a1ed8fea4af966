"""Ten faults, one of each kind; `python -m benchmarks faults` injects two hundred."""

import json
import os
import subprocess
import sys

import pytest

from tests.faults.strikes import FAULTS, SEARCH_FAULTS


def strikes(first: int, count: int, *until: str) -> dict[str, dict]:
    """Return the outcomes of seeds, from a process without threads, which can be forked."""
    command = [sys.executable, "-m", "tests.faults.strikes", str(first), str(count), *until]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": "."}
    )
    assert done.returncode == 0, done.stderr
    return {row["fault"]: row for row in map(json.loads, done.stdout.splitlines())}


@pytest.fixture(scope="module")
def struck():
    """The outcomes of the first ten seeds."""
    return strikes(0, len(FAULTS))


@pytest.mark.parametrize("fault", FAULTS)
def test_a_run_resumes_after_a_fault_with_the_same_files(struck, fault):
    assert struck[fault]["wrong"] == "", struck[fault]


@pytest.mark.slow
def test_a_search_continues_if_the_engine_returns_nan():
    fault = "engine NaN"
    row = strikes(SEARCH_FAULTS.index(fault), 1, "refine")[fault]
    assert row["moment"] == "a rollout" and row["wrong"] == "", row
