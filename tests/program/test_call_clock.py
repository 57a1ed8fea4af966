"""Calls of the SDK end on time, whatever they do, by the processor time of their own thread."""

import subprocess
import sys
import time

import pytest

from neoworld_mjx.program.call_clock import CallClock, CallInterrupted
from neoworld_mjx.program.session import LimitExceeded, Session


def spin(seconds: float) -> int:
    """Use up processor time of this thread."""
    end, count = time.thread_time() + seconds, 0
    while time.thread_time() < end:
        count += 1
    return count


def test_a_call_that_never_ends_is_ended():
    session = Session(max_seconds=0.1, clock=CallClock())
    assert session.clock is not None
    with session.clock.watching():
        with pytest.raises(LimitExceeded, match=r"building the shapes took over 0\.1 s"):
            with session.call():
                spin(60.0)
        assert session.exceeded is not None
        with pytest.raises(LimitExceeded), session.call():
            pass
    spin(0.01)  # Nothing comes after.


def test_a_call_that_catches_everything_is_ended():
    session = Session(max_seconds=0.1, clock=CallClock())
    assert session.clock is not None
    with session.clock.watching(), pytest.raises(LimitExceeded), session.call():
        try:
            spin(60.0)
        except Exception:
            pytest.fail("it was caught")


def test_calls_that_end_in_time_are_not_interrupted():
    clock = CallClock()
    with clock.watching():
        for _ in range(20):
            with clock.limited(1.0):
                spin(0.002)
        with clock.limited(0.05):
            time.sleep(0.3)  # Waiting is no processor time.


def test_a_late_interruption_is_cancelled():
    clock = CallClock()
    for _ in range(50):
        with clock.limited(1.0):
            clock._interrupted = True
    spin(0.01)


def test_other_threads_do_not_use_up_a_call_s_time():
    neighbours = [
        subprocess.Popen([sys.executable, "-c", "while True:\n    pass"]) for _ in range(3)
    ]
    try:
        clock = CallClock()
        with clock.watching():
            with clock.limited(0.4):
                spin(0.1)
            with pytest.raises(CallInterrupted), clock.limited(0.1):
                spin(60.0)
    finally:
        for process in neighbours:
            process.kill()
            process.wait()
