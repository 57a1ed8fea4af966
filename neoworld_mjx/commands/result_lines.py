"""Short summaries of command results: verdict with reasons, files, time and cost."""

import shutil
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..quantities import count
from .base_command import CommandResult

DETAILS = "details: -v, or --json"
MAX_REASONS = 5
_MIN_COLUMNS, _MAX_COLUMNS = 60, 110


def run_lines(result: CommandResult) -> list[str]:
    """Summarize a reconstruction or a refinement."""
    from ..run_folder import CAMERA_NOTE, verdict_line

    rows = [verdict_line(result)]
    if result["passed"] is None:
        rows = [f"{rows[0]}: {reasons(result['objects'], ', ')} in {result['folder']}"]
    if result.get("scene"):
        rows.append(f"scene:  {result['scene']}  ({count(result['objects'], 'object')})")
    rows.append(f"report: {result['report']}")
    agreement = result.get("box_iou") or {}
    if agreement.get("refined") is not None:
        worst = agreement.get("worst") or {}
        low = f", worst {worst['name']} {worst['value']:.2f}" if worst.get("name") else ""
        rows.append(f"photo:  mean box IoU {agreement['refined']:.2f}{low}")
    rows += [
        f"camera: {note['why']}" for note in result.get("notes", ()) if note["what"] == CAMERA_NOTE
    ]
    fallbacks = [f"{e['step']}: {e['what']}: {e['why']}" for e in result["fallbacks"]]
    if fallbacks:
        rows += [f"{count(fallbacks, 'fallback')}:", *_indented(fallbacks)]
    rows.append(f"{_time(result)}; {_cost(result['mllm'])}; {DETAILS}")
    return rows


def scene_check_lines(result: CommandResult) -> list[str]:
    """Summarize the check of a scene."""
    from ..run_folder import verdict_line

    notes = [f"note: {note}" for note in result.get("notes", ())[:MAX_REASONS]]
    drawn = []
    if (samples := result.get("samples")) is not None:
        failing = [f"{reason} in {k}" for reason, k in samples["failing"].items()]
        stand = f"samples: stands in {samples['stand']} of {samples['draws']}"
        drawn = ["; ".join([stand, *failing[:MAX_REASONS]])]
    return [verdict_line(result), *drawn, f"scene: {result['target']}", *notes, DETAILS]


def object_check_lines(result: CommandResult) -> list[str]:
    """Summarize the check of an object."""
    from ..checks.verdict import BUDGET

    rows = list(result.get("listing", ()))
    if "object" not in result:
        return [*rows, f"not valid: {result['target']} does not build"]
    counts = result["counts"]
    ran = counts["PASS"] + counts["FAIL"] + counts["TOOL_FAILURE"]
    failed = [e for e in result["checks"] if e["outcome"] in ("FAIL", "TOOL_FAILURE")]
    if result["passed"]:
        borderline = f", {counts['doubtful']} of them borderline" if counts["doubtful"] else ""
        rows.append(f"valid: {result['object']} passes all {ran} checks{borderline}")
    else:
        why = f"{len(failed)} of {ran} checks fail" if failed else "its program has errors"
        likely = f", the likely cause is {result['cause']}" if result.get("cause") else ""
        rows.append(f"not valid: {result['object']}: {why}{likely}")
    rows += _indented(
        [
            " ".join(entry[key] for key in ("scenario", "part", "joint") if key in entry)
            + f": {entry['phrase']}"
            + (f"; hint: {entry['hint']}" if "hint" in entry else "")
            for entry in failed
        ]
    )
    rows += [f"not tested: {e['hint']}" for e in result["checks"] if e["name"] == BUDGET]
    if (repair := result.get("repair")) is not None:
        rows.append(f"repair: {reasons(repair['changes']) or 'no repair succeeded'}")
    rows += [f"{key}: {result[key]}" for key in ("patch", "folder") if key in result]
    rows.append(f"{result['mass_kg']:.3g} kg; {result['seconds']:.2f} s; {DETAILS}")
    return rows


def export_lines(result: CommandResult) -> list[str]:
    """Summarize an export."""
    rows = [f"written: {count(result['files'], 'file')} in {result['folder']}"]
    for kind, unsupported in result["lost"].items():
        if unsupported:
            rows.append(f"lost in {kind}: {reasons(unsupported)}")
    rows += [f"note: {note}" for note in result.get("notes", ())[:MAX_REASONS]]
    if "collider_error_mm" in result:
        rows.append(f"colliders differ by up to {result['collider_error_mm']} mm")
    return [*rows, DETAILS]


def sweep_lines(result: CommandResult) -> list[str]:
    """Summarize a sweep or an ablation."""
    points = result["points"]
    valid = sum(point.get("passed", 0) * point.get("n", 0) for point in points)
    best = max(points, key=lambda point: point.get("reward") or float("-inf"), default=None)
    passed = f"{valid:.0f} of them passed the final check"
    rows = [f"{count(result['runs'], 'run')}, {passed}, in {result['folder']}"]
    if best is not None and best.get("reward") is not None:
        rows.append(f"best reward: {best['reward']:.4g} at {best['point']}")
    rows.append(f"table: {result['table']}")
    if result.get("figure"):
        rows.append(f"figure: {result['figure']}")
    rows.append(f"{result['seconds']:.1f} s; {DETAILS}")
    return rows


def reasons(entries: Iterable[str], separator: str = "; ") -> str:
    """Join at most `MAX_REASONS` entries, and state the number of the others."""
    listed = list(entries)
    omitted = f"{separator}and {len(listed) - MAX_REASONS} more" * (len(listed) > MAX_REASONS)
    return separator.join(listed[:MAX_REASONS]) + omitted


def wrapped(entries: Iterable[str]) -> list[str]:
    """Join entries by commas and wrap them to the terminal's width, without breaking entries."""
    columns = shutil.get_terminal_size((_MAX_COLUMNS, 24)).columns
    width = min(max(columns, _MIN_COLUMNS), _MAX_COLUMNS) - 2
    joined = ", ".join(entry.replace(" ", "\0") for entry in entries)
    lines = textwrap.wrap(joined, width, break_long_words=False, break_on_hyphens=False)
    return [f"  {line}".replace("\0", " ") for line in lines]


def _indented(lines: Sequence[str]) -> list[str]:
    more = [f"  and {len(lines) - MAX_REASONS} more"] * (len(lines) > MAX_REASONS)
    return [f"  {line}" for line in lines[:MAX_REASONS]] + more


def _time(result: CommandResult) -> str:
    waiting = result["waiting"]
    computing = {
        name: max(value - waiting.get(name, 0.0), 0.0) for name, value in result["seconds"].items()
    }
    longest = sorted(computing.items(), key=lambda item: -item[1])[:2]
    waited = sum(waiting.values())
    parts = ", ".join(f"{name} {value:.1f}" for name, value in longest)
    waits = f"; {waited:.1f} s of waiting for models" if waited >= 0.5 else ""
    return f"{sum(computing.values()):.1f} s of computing ({parts}){waits}"


def _cost(ledger: Mapping[str, Any]) -> str:
    if not ledger:
        return "no model calls"
    calls = count(ledger["calls"], "call")
    if ledger["cost_usd"] is None:
        unknown = ", ".join(ledger["models_without_price"])
        return f"{calls}, {ledger['known_cost_usd']:.4g} USD plus the cost of {unknown}"
    return f"{calls} by {ledger['provider']}, {ledger['cost_usd']:.4g} USD"
