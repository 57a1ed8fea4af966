import importlib.util
import resource
import time
from pathlib import Path

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build

_spec = importlib.util.spec_from_file_location("hostile", Path(__file__).with_name("hostile.py"))
assert _spec is not None and _spec.loader is not None
_module = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_module)
HOSTILE, BODY = _module.HOSTILE, _module.BODY

FINE = BODY + "p.add(box((0.1, 0.1, 0.1)))\n"


LIMIT_MB = 100


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


@pytest.fixture(scope="module", autouse=True)
def memory_is_given_back():
    """What all of them together leave behind is small, too."""
    build(FINE)
    before = resident_mb()
    yield
    assert resident_mb() - before < LIMIT_MB


# The type check stops many before they start, so all run without it, and some with it.
CASES = [*((name, False) for name in HOSTILE), *((name, True) for name in list(HOSTILE)[::6])]


@pytest.mark.parametrize(("name", "type_check"), CASES)
def test_every_hostile_program_ends_in_a_signal(name: str, type_check: bool):
    text, codes = HOSTILE[name]
    memory, peak, start = resident_mb(), peak_mb(), time.monotonic()
    built = build(text, ProgramOptions(type_check=type_check))
    seconds = time.monotonic() - start
    assert built.signals, "no signal"
    assert {signal.code for signal in built.signals} <= codes | {"loose_shape", "heavy"}
    assert not built.ok
    assert seconds < 3.0
    assert peak_mb() == peak or peak_mb() - memory < LIMIT_MB
    assert build(FINE).ok, "the next program does not run"
    assert len(built.printed) < 30_000
