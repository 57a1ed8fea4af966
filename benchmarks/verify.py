"""The fault matrix: kinds of faults times magnitudes on sound objects; found, named, mended.

What is counted: `detected` of `faults` that contradict physics or a declared intent failed the
battery; `named` had the right name for a cause; `false_alarms` are sound objects that failed. The
faint magnitudes contradict nothing and stand in the curve alone.
"""

import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from statistics import median
from typing import Any

from pydantic import BaseModel

from benchmarks.suites import Verify
from neoworld_mjx.bench.machine import machine
from neoworld_mjx.bench.rows import collect
from neoworld_mjx.errors import ConfigError, choices
from neoworld_mjx.spec import ObjectSpec
from neoworld_mjx.verify.battery import Battery
from neoworld_mjx.verify.repairs import repair
from tests.support.injected import KINDS, Kind
from tests.support.sound import sound_objects


class FaultRow(BaseModel):
    """One fault in one object."""

    object: str
    kind: str
    magnitude: float
    counts: bool
    """Whether it contradicts anything; a faint one does not."""
    detected: bool
    named: bool
    cause: str = ""
    found: list[str] = []
    repairable: bool = False
    repaired: bool | None = None
    worse: bool = False
    """Whether the repair left a higher fault score."""
    changes: list[str] = []


class SoundRow(BaseModel):
    """One sound object."""

    object: str
    joints: int
    passed: bool
    found: list[str] = []
    battery_s: float


def verify_matrix(
    objects: int | None = None,
    kinds: Sequence[str] = (),
    *,
    mend: bool = True,
    workers: int = 0,
) -> Iterator[SoundRow | FaultRow]:
    """Try sound objects, then each of them with each fault.

    Args:
        objects: how many; None is all.
        kinds: names of kinds; none is all.
        mend: whether what can be repaired is.
        workers: processes; 0 is one a core.

    Raises:
        ConfigError: a kind is unknown.
    """
    known = {kind.name: kind for kind in KINDS}
    for name in kinds:
        if name not in known:
            raise ConfigError(f"kind of fault: {choices(name, list(known))}")
    made = list(sound_objects(objects))
    for spec in made:
        yield _sound(spec)
    tasks = [
        (spec, kind, magnitude, mend)
        for kind in (known[name] for name in kinds or known)
        for spec in made
        for magnitude in _magnitudes(kind)
    ]
    workers = workers or os.cpu_count() or 1
    if workers == 1:
        yield from (row for task in tasks if (row := _fault(*_sent(task))) is not None)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for row in pool.map(_fault, *zip(*map(_sent, tasks), strict=True), chunksize=4):
            if row is not None:
                yield row


def _magnitudes(kind: Kind) -> list[float]:
    faint = [] if kind.faint is None else [kind.faint]
    # A kind without degrees, such as an axis reversed, is tried once.
    return [*faint, *dict.fromkeys(kind.magnitudes)]


def _sent(task: tuple[ObjectSpec, Kind, float, bool]) -> tuple[str, str, float, bool]:
    spec, kind, magnitude, mend = task
    return spec.to_json(), kind.name, magnitude, mend


def _sound(spec: ObjectSpec) -> SoundRow:
    start = time.perf_counter()
    verdict = Battery(spec).verdict
    return SoundRow(
        object=spec.name,
        joints=sum(joint.type != "fixed" for joint in spec.joints),
        passed=verdict.passed,
        found=[str(fault) for fault in verdict.faults],
        battery_s=round(time.perf_counter() - start, 3),
    )


def _fault(text: str, name: str, magnitude: float, mend: bool) -> FaultRow | None:
    """Put one fault into one object; None where the object has nothing to put it into."""
    spec = ObjectSpec.model_validate_json(text)
    kind = next(kind for kind in KINDS if kind.name == name)
    broken = kind.inject(spec, magnitude)
    if broken is None:
        return None
    run = lambda spec: Battery(spec, threads=1)
    first = run(broken)
    verdict = first.verdict
    row = FaultRow(
        object=spec.name,
        kind=name,
        magnitude=magnitude,
        counts=magnitude != kind.faint,
        detected=not verdict.passed,
        named=verdict.cause in kind.means,
        cause=str(verdict.cause or ""),
        found=[str(fault) for fault in verdict.faults],
        repairable=kind.repairable and magnitude != kind.faint,
    )
    if not (mend and row.repairable and row.detected):
        return row
    made = repair(broken, run, first=first)
    return row.model_copy(
        update={
            "repaired": made.after.passed,
            "worse": made.after.score > made.before.score,
            "changes": list(made.changes),
        }
    )


def summary(rows: Sequence[SoundRow | FaultRow]) -> dict[str, Any]:
    """Count rows up; each share stands beside what it is a share of."""
    sound = [row for row in rows if isinstance(row, SoundRow)]
    faults = [row for row in rows if isinstance(row, FaultRow)]
    counted = [row for row in faults if row.counts]
    fixable = [row for row in counted if row.repairable]
    tried = [row for row in fixable if row.repaired is not None]
    share = lambda part, whole: round(part / whole, 4) if whole else None
    detected, named = sum(r.detected for r in counted), sum(r.named for r in counted)
    alarms = sum(not row.passed for row in sound)
    repaired = sum(bool(row.repaired) for row in fixable)
    return {
        "objects": len(sound),
        "kinds": len({row.kind for row in counted}),
        "faults": len(counted),
        "detected": detected,
        "detected_share": share(detected, len(counted)),
        "named": named,
        "named_share": share(named, len(counted)),
        "false_alarms": alarms,
        "false_alarms_share": share(alarms, len(sound)),
        "repairable": len(fixable),
        "repair_tried": len(tried),
        "repaired": repaired,
        "repaired_share": share(repaired, len(fixable)),
        "made_worse": sum(row.worse for row in faults),
        "battery_s": median(row.battery_s for row in sound) if sound else None,
        "battery_max_s": max((row.battery_s for row in sound), default=None),
        "matrix": [
            _line(kind, faults) for kind in KINDS if any(r.kind == kind.name for r in faults)
        ],
        "sound": [row.model_dump() for row in sound],
        "missed": [
            {"object": r.object, "kind": r.kind, "magnitude": r.magnitude, "cause": r.cause}
            for r in counted
            if not (r.detected and r.named)
        ],
        "unrepaired": [
            {"object": r.object, "kind": r.kind, "magnitude": r.magnitude}
            for r in tried
            if not r.repaired
        ],
    }


def _line(kind: Kind, rows: list[FaultRow]) -> dict[str, Any]:
    own = [row for row in rows if row.kind == kind.name]
    counted = [row for row in own if row.counts]
    curve = []
    for magnitude in _magnitudes(kind):
        here = [row for row in own if row.magnitude == magnitude]
        if here:
            curve.append(
                {
                    "magnitude": magnitude,
                    "counts": magnitude != kind.faint,
                    "n": len(here),
                    "detected": sum(row.detected for row in here),
                    "named": sum(row.named for row in here),
                    "repaired": sum(bool(row.repaired) for row in here),
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


__all__ = ["FaultRow", "SoundRow", "summary", "verify_matrix"]


def answer(o: Verify) -> dict[str, Any]:
    """Put faults into valid objects."""
    rows = collect(verify_matrix(o.objects, o.kind, mend=not o.no_repair, workers=o.workers))
    return {**summary(rows), "machine": machine()}
