"""`neoworld check` of an object: a program, a URDF or an MJCF file, whoever wrote it."""

import time
from pathlib import Path
from typing import Any

from ..config import Config
from ..errors import SpecError
from ..export import export_object
from ..export.checked_xml import read_xml
from ..export.importing import Imported, import_mjcf, import_urdf
from ..program.allowance import Allowance
from ..spec import ObjectSpec
from .battery import VERSION
from .patch import overlay_path, read_overlay, write_overlay
from .patched import build_patched
from .verdict import Check, Verdict
from .verification import VerificationResult, verify_and_repair

OBJECTS = (".py", ".urdf", ".xml", ".mjcf")
"""Suffixes of files that hold an object."""


def import_object(path: Path) -> Imported:
    """Read a URDF or MJCF file, told apart by what it begins with.

    Raises:
        SpecError: it is neither, broken, or hostile.
    """
    root = read_xml(path)
    readers = {"robot": import_urdf, "mujoco": import_mjcf}
    if root.tag not in readers:
        raise SpecError(
            f"{path} begins with <{root.tag}>: a URDF with <robot>, an MJCF with <mujoco>"
        )
    try:
        return readers[root.tag](path)
    except SpecError as error:
        told = str(error)
        raise SpecError(told if path.name in told else f"{path}: {told}") from None


def check_object(
    path: Path,
    config: Config,
    *,
    fixed_base: bool = False,
    mend: bool = False,
    out: Path | None = None,
) -> dict[str, Any]:
    """Try the object of a file, and mend it if asked to.

    Args:
        path: a program (.py), URDF or MJCF.
        config: of programs and of the battery.
        fixed_base: whether the base stays fastened.
        mend: whether direct repairs are tried; the patch of a program is kept beside it.
        out: folder for the mended object in every format; None writes none.

    Returns:
        What `neoworld check --json` prints.

    Raises:
        SpecError: the file cannot be used.
        ExportError: the mended object cannot be written.
    """
    if out is not None and not mend:
        raise SpecError("--out takes the mended object: give --repair with it")
    answer: dict[str, Any] = {"target": str(path)}
    spec: ObjectSpec
    allowed: tuple[Allowance, ...] = ()
    if path.suffix == ".py":
        made = build_patched(path, config.program)
        built = made.built
        signals = [{"code": s.code, **s.model_dump(exclude_defaults=True)} for s in built.signals]
        answer["signals"] = signals
        if built.spec is None:
            return {**answer, "passed": False, "checks": []}
        spec = built.spec
        allowed = built.allowances
        if made.patch is not None:
            answer["overlay"] = {"file": str(overlay_path(path)), "stale": list(made.stale)}
    else:
        found = import_object(path)
        spec, answer["notes"] = found.spec, list(found.notes)
    start = time.perf_counter()
    options = config.verify if mend else config.verify.model_copy(update={"rounds": 0})
    result = verify_and_repair(spec, options, fixed_base=fixed_base, allowed=allowed)
    answer |= told(result)
    answer["seconds"] = round(time.perf_counter() - start, 3)
    if path.suffix == ".py" and any(s.get("severity") == "error" for s in answer["signals"]):
        # What the program's own checks hold against it counts as well, unless a patch cured it.
        answer["passed"] = answer["passed"] and not result.patch.empty
    if mend and not result.patch.empty:
        if path.suffix == ".py":
            kept = read_overlay(path)
            patch = result.patch if kept is None else kept.joined(result.patch)
            answer["patch"] = str(write_overlay(path, patch))
        if out is not None:
            export_object(result.applied(spec), out)
            answer["folder"] = str(out)
    return answer


def told(result: VerificationResult) -> dict[str, Any]:
    """Return what a result says, for people and programs."""
    verdict = result.verdict
    answer: dict[str, Any] = {
        "object": verdict.object,
        "passed": verdict.passed,
        "cause": verdict.cause,
        "faults": list(verdict.faults),
        "score": round(verdict.score, 3),
        "mass_kg": verdict.mass_kg,
        "battery": VERSION,
        "counts": counts(verdict),
        "checks": [c.model_dump(mode="json", exclude_defaults=True) for c in _worst_first(verdict)],
    }
    if result.tried:
        before = result.before or verdict
        answer["repair"] = {
            "before": list(before.faults),
            "changes": list(result.changes),
            "tried": list(result.tried),
        }
    return answer


def _worst_first(verdict: Verdict) -> list[Check]:
    order = ("FAIL", "TOOL_FAILURE", "PASS", "SKIP")
    place = lambda check: (order.index(check.outcome), not check.doubtful)
    return sorted(verdict.checks, key=place)


def counts(verdict: Verdict) -> dict[str, int]:
    """Return how many checks came out how, and how many of those that passed are doubtful."""
    outcomes = [check.outcome for check in verdict.checks]
    found = {name: outcomes.count(name) for name in ("PASS", "FAIL", "SKIP", "TOOL_FAILURE")}
    return found | {"doubtful": len(verdict.doubtful)}


__all__ = ["OBJECTS", "check_object", "import_object", "told"]
