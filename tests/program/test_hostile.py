import ctypes
import gc
import resource

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build
from tests.support.hostile import FINE, HOSTILE, MEGABYTES, STOPPED, contain, resident_mb


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


ALIKE = {
    "squaring": "power",
    "sieve_again_and_again": "sieve",
    "million_boxes_caught": "call_flood_caught",
    "comb_extrusions": "heavy_lathes",
    "distance_flood": "call_flood",
    "material_flood": "part_flood",
    "million_holes": "million_boxes",
    "catch_everything": "endless_catch",
    "sleep_loop": "endless_loop",
}
"""Programs that use up their time, by one that is stopped in the same way, sooner."""
# The type check stops many before they start, so all run without it, and some with it.
CASES = [
    pytest.param(name, checked, marks=[pytest.mark.slow] if name in ALIKE else [])
    for checked, names in ((False, [*HOSTILE]), (True, [*HOSTILE][::6]))
    for name in names
]


# An interruption that meets the garbage collector is ignored there, and repeated.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(("name", "type_check"), CASES)
def test_every_hostile_program_ends_in_a_signal(name: str, type_check: bool):
    memory, peak = resident_mb(), peak_mb()
    # Run-time type checks of the tests slow the SDK down; this one needs most of a second anyway.
    seconds = 5.0 if name == "long_chain" else 1.0
    if HOSTILE[name][1] == STOPPED:
        seconds = 0.5
    options = ProgramOptions(type_check=type_check, timeout_s=seconds)
    end = contain(name, options, within_s=20.0)
    assert end.why == ""
    assert peak_mb() == peak or peak_mb() - memory < MEGABYTES


def test_a_program_that_runs_slowly_has_one_like_it():
    assert ALIKE.keys() | set(ALIKE.values()) <= HOSTILE.keys()
    assert not ALIKE.keys() & set(ALIKE.values())


def test_printed_output_is_bounded():
    for name in ("print_bomb", "long_string"):
        assert len(build(HOSTILE[name][0]).printed) < 30_000
