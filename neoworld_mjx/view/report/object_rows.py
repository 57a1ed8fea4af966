"""Rows of a report, one for each object, with pictures, changes, agreement and checks."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup
from pydantic import ValidationError

from ...checks.verdict import Check, format_quantity
from .changes import all_moves
from .formatting import read_json, size_cm, support_of, with_unit
from .page import elements
from .pictures import cropped_picture, picture

TITLE = "Objects"
MARGIN = 0.12
"""Margin around an object in its picture, relative to the longer edge of its box."""
_METRIC_LIMITS = (
    ("depths_m", "max_depth_m", "m", "penetrates {other} by {value} (limit {limit})"),
    ("settled_depths_m", "max_depth_m", "m", "settles {value} deep in {other} (limit {limit})"),
    ("drift_m", "max_drift_m", "m", "moves by {value} (limit {limit})"),
    ("tilt_deg", "max_tilt_deg", "°", "turns by {value} (limit {limit})"),
    ("joint_slide_m", "max_drift_m", "m", "{joint} slides by {value} (limit {limit})"),
    ("joint_turn_deg", "max_tilt_deg", "°", "{joint} turns by {value} (limit {limit})"),
)
"""Metric of each object, option that limits the metric, unit, and message."""


def object_rows(folder: Path, run: Mapping[str, Any], tree: Mapping[str, Any]) -> Markup:
    """Return the section with one row per object; rows of failing objects come first and are open.

    Args:
        folder: the run folder.
        run: run.json.
        tree: tree.json; empty before the parse.
    """
    nodes = {node["name"]: node for node in tree.get("nodes", [])}
    object_folders = {path.name: path for path in (folder / "objects").glob("*") if path.is_dir()}
    if not object_folders:
        return elements.section(TITLE, elements.missing("No objects yet."))
    moves, causes = all_moves(folder), violated_limits(run)
    agreement = (run["metrics"].get("box_iou") or {}).get("objects", {})
    rows, untested = [], 0
    for name, object_folder in sorted(object_folders.items()):
        verification = read_json(object_folder / "verify.json")
        passed = None if verification is None else bool(verification.get("passed"))
        if name in causes:
            passed = False
        node = nodes.get(name, {})
        row = elements.object_row(
            name,
            _pictures(folder, object_folder, node, tree.get("camera")),
            _facts(node, moves.get(name, {}), agreement.get(name, {}), causes.get(name, [])),
            passed,
            _checks(object_folder, verification),
        )
        rows.append((passed is not False, row))
        untested += passed is None
    rows.sort(key=lambda row: row[0])
    failed = sum(not passed for passed, _ in rows)
    outcome = f"{failed} of {len(rows)} fail" if failed else f"All {len(rows) - untested} pass"
    tests = " the object tests, in which each object is simulated alone"
    if failed and run["metrics"].get("passed"):
        tests += "; the scene is valid, because it supports these objects"
    elif causes:
        tests = " the object tests or the final check of the scene"
    summary = "" if untested == len(rows) else f"{outcome}{tests}. "
    if untested:
        summary += f"{untested} of {len(rows)} were not tested alone. "
    note = elements.paragraph(f"{summary}Open a row to see its checks.", "dim")
    return elements.section(TITLE, note, *(row for _, row in rows))


def violated_limits(run: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return messages about the limits that each object of the refined scene violates, by name."""
    metrics, limits = run["metrics"], run["config"]["refine"]
    causes: dict[str, list[str]] = {}
    for key, bound, unit, message in _METRIC_LIMITS:
        limit = limits[bound]
        for names, value in (metrics.get(key) or {}).items():
            if value < limit or ("depth" in key and value == limit):
                continue
            first, _, other = names.partition("|")
            name, _, joint = first.partition("-")
            text = message.format(
                other=other, joint=joint, value=with_unit(value, unit), limit=with_unit(limit, unit)
            )
            causes.setdefault(name, []).append(text.replace(" °", "°"))
    return causes


