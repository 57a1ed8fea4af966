"""`neoworld check` of an object: a program, or a URDF or MJCF file from any source."""

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..checks.object_tests import VERSION
from ..checks.signals import Allowance, Signal, has_errors
from ..config import Config
from ..errors import SpecError
from ..export import export_object
from ..export.object_of_mechanism import Imported
from .patch import Patch, patch_path, write_patch
from .read_target import PatchedProgram
from .repairs import Repair
from .verification import verify_and_repair

MAX_PRINTED = 20
"""Number of lines of a program's output that a terminal shows."""


def listings(printed: str, signals: Iterable[Signal], file: Path, text: str) -> list[str]:
    """Return lines for a terminal: a program's printed output and its signals."""
    lines = printed.splitlines()
    return [
        *(f"{file.name} printed: {line}" for line in lines[:MAX_PRINTED]),
        *([f"... and {len(lines) - MAX_PRINTED} more lines"] * (len(lines) > MAX_PRINTED)),
        *(signal.listing(str(file), text) for signal in signals),
    ]


def check_object(
    path: Path,
    target: Imported | PatchedProgram,
    config: Config,
    *,
    fixed_base: bool = False,
    repair: bool = False,
    out: Path | None = None,
) -> dict[str, Any]:
    """Run the object tests on the object of a file, and repair the object on request.

    Args:
        path: a program (.py), URDF or MJCF file, or an object's folder.
        target: its content.
        config: options of the object tests.
        fixed_base: if True, the base is fixed, as it also is if the file fixes it to the world.
        repair: if True, try direct repairs. The patch of a program is written next to the program.
        out: folder for the repaired object in every format; if None, the object is not written.

    Returns:
        The JSON object that `neoworld check --json` prints.

    Raises:
        SpecError: the file or the options cannot be used.
        ExportError: the repaired object cannot be written.
    """
    if out is not None and not repair:
        raise SpecError("--out writes the repaired object, so it requires --repair")
    output: dict[str, Any] = {"target": str(path)}
    allowed: tuple[Allowance, ...] = ()
    program, failed = target if isinstance(target, PatchedProgram) else None, False
    if program is not None:
        built = program.built
        failed = has_errors(built.signals)
        output["signals"] = [
            {"code": s.code, **s.model_dump(exclude_defaults=True)} for s in built.signals
        ]
        output["listing"] = listings(built.printed, built.signals, program.file, program.text)
        if program.patched is None:
            return {**output, "passed": False, "checks": []}
        allowed = built.allowances
        if program.patch is not None:
            output["overlay"] = {
                "file": str(patch_path(program.file)),
                "stale": list(program.stale),
            }
    elif isinstance(target, Imported):
        output["notes"] = list(target.notes)
        fixed_base = fixed_base or target.fixed_base
    start = time.perf_counter()
    options = config.verify if repair else config.verify.model_copy(update={"rounds": 0})
    result = verify_and_repair(target.spec, options, fixed_base=fixed_base, allowed=allowed)
    output |= _report(result)
    output["seconds"] = round(time.perf_counter() - start, 3)
    if failed and result.patch.empty:
        # An object with errors of the compile checks fails, unless a patch repaired it.
        output["passed"] = False
    if repair and not result.patch.empty:
        if program is not None:
            patch = (program.patch or Patch()).merged_with(result.patch)
            output["patch"] = str(write_patch(program.file, patch))
        if out is not None:
            export_object(result.spec, out)
            output["folder"] = str(out)
    return output


def _report(result: Repair) -> dict[str, Any]:
    """Return a result as a JSON object: verdict, counts, checks (the worst first) and repairs."""
    verdict = result.verdict
    outcomes = [check.outcome for check in verdict.checks]
    order = ("FAIL", "TOOL_FAILURE", "PASS", "SKIP")
    worst_first = sorted(
        verdict.checks, key=lambda check: (order.index(check.outcome), not check.borderline)
    )
    report: dict[str, Any] = {
        "object": verdict.object,
        "passed": verdict.passed,
        **({} if verdict.cause is None else {"cause": verdict.cause}),
        "faults": list(verdict.faults),
        "score": round(verdict.score, 3),
        "mass_kg": verdict.mass_kg,
        "battery": VERSION,
        "counts": {name: outcomes.count(name) for name in ("PASS", "FAIL", "SKIP", "TOOL_FAILURE")}
        | {"doubtful": len(verdict.borderline)},
        "checks": [
            check.model_dump(mode="json", exclude_defaults=True) | {"phrase": check.phrase()}
            for check in worst_first
        ],
    }
    if result.tried:
        report["repair"] = {
            "before": list(result.before.faults),
            "changes": list(result.patch.changes()),
            "tried": list(result.tried),
        }
    return report
