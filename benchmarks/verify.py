"""Fault matrix: kinds and magnitudes of faults in valid objects; detected, named, repaired.

`faults` contradict physics or a declared intent. Of them, `detected` failed the object tests, and
`named` did so with the right fault as the cause. `false_alarms` are valid objects that failed. The
faint magnitudes contradict nothing and are part of the curve alone.
"""

import os
import time
from collections.abc import Iterator, Sequence
from functools import partial
from statistics import median
from typing import Any

from neoworld_bench.machine import machine
from neoworld_bench.rows import collect
from pydantic import BaseModel

from benchmarks.suites import Verify
from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.errors import ConfigError, choices
from neoworld_mjx.places import Place, run_tasks
from neoworld_mjx.spec import ObjectSpec
from neoworld_mjx.verify.repairs import repair
from tests.support.injected_faults import KINDS, Kind
from tests.support.valid_objects import valid_objects


class FaultRow(BaseModel):
    """One fault in one object."""

    object: str
    kind: str
    magnitude: float
    counts: bool
    """True if it contradicts physics or an intent; a slight fault does not."""
    detected: bool
    named: bool
    cause: str = ""
    found: list[str] = []
    repairable: bool = False
    repaired: bool | None = None
    worse: bool = False
    """True if the repair left a higher fault score."""
    changes: list[str] = []


class ValidRow(BaseModel):
    """One valid object."""

    object: str
    joints: int
    passed: bool
    found: list[str] = []
    battery_s: float


def verify_matrix(
    objects: int | None = None,
    kinds: Sequence[str] = (),
    *,
    with_repair: bool = True,
    workers: int = 0,
) -> Iterator[ValidRow | FaultRow]:
    """Run the object tests on valid objects, then on each of them with each fault.

    Args:
        objects: number of valid objects; None is all.
        kinds: names of kinds of faults; none is all.
        with_repair: whether to repair the faults that can be repaired.
        workers: processes; 0 is one a core.

    Raises:
        ConfigError: a kind is unknown.
    """
    known = {kind.name: kind for kind in KINDS}
    for name in kinds:
        if name not in known:
            raise ConfigError(f"kind of fault: {choices(name, list(known))}")
    specs = list(valid_objects(objects))
    for spec in specs:
        yield _sound(spec)
    tasks = [
        (spec, kind, magnitude, with_repair)
        for kind in (known[name] for name in kinds or known)
        for spec in specs
        for magnitude in _magnitudes(kind)
    ]
    place = Place(workers=workers or os.cpu_count() or 1)
    yield from run_tasks(_faults, [_sent(task) for task in tasks], place)


def _faults(sent: tuple[str, str, float, bool]) -> Iterator[FaultRow]:
    row = _fault(*sent)
    if row is not None:
        yield row


def _magnitudes(kind: Kind) -> list[float]:
    faint = [] if kind.faint is None else [kind.faint]
    # A kind without magnitudes, such as a reversed axis, has one run.
    return [*faint, *dict.fromkeys(kind.magnitudes)]


def _sent(task: tuple[ObjectSpec, Kind, float, bool]) -> tuple[str, str, float, bool]:
    spec, kind, magnitude, with_repair = task
    return spec.to_json(), kind.name, magnitude, with_repair


def _sound(spec: ObjectSpec) -> ValidRow:
    start = time.perf_counter()
    verdict = run_object_tests(spec).verdict
    return ValidRow(
        object=spec.name,
        joints=sum(joint.type != "fixed" for joint in spec.joints),
        passed=verdict.passed,
        found=[str(fault) for fault in verdict.faults],
        battery_s=round(time.perf_counter() - start, 3),
    )


