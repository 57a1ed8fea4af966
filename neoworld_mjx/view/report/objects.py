"""Rows of a report, one for each object, with pictures, changes, agreement and checks."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ...checks.verdict import Check
from ...measure import object_moves
from ...spec import read_scene
from ..evidence_lines import evidence_lines
from .page import cropped_picture, elements, read_json, size_cm, support_of

TITLE = "Objects"
BOXES, REFINEMENT, RESCUE = "fit to the boxes", "refinement", "from the given pose"
LEAST_M, LEAST_SIZE, LEAST_DEG = 5e-4, 5e-4, 0.05
"""Changes of position [m], size (relative) and angle [deg] below which all digits shown are 0."""
MARGIN = 0.12
"""Margin around an object in its picture, relative to the longer edge of its box."""


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
    metrics = run["metrics"]
    moves, failures = all_moves(folder), scene_failures(metrics)
    agreement = (metrics.get("box_iou") or {}).get("objects", {})
    aligned = read_json(folder / "compose" / "align.json") or {}
    rows, untested = [], 0
    for name, object_folder in sorted(object_folders.items()):
        verified = read_json(object_folder / "verify.json")
        passed = None if verified is None else bool(verified["passed"])
        if name in failures:
            passed = False
        node = nodes.get(name, {})
        support = node.get("parent") or "the world"
        evidence = evidence_lines(aligned, agreement.get(name, {}), name, support)
        row = elements.object_row(
            name,
            _pictures(folder, node, tree.get("camera")),
            _facts(node, moves.get(name, {}), evidence, failures.get(name, [])),
            passed,
            _checks(object_folder, verified),
        )
        rows.append((passed is not False, row))
        untested += passed is None
    rows.sort(key=lambda row: row[0])
    failed = sum(not passed for passed, _ in rows)
    outcome = f"{failed} of {len(rows)} fail" if failed else f"All {len(rows) - untested} pass"
    tests = " the object tests, in which each object is simulated alone"
    if failed and metrics.get("passed"):
        tests += "; the scene is valid, because it supports these objects"
    elif failures:
        tests = " the object tests or the final check of the scene"
    summary = "" if untested == len(rows) else f"{outcome}{tests}. "
    if untested:
        summary += f"{untested} of {len(rows)} were not tested alone. "
    note = elements.paragraph(f"{summary}Open a row to see its checks.", "dim")
    return elements.section(TITLE, note, *(row for _, row in rows))


def scene_failures(metrics: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the phrases of the failed checks of the scene, by the objects that fail them."""
    phrases: dict[str, list[str]] = {}
    for check in metrics.get("checks", ()):
        if check["passed"]:
            continue
        failing = [name for key in check["failing"] for name in key.split("|")]
        for name in dict.fromkeys(name.partition("-")[0] for name in failing):
            phrases.setdefault(name, []).append(check["phrase"])
    return phrases


def object_checks(verified: Mapping[str, Any]) -> list[Check]:
    """Return the checks in verify.json.

    Raises:
        ValidationError: the file is damaged.
    """
    return [Check.model_validate(check) for check in verified["checks"]]


def all_moves(folder: Path) -> dict[str, dict[str, str]]:
    """Return the changes of each object by the 2D boxes and the refinement, as text by step.

    In a rescue, also return the changes from the given scene to the refined one.
    """
    by_boxes = (read_json(folder / "compose" / "fit.json") or {}).get("objects", {})
    moves: dict[str, dict[str, str]] = {}
    for name, change in by_boxes.items():
        text = _change(math.hypot(*change["shift_m"]), change["size_ratio"], change["yaw_deg"])
        moves.setdefault(name, {})[BOXES] = text
    refined = folder / "scene.json"
    for label, file in ((REFINEMENT, "compose/scene.json"), (RESCUE, "given.json")):
        if not ((folder / file).is_file() and refined.is_file()):
            continue
        for name, move in object_moves(read_scene(folder / file), read_scene(refined)).items():
            moves.setdefault(name, {})[label] = _change(
                move.distance_m, move.size_ratio, move.yaw_deg, move.turn_deg
            )
    return moves


def _change(distance_m: float, size_ratio: float, yaw_deg: float, turn_deg: float = 0.0) -> str:
    """Format a change; add the angle of the whole rotation if a tilt makes it exceed the yaw."""
    tilted = turn_deg > abs(yaw_deg) + LEAST_DEG
    small = distance_m < LEAST_M and abs(size_ratio - 1) < LEAST_SIZE and abs(yaw_deg) < LEAST_DEG
    if small and not tilted:
        return "unchanged"
    # Adding 0.0 turns -0.0 into 0.0.
    percent, degrees = (round(value, 1) + 0.0 for value in (100 * (size_ratio - 1), yaw_deg))
    text = f"{100 * distance_m:.1f} cm, {percent:+.1f} %, {degrees:+.1f}°"
    return f"{text}, {turn_deg:.1f}° with tilt" if tilted else text


def _facts(
    node: Mapping[str, Any],
    moves: Mapping[str, str],
    evidence: Mapping[str, str],
    failures: list[str],
) -> list[tuple[str, object]]:
    """Return labeled facts about an object: failed checks, results of steps, evidence."""
    facts: list[tuple[str, object]] = []
    if failures:
        facts.append(("not valid", elements.span("; ".join(failures), "bad")))
    if node:
        size = size_cm(node["box3d"]["size"])
        facts.append(("parse", f"{node['label']}, {support_of(dict(node))}, {size} cm"))
    return [*facts, *moves.items(), *evidence.items()]


def _pictures(folder: Path, node: Mapping[str, Any], camera: Any) -> list[Markup]:
    """Return crops of the photograph and of the rendered scene around the object."""
    box = node.get("box2d")
    if box is None or not isinstance(camera, dict) or not (folder / "photo.png").is_file():
        return []
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


def _checks(object_folder: Path, verified: Mapping[str, Any] | None) -> Markup:
    """Return the signals of an object's program, and its checks in verify.json."""
    signals = [
        [signal["code"].replace("_", " "), signal["message"]]
        for signal in (read_json(object_folder / "program.json") or {}).get("signals", [])
    ]
    parts = [elements.table(["signal of the program", ""], signals)] if signals else []
    if verified is None:
        return Markup("").join([*parts, elements.missing("No verify.json yet.")])
    rows = [
        [
            elements.outcome(check.outcome, check.borderline),
            f"{check.scenario.replace('_', ' ')}: {check.phrase()}",
            check.hint or check.evidence,
        ]
        for check in object_checks(verified)
    ]
    parts.append(elements.table(["verdict", "check", "note"], rows))
    if findings := verified.get("seen"):
        heads = ["findings of the critic in key frames"]
        parts.append(elements.table(heads, [[finding] for finding in findings]))
    return Markup("").join(parts)
