"""Developer suite of programs."""

import pytest

from benchmarks.programs import CABINET, cabinet_times
from benchmarks.programs import programs as bench
from neoworld_mjx.program import build
from tests.support import hostile
from tests.support.mutants import crashed, programs


def test_cabinet_program_is_valid():
    built = build(CABINET)
    assert built.spec is not None and built.signals == ()
    assert len(built.spec.parts) == 30
    assert sum(joint.type != "fixed" for joint in built.spec.joints) == 8


@pytest.mark.slow
def test_suite_reports_times():
    times = cabinet_times(1)
    assert (times["parts"], times["joints"], times["signals"]) == (30, 8, [])
    assert all(times[key] > 0 for key in ("warm_build_ms", "checks_ms", "export_ms"))


def test_uncontained_programs_are_reported(monkeypatch):
    monkeypatch.setitem(hostile.HOSTILE, "harmless", (hostile.FINE, {"value"}))
    assert "no signal" in hostile.contain("harmless").why
    monkeypatch.setitem(hostile.HOSTILE, "other", ("1 / 0", {"timeout"}))
    assert hostile.contain("other").why == "signals runtime"


def test_crash_of_a_mutant_is_reported(monkeypatch):
    monkeypatch.setattr("neoworld_mjx.program.sandbox.assemble", lambda objects: 1 / 0)
    assert crashed(seed=0, count=20)
    assert len(programs()) >= 8


@pytest.mark.slow
def test_result_has_all_documented_keys(monkeypatch):
    two = dict(list(hostile.HOSTILE.items())[:2])
    monkeypatch.setattr("benchmarks.programs.HOSTILE", two)
    monkeypatch.setattr("benchmarks.programs.VESSELS", ["tray", "mortar"])
    result = bench(mutations=10, repeats=1)
    assert result["cavities_total"] == result["cavities_that_hold"] == 2
    assert result["hostile_total"] == result["hostile_contained"] == 2
    assert (result["mutations_total"], result["mutation_crashes"]) == (10, 0)
    assert {"warm_build_ms", "checks_ms", "export_ms", "machine"} <= set(result)