def _fault(text: str, name: str, magnitude: float, with_repair: bool) -> FaultRow | None:
    """Inject one fault into one object; None if the object cannot have it."""
    spec = ObjectSpec.model_validate_json(text)
    kind = next(kind for kind in KINDS if kind.name == name)
    broken = kind.inject(spec, magnitude)
    if broken is None:
        return None
    run = partial(run_object_tests, threads=1)
    first = run(broken)
    verdict = first.verdict
    row = FaultRow(
        object=spec.name,
        kind=name,
        magnitude=magnitude,
        counts=magnitude != kind.faint,
        detected=not verdict.passed,
        named=verdict.cause in kind.causes,
        cause=str(verdict.cause or ""),
        found=[str(fault) for fault in verdict.faults],
        repairable=kind.repairable and magnitude != kind.faint,
    )
    if not (with_repair and row.repairable and row.detected):
        return row
    repaired = repair(broken, run, first=first)
    return row.model_copy(
        update={
            "repaired": repaired.after.passed,
            "worse": repaired.after.score > repaired.before.score,
            "changes": list(repaired.patch.changes()),
        }
    )


def summary(rows: Sequence[ValidRow | FaultRow]) -> dict[str, Any]:
    """Summarize rows; each share has its denominator."""
    valid = [row for row in rows if isinstance(row, ValidRow)]
    faults = [row for row in rows if isinstance(row, FaultRow)]
    counted = [row for row in faults if row.counts]
    repairable = [row for row in counted if row.repairable]
    attempted = [row for row in repairable if row.repaired is not None]
    share = lambda part, whole: round(part / whole, 4) if whole else None
    detected, named = sum(r.detected for r in counted), sum(r.named for r in counted)
    alarms = sum(not row.passed for row in valid)
    repaired = sum(bool(row.repaired) for row in repairable)
    return {
        "objects": len(valid),
        "kinds": len({row.kind for row in counted}),
        "faults": len(counted),
        "detected": detected,
        "detected_share": share(detected, len(counted)),
        "named": named,
        "named_share": share(named, len(counted)),
        "false_alarms": alarms,
        "false_alarms_share": share(alarms, len(valid)),
        "repairable": len(repairable),
        "repair_tried": len(attempted),
        "repaired": repaired,
        "repaired_share": share(repaired, len(repairable)),
        "made_worse": sum(row.worse for row in faults),
        "battery_s": median(row.battery_s for row in valid) if valid else None,
        "battery_max_s": max((row.battery_s for row in valid), default=None),
        "matrix": [
            _line(kind, faults) for kind in KINDS if any(r.kind == kind.name for r in faults)
        ],
        "sound": [row.model_dump() for row in valid],
        "missed": [
            {"object": r.object, "kind": r.kind, "magnitude": r.magnitude, "cause": r.cause}
            for r in counted
            if not (r.detected and r.named)
        ],
        "unrepaired": [
            {"object": r.object, "kind": r.kind, "magnitude": r.magnitude}
            for r in attempted
            if not r.repaired
        ],
    }


def _line(kind: Kind, rows: list[FaultRow]) -> dict[str, Any]:
    own = [row for row in rows if row.kind == kind.name]
    counted = [row for row in own if row.counts]
    curve = []
    for magnitude in _magnitudes(kind):
        at_magnitude = [row for row in own if row.magnitude == magnitude]
        if at_magnitude:
            curve.append(
                {
                    "magnitude": magnitude,
                    "counts": magnitude != kind.faint,
                    "n": len(at_magnitude),
                    "detected": sum(row.detected for row in at_magnitude),
                    "named": sum(row.named for row in at_magnitude),
                    "repaired": sum(bool(row.repaired) for row in at_magnitude),
                }
            )
    return {
        "kind": kind.name,
        "n": len(counted),
        "detected": sum(row.detected for row in counted),
        "named": sum(row.named for row in counted),
        "repaired": sum(bool(row.repaired) for row in counted) if kind.repairable else None,
        "unit": kind.unit,
        "curve": curve,
    }


def run_suite(o: Verify) -> dict[str, Any]:
    """Inject faults into valid objects."""
    rows = collect(verify_matrix(o.objects, o.kind, with_repair=not o.no_repair, workers=o.workers))
    return {**summary(rows), "machine": machine()}
