"""Fault matrix on a few objects; the full one is `python -m benchmarks verify`."""

import numpy as np
import pytest

from benchmarks.battery import OnCores, agreement, batteries, prepare
from benchmarks.verify import FaultRow, ValidRow, summary, verify_matrix
from neoworld_mjx.checks.verdict import Fault
from neoworld_mjx.config import VerifyOptions
from neoworld_mjx.errors import ConfigError, EngineError
from tests.support.injected_faults import KINDS
from tests.support.valid_objects import FAMILIES, valid_objects


def test_fault_matrix_covers_enough_objects_and_kinds():
    assert sum(len(family.sizes) for family in FAMILIES.values()) >= 30
    assert len(KINDS) >= 12
    assert all(len(kind.magnitudes) == 3 for kind in KINDS)
    assert {fault for kind in KINDS for fault in kind.causes} <= set(Fault)


def test_valid_objects_are_deterministic():
    first, second = list(valid_objects(4)), list(valid_objects(4))
    assert first == second
    assert len({spec.name for spec in first}) == 4


@pytest.mark.slow
def test_fault_matrix_row():
    rows = list(verify_matrix(2, ("no_damping", "limits_into_carcass"), workers=1))
    counts = summary(rows)
    assert counts["objects"] == 2
    assert counts["false_alarms"] == 0
    assert counts["faults"] == counts["detected"] == counts["named"] == 12
    assert counts["repairable"] == counts["repaired"] == 12
    assert counts["made_worse"] == 0
    assert counts["battery_s"] > 0
    (line, _) = counts["matrix"]
    faint = next(point for point in line["curve"] if not point["counts"])
    assert faint["n"] == 2
    assert sum(isinstance(row, ValidRow) for row in rows) == 2


def test_undetected_faults_count_as_missed():
    rows = [
        ValidRow(object="a", joints=1, passed=False, battery_s=1.0),
        FaultRow(object="a", kind="mass", magnitude=20.0, counts=True, detected=True, named=False,
                 repairable=True, repaired=False, worse=True),
        FaultRow(object="a", kind="mass", magnitude=100.0, counts=True, detected=False, named=False,
                 repairable=True),
        FaultRow(object="a", kind="mass", magnitude=3.0, counts=False, detected=False, named=False),
    ]  # fmt: skip
    counts = summary(rows)
    assert (counts["faults"], counts["detected"], counts["named"]) == (2, 1, 0)
    assert (counts["false_alarms"], counts["made_worse"]) == (1, 1)
    # What was not found was not mended either, and stays in the denominator.
    assert (counts["repairable"], counts["repaired"], counts["repaired_share"]) == (2, 0, 0.0)
    assert len(counts["missed"]) == 2


def test_unknown_fault_kinds_are_refused():
    with pytest.raises(ConfigError, match="no_damping"):
        list(verify_matrix(1, ("no_dampin",)))


def test_batched_and_single_objects_have_equal_results():
    options = VerifyOptions(duration_s=0.5)
    prepared = [prepare(spec, options) for spec in valid_objects(2)]
    for p, ends in zip(prepared, OnCores(prepared, 2).run(), strict=True):
        alone = p.simulation.run(p.runs, threads=1)
        assert np.array_equal(ends, [trace.qpos[-1] for trace in alone])
        assert not any(run.world == "gripping" for run in p.runs)
    nudged = [
        prepared[0].starts[:, 1 : 1 + prepared[0].simulation.model.nq].copy() for _ in range(2)
    ]
    nudged[1][0, 2] += 0.01
    agrees = agreement(prepared[:1], nudged[1:], nudged[:1])
    assert agrees.tolist() == [False] + [True] * (len(agrees) - 1)


def test_batched_rows_report_their_settings():
    (row,) = batteries(2, ("native",))
    assert (row.objects, row.models, row.failed, row.status) == (2, 2, 0, "ok")
    assert row.runs > 20 and row.steps > 500
    assert row.simulate_s > 0 and row.same_end is None


def test_too_many_objects_raise():
    with pytest.raises(EngineError, match="there are 128, not 129"):
        list(batteries(129))
    with pytest.raises(EngineError, match="1 to 31"):
        list(batteries(2, together=32))
