import ctypes
import gc
import resource

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build
from tests.support.hostile import FINE, HOSTILE, MEGABYTES, contain, resident_mb


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def kept_mb() -> float:
    """Return what stays resident once the garbage of earlier tests, too, is given back."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    return resident_mb()


@pytest.fixture(scope="module", autouse=True)
def memory_is_given_back():
    """What all of them together leave behind is small, too."""
    build(FINE)
    before = kept_mb()
    yield
    assert kept_mb() - before < MEGABYTES


# The type check stops many before they start, so all run without it, and some with it.
CASES = [*((name, False) for name in HOSTILE), *((name, True) for name in list(HOSTILE)[::6])]


# An interruption that meets the garbage collector is ignored there, and repeated.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(("name", "type_check"), CASES)
def test_every_hostile_program_ends_in_a_signal(name: str, type_check: bool):
    memory, peak = resident_mb(), peak_mb()
    # On a busy machine the bound of 3 s says nothing; `python -m benchmarks programs` holds it.
    # Run-time type checks of the tests slow the SDK down; this one needs most of a second anyway.
    seconds = 5.0 if name == "long_chain" else 1.0
    options = ProgramOptions(type_check=type_check, timeout_s=seconds)
    end = contain(name, options, within_s=20.0)
    assert end.why == ""
    assert peak_mb() == peak or peak_mb() - memory < MEGABYTES


def test_printed_output_is_bounded():
    for name in ("print_bomb", "long_string"):
        assert len(build(HOSTILE[name][0]).printed) < 30_000
