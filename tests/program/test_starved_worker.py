"""A program that the machine hardly let run, or charged too much, is run once more."""

import os
import signal
import time

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program.call_clock import CallClock, process_time
from neoworld_mjx.program.monty_sandbox import WorkerStarved, run_sandboxed
from neoworld_mjx.program.sandbox import run
from neoworld_mjx.program.sdk_object import Object
from neoworld_mjx.program.session import Session, current

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


def test_a_starved_program_runs_again(stopped):
    built = run(GOOD, ProgramOptions(timeout_s=0.3))
    assert built.ok, built.signals
    assert [part.name for part in built.spec.parts] == ["body"]
    assert len(set(stopped)) == 2


def test_an_endless_program_ends_in_the_patient_run(stopped):
    built = run(ENDLESS, ProgramOptions(timeout_s=0.3))
    assert [signal.code for signal in built.signals] == ["timeout"]
    assert len(stopped) == 2 and built.seconds < 5.0


def test_a_program_that_ran_is_not_starved(stopped):
    stopped.append(None)  # None of its workers is the first.
    built = run(ENDLESS, ProgramOptions(timeout_s=0.3))
    assert [signal.code for signal in built.signals] == ["timeout"]
    assert len(stopped) == 2


def test_a_stopped_worker_is_distinguished_from_a_slow_program(stopped):
    with pytest.raises(WorkerStarved):
        run_sandboxed(ENDLESS, Session(), ProgramOptions(timeout_s=0.3))


@pytest.fixture
def charged(monkeypatch):
    """Return the sessions so far; the first so many calls in `slow` cost 0.5 s of the thread."""
    sessions, slow = [], []
    original = Object.part

    def part(self, *args, **kwargs):
        session = current()
        if session not in sessions:
            sessions.append(session)
        end = time.thread_time() + (0.5 if len(sessions) <= sum(slow) else 0.0)
        while time.thread_time() < end:
            pass
        return original(self, *args, **kwargs)

    monkeypatch.setattr(Object, "part", part)
    return sessions, slow


@pytest.mark.parametrize(("slow_runs", "codes"), [(1, []), (9, ["timeout"])])
def test_shapes_that_time_out_once_are_built_again(charged, slow_runs, codes):
    sessions, slow = charged
    slow.append(slow_runs)
    built = run(GOOD, ProgramOptions(timeout_s=0.3))
    assert [signal.code for signal in built.signals] == codes
    assert len(sessions) == 2 and built.ok == (not codes)
