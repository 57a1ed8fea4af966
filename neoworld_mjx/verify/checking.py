"""`neoworld check` of an object: a program, or a URDF or MJCF file from any source.

`build_patched` builds a program and applies its patch, for this and other commands.
"""

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..checks.object_tests import VERSION
from ..checks.signals import Allowance, Signal, has_errors
from ..config import Config, ProgramOptions
from ..errors import SpecError
from ..export import export_object
from ..export.importing import ImportedScene, import_file, only_object
from ..export.object_of_mechanism import Imported
from ..io import read_model, read_untrusted_text
from ..program import BuildResult, build
from ..spec import ObjectSpec
from .patch import Patch, apply, patch_path, read_patch, write_patch
from .verification import VerificationResult, verify_and_repair

MAX_PRINTED = 20
"""Number of lines of a program's output that a terminal shows."""


@dataclass(frozen=True)
class PatchedProgram:
    """The result of building a program and applying the program's patch."""

    text: str
    built: BuildResult
    patch: Patch | None = None
    """The patch; None if the program has no patch."""
    stale: tuple[str, ...] = ()
    """Parts, joints, geoms and materials that the patch edits but the object lacks."""


def build_patched(program: Path, options: ProgramOptions) -> PatchedProgram:
    """Build the program in a file, and apply the program's patch to the object.

    Args:
        program: the file.
        options: sandbox, limits and thresholds.

    Raises:
        SpecError: the program or patch cannot be read, or the patched object is invalid.
    """
    text = read_untrusted_text(program, SpecError)
    built = build(text, options)
    patch = read_patch(program)
    if patch is None or built.spec is None:
        return PatchedProgram(text, built, patch)
    spec, stale = apply(patch, built.spec)
    return PatchedProgram(text, replace(built, spec=spec), patch, stale)


def listings(printed: str, signals: Iterable[Signal], file: Path, text: str) -> list[str]:
    """Return lines for a terminal: a program's printed output and its signals."""
    lines = printed.splitlines()
    return [
        *(f"{file.name} printed: {line}" for line in lines[:MAX_PRINTED]),
        *([f"... and {len(lines) - MAX_PRINTED} more lines"] * (len(lines) > MAX_PRINTED)),
        *(signal.listing(str(file), text) for signal in signals),
    ]


def import_object(path: Path) -> Imported:
    """Read a URDF or MJCF file with one object, and possibly a floor and other surroundings.

    Raises:
        SpecError: the file has another format, contains several objects, is malformed, or exceeds
            the limits on size.
    """
    imported = import_file(path)
    if isinstance(imported, ImportedScene):
        lone = only_object(imported)
        if lone is not None:
            return lone
        names = ", ".join(item.name for item in imported.spec.objects[:8])
        raise SpecError(f"{path} contains several objects instead of one: {names}")
    return imported


def object_of_file(path: Path, options: ProgramOptions) -> ObjectSpec:
    """Read the object of a file: a program (.py), spec.json, URDF or MJCF.

    Raises:
        SpecError: the file cannot be read, or the program builds no object.
    """
    if path.suffix == ".json":
        return read_model(path, ObjectSpec, SpecError, "an object")
    if path.suffix != ".py":
        return import_object(path).spec
    built = build_patched(path, options).built
    if built.spec is None:
        reasons = "; ".join(signal.phrase() for signal in built.signals[:3])
        raise SpecError(f"{path} builds no object: {reasons}")
    return built.spec


def check_object(
    path: Path,
    config: Config,
    *,
    imported: Imported | None = None,
    fixed_base: bool = False,
    repair: bool = False,
    out: Path | None = None,
) -> dict[str, Any]:
    """Run the object tests on the object of a file, and repair the object on request.

    Args:
        path: a program (.py), URDF or MJCF file.
        config: options of programs and of the object tests.
        imported: content of the file if it has already been read; if None, the file is read.
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
    is_program, failed = path.suffix == ".py", False
    if is_program:
        patched = build_patched(path, config.program)
        built = patched.built
        failed = has_errors(built.signals)
        output["signals"] = [
            {"code": s.code, **s.model_dump(exclude_defaults=True)} for s in built.signals
        ]
        output["listing"] = listings(built.printed, built.signals, path, patched.text)
        if built.spec is None:
            return {**output, "passed": False, "checks": []}
        spec, allowed = built.spec, built.allowances
        if patched.patch is not None:
            output["overlay"] = {"file": str(patch_path(path)), "stale": list(patched.stale)}
    else:
        imported = imported or import_object(path)
        spec, output["notes"] = imported.spec, list(imported.notes)
        fixed_base = fixed_base or imported.fixed_base
    start = time.perf_counter()
    options = config.verify if repair else config.verify.model_copy(update={"rounds": 0})
    result = verify_and_repair(spec, options, fixed_base=fixed_base, allowed=allowed)
    output |= _report(result)
    output["seconds"] = round(time.perf_counter() - start, 3)
    if failed and result.patch.empty:
        # An object with errors of the compile checks fails, unless a patch repaired it.
        output["passed"] = False
    if repair and not result.patch.empty:
        if is_program:
            patch = (read_patch(path) or Patch()).merged_with(result.patch)
            output["patch"] = str(write_patch(path, patch))
        if out is not None:
            export_object(result.applied(spec), out)
            output["folder"] = str(out)
    return output


def _report(result: VerificationResult) -> dict[str, Any]:
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
            "before": list((result.before or verdict).faults),
            "changes": list(result.patch.changes()),
            "tried": list(result.tried),
        }
    return report
