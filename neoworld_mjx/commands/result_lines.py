"""Short summaries of command results: validity with reasons, files, time and cost."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from .base_command import CommandResult

DETAILS = "details: -v, or --json"
MAX_REASONS = 5
_UNITS = {"m": (1000.0, "mm"), "deg": (1.0, "degrees"), "rad": (180 / 3.141592653589793, "degrees")}


def run_lines(result: CommandResult) -> list[str]:
    """Summarize a reconstruction or a refinement."""
    passed, folder = result.get("passed"), result["folder"]
    if passed is None:
        head = f"not refined yet: {_listed(result['objects'])} in {folder}"
    elif passed:
        head = (
            f"valid: {count(result['movable'], 'movable object')} within "
            f"{_at_most(1000 * result['max_drift_m'], 'mm')} and "
            f"{_at_most(result['max_tilt_deg'], 'degrees')} in {result['duration_s']:g} s of free "
            f"fall, deepest overlap {1000 * result['max_depth_m']:.2g} mm"
        )
    else:
        why = [entry["why"] for entry in result["fallbacks"] if entry["step"] == "refine"]
        head = f"not valid: {_reasons(why) or _worst(result)}"
    rows = [head]
    if result.get("scene"):
        rows.append(f"scene:  {result['scene']}  ({count(result['objects'], 'object')})")
    rows.append(f"report: {result['report']}")
    agreement = result.get("box_iou") or {}
    if agreement.get("refined") is not None:
        worst = agreement.get("worst") or {}
        low = f", worst {worst['name']} {worst['value']:.2f}" if worst.get("name") else ""
        rows.append(f"photo:  mean box IoU {agreement['refined']:.2f}{low}")
    fallbacks = [f"{e['step']}: {e['what']}: {e['why']}" for e in result["fallbacks"]]
    if fallbacks:
        rows.append(f"{count(fallbacks, 'fallback')}:")
        rows += [f"  {line}" for line in fallbacks[:MAX_REASONS]]
        if len(fallbacks) > MAX_REASONS:
            rows.append(f"  (+{len(fallbacks) - MAX_REASONS}: report)")
    rows.append(f"{_time(result)}; {_cost(result['mllm'])}; {DETAILS}")
    return rows


def photo_lines(result: CommandResult) -> list[str]:
    """Summarize the reconstruction of a folder of photographs."""
    words = {True: "valid", False: "not valid", None: "not refined yet"}
    rows = [
        f"{entry['photo']}: {entry['error'] or words[entry['passed']]}, {entry['seconds']:.1f} s, "
        f"in {entry['folder']}"
        for entry in result["photos"]
    ]
    valid = sum(entry["passed"] is True for entry in result["photos"])
    return [f"{valid} of {count(rows, 'photograph')} valid", *rows,
            f"{_cost(result['mllm'])}; {DETAILS}"]  # fmt: skip


def scene_check_lines(result: CommandResult) -> list[str]:
    """Summarize the check of a scene."""
    passed, checks = result["passed"], result["checks"]
    failed = [check for check in checks if not check["passed"]]
    failures = [
        f"{measure(check['value'], check['name'])} {_subject(check)}"
        f"over {measure(check['threshold'], check['name'])} ({check['name']})"
        for check in failed
    ]
    movable = count(result["movable"], "movable object")
    head = f"valid: {movable}, all {len(checks)} checks pass"
    worst = max((c for c in checks if c["passed"]), key=_threshold_ratio, default=None)
    rows = [head if passed else f"not valid: {_reasons(failures)}", f"scene: {result['target']}"]
    if worst is not None and worst["value"]:
        rows.append(
            f"closest to its threshold: {worst['name']} {measure(worst['value'], worst['name'])} "
            f"{_subject(worst)}of {measure(worst['threshold'], worst['name'])}"
        )
    rows += [f"note: {note}" for note in result.get("notes", ())[:MAX_REASONS]]
    return [*rows, DETAILS]


def object_check_lines(result: CommandResult, listings: Sequence[str] = ()) -> list[str]:
    """Summarize the check of an object.

    Args:
        result: result of `check`.
        listings: formatted signals of the object's program.
    """
    rows = list(listings)
    if "object" not in result:
        return [*rows, f"not valid: {result['target']} does not build"]
    counts = result["counts"]
    ran = counts["PASS"] + counts["FAIL"] + counts["TOOL_FAILURE"]
    bad = [check for check in result["checks"] if check["outcome"] in ("FAIL", "TOOL_FAILURE")]
    if result["passed"]:
        borderline = f", {counts['doubtful']} of them borderline" if counts["doubtful"] else ""
        rows.append(f"valid: {result['object']} passes all {ran} checks{borderline}")
    else:
        why = "its program has errors" if not bad else f"{len(bad)} of {ran} checks fail"
        likely = f", the likely cause is {result['cause']}" if result.get("cause") else ""
        rows.append(f"not valid: {result['object']}: {why}{likely}")
    for check in bad[:MAX_REASONS]:
        place = " ".join(str(check[k]) for k in ("part", "joint") if check.get(k))
        hint = f"; hint: {check['hint']}" if check.get("hint") else ""
        rows.append(
            f"  {check['scenario']} {check['name']} {place}: {_value_and_threshold(check)}{hint}"
        )
    if len(bad) > MAX_REASONS:
        rows.append(f"  and {len(bad) - MAX_REASONS} more")
    repair = result.get("repair")
    if repair is not None:
        rows.append(f"repair: {_reasons(repair['changes']) or 'no repair succeeded'}")
    rows += [f"{key}: {result[key]}" for key in ("patch", "folder") if key in result]
    rows.append(f"{result['mass_kg']:.3g} kg; {result['seconds']:.2f} s; {DETAILS}")
    return rows


def build_lines(result: CommandResult, listings: Sequence[str] = ()) -> list[str]:
    """Summarize a build."""
    rows = list(listings)
    if "builds" in result:
        return [f"builds: {result['builds']}", f"folder: {result['folder']}"]
    if result["passed"]:
        rows.append(f"built: {result['object']} in {result['folder']}")
        rows += [f"note: {note}" for note in result.get("notes", ())[:MAX_REASONS]]
    else:
        rows.append("not built: see the errors above")
    if "picture" in result:
        rows.append(f"picture: {result['picture']}")
    return rows


def export_lines(result: CommandResult) -> list[str]:
    """Summarize an export."""
    rows = [f"written: {count(result['files'], 'file')} in {result['folder']}"]
    for kind, unsupported in result["lost"].items():
        if unsupported:
            rows.append(f"lost in {kind}: {_reasons(unsupported)}")
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
    cost = f"; {_cost(result['mllm'])}" if "mllm" in result else ""
    rows.append(
        f"{result['seconds']:.1f} s, of which {result['compile_s']:.1f} s for compilation{cost}; "
        f"{DETAILS}"
    )
    return rows


def measure(value: float | None, name: str) -> str:
    """Format a value with the unit at the end of its name, such as m in max_drift_m."""
    if value is None:
        return "not finite"
    factor, unit = _UNITS.get(name.rpartition("_")[2], (1.0, ""))
    return f"{factor * value:.3g} {unit}".strip()


def count(items: int | Sequence[object], noun: str) -> str:
    """Format a number with its noun, such as "3 objects"."""
    number = items if isinstance(items, int) else len(items)
    return f"{number} {noun}" + ("" if number == 1 else "s")


def file_lines(result: CommandResult) -> list[str]:
    """Summarize a command that writes one file."""
    return [
        f"{key}: {' x '.join(map(str, value)) if isinstance(value, list) else value}"
        for key, value in result.items()
    ]


def _at_most(value: float, unit: str) -> str:
    """Format an upper bound of a measured value, at least 0.1 and with one decimal place."""
    return f"{max(value, 0.1):.1f} {unit}"


def _value_and_threshold(check: Mapping[str, Any]) -> str:
    if check.get("value") is None:
        return str(check.get("evidence") or check["outcome"])
    unit = check.get("unit", "")
    factor, unit_text = _UNITS.get(unit, (1.0, unit))
    threshold = check.get("threshold")
    suffix = "" if threshold is None else f" against {factor * threshold:.3g}"
    return f"{factor * check['value']:.3g}{suffix} {unit_text}".strip()


def _threshold_ratio(check: Mapping[str, Any]) -> float:
    return check["value"] / check["threshold"] if check["threshold"] else 0.0


def _subject(check: Mapping[str, Any]) -> str:
    return f"of {check['where']} " if check.get("where") else ""


def _worst(result: CommandResult) -> str:
    """Describe the largest drift and overlap of a scene that fails without a recorded reason."""
    drift = max(result.get("drift_m", {"?": 0.0}).items(), key=lambda item: item[1])
    depth = 1000 * result.get("max_depth_m", 0.0)
    return f"{drift[0]} drifts by {1000 * drift[1]:.1f} mm, deepest overlap {depth:.2g} mm"


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


def _reasons(reasons: Iterable[str]) -> str:
    listed = list(reasons)
    omitted = f"; and {len(listed) - MAX_REASONS} more" if len(listed) > MAX_REASONS else ""
    return "; ".join(listed[:MAX_REASONS]) + omitted


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