def _facts(
    node: Mapping[str, Any],
    moves: Mapping[str, str],
    agreement: Mapping[str, Any],
    causes: list[str],
) -> list[tuple[str, object]]:
    """Return labeled facts about an object: violated limits, results of steps, overlap of boxes."""
    facts: list[tuple[str, object]] = []
    if causes:
        facts.append(("not valid", elements.span("; ".join(causes), "bad")))
    if node:
        size = size_cm(node["box3d"]["size"])
        facts.append(("parse", f"{node['label']}, {support_of(dict(node))}, {size} cm"))
    facts += moves.items()
    if agreement.get("refined") is not None:
        steps = {"parsed": "parsed cuboid", "composed": "composed", "refined": "refined"}
        overlaps = [
            f"{label} {agreement[step]:.2f}"
            for step, label in steps.items()
            if agreement.get(step) is not None
        ]
        facts.append(("boxes agree", ", ".join(overlaps)))
    return facts


def _pictures(
    folder: Path, object_folder: Path, node: Mapping[str, Any], camera: Any
) -> list[Markup]:
    """Return crops of the photograph and of the rendered scene around the object.

    If the parse gives no box, return the pictures in the object's folder.
    """
    box = node.get("box2d")
    if box is None or not isinstance(camera, dict):
        files = [
            (object_folder / "crop.png", "photograph"),
            (object_folder / "render.png", "program"),
        ]
        return [picture(path, caption) for path, caption in files if path.is_file()]
    width, height = camera["width"], camera["height_px"]
    margin = MARGIN * max(box["x1"] - box["x0"], box["y1"] - box["y0"])
    window = (
        (box["x0"] - margin) / width,
        (box["y0"] - margin) / height,
        (box["x1"] + margin) / width,
        (box["y1"] + margin) / height,
    )
    scene, caption = folder / "pictures" / "after.png", "refined"
    if not scene.is_file():
        scene, caption = folder / "pictures" / "before.png", "composed"
    return [
        cropped_picture(folder / "photo.png", window, "photograph"),
        cropped_picture(scene, window, caption),
    ]


def _bound(check: Mapping[str, Any]) -> str:
    """Format the threshold of a check with "≥" or "≤"."""
    try:
        least = Check.model_validate(check).least
    except ValidationError:
        return _measured(check, "threshold")
    threshold = _measured(check, "threshold")
    return threshold and f"{'≥' if least else '≤'} {threshold}"


def _measured(check: Mapping[str, Any], key: str) -> str:
    """Format the value or the threshold of a check with the digits that the terminal prints."""
    value = check.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "" if value is None else str(value)
    return format_quantity(value, str(check.get("unit") or ""))


def _checks(object_folder: Path, verification: Mapping[str, Any] | None) -> Markup:
    """Return the signals of an object's program and its checks in verify.json."""
    signals = [
        [
            signal["code"].replace("_", " "),
            signal["message"],
            with_unit(signal.get("value"), ""),
            with_unit(signal.get("threshold"), ""),
        ]
        for signal in (read_json(object_folder / "program.json") or {}).get("signals", [])
    ]
    heads = ["signal of the program", "", "#value, SI", "#threshold, SI"]
    parts = [elements.table(heads, signals)] if signals else []
    if verification is None:
        return Markup("").join([*parts, elements.missing("No verify.json yet.")])
    checks = [
        [
            f"{check.get('scenario', '')} {check.get('name', '')}".replace("_", " ").strip(),
            _measured(check, "value"),
            _bound(check),
            elements.outcome(check.get("outcome"), bool(check.get("doubtful"))),
            check.get("hint") or check.get("evidence") or "",
        ]
        for check in verification.get("checks", [])
    ]
    parts.append(elements.table(["check", "#value", "#threshold", "verdict", "note"], checks))
    if findings := verification.get("seen"):
        heads = ["findings of the critic in key frames"]
        parts.append(elements.table(heads, [[finding] for finding in findings]))
    return Markup("").join(parts)
