"""A program that the machine hardly let run is run once more, by its processor time."""

import os
import signal

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program.call_clock import CallClock, process_time
from neoworld_mjx.program.monty_sandbox import Starved, run_sandboxed
from neoworld_mjx.program.sandbox import run
from neoworld_mjx.program.session import Session

GOOD = """
from neoworld_mjx.program.sdk import Object, box

block = Object("block")
block.part("body", material="wood").add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.05))
"""
ENDLESS = "while True:\n    pass\n"

pytestmark = pytest.mark.skipif(
    process_time(os.getpid()) is None, reason="the system tells no processor times"
)


@pytest.fixture
def stopped(monkeypatch):
    """Stop the first worker as soon as it is handed over; return the workers so far."""
    workers = []
    original = CallClock.watch_worker

    def watch_worker(self, pid, *limit):
        original(self, pid, *limit)
        workers.append(pid)
        if len(workers) == 1:
            os.kill(pid, signal.SIGSTOP)

    monkeypatch.setattr(CallClock, "watch_worker", watch_worker)
    return workers


def test_a_program_that_did_not_get_to_run_is_run_again(stopped):
    built = run(GOOD, ProgramOptions(timeout_s=0.3))
    assert built.ok, built.signals
    assert [part.name for part in built.spec.parts] == ["body"]
    assert len(set(stopped)) == 2


def test_an_endless_program_ends_though_it_is_waited_for(stopped):
    built = run(ENDLESS, ProgramOptions(timeout_s=0.3))
    assert [signal.code for signal in built.signals] == ["timeout"]
    assert len(stopped) == 2 and built.seconds < 5.0


def test_a_program_that_ran_is_not_starved(stopped):
    stopped.append(None)  # None of its workers is the first.
    built = run(ENDLESS, ProgramOptions(timeout_s=0.3))
    assert [signal.code for signal in built.signals] == ["timeout"]
    assert len(stopped) == 2


def test_a_stopped_worker_is_told_from_a_slow_program(stopped):
    with pytest.raises(Starved):
        run_sandboxed(ENDLESS, Session(), ProgramOptions(timeout_s=0.3))
