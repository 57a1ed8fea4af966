"""Tables of a report: parse, objects and verdicts, scene, joints, penetrations."""

import math
from pathlib import Path
from typing import Any

from ...errors import RunError
from ...io import read_object
from ...run_folder import STEPS
from .page import Html, film_strip, missing, picture, section, table, verdict

PARSED = "pictures/parse.png"


FILMS = {"free_fall": "free fall", "force_perturbation": "pushes"}
"""Films of an object's simulation that its folder may have, and their names."""


def parsed(folder: Path, tree: dict[str, Any]) -> Html:
    """Show tree.json beside the picture of its boxes."""
    nodes = tree.get("nodes")
    if not nodes:
        return section("Parse", missing("No tree.json yet."))
    rows = []
    for node in nodes:
        size = node["box3d"]["size"]
        flags = [
            "environment" if node.get("environment") else "",
            "fixed" if node.get("fixed_base") else "",
            "occluded" if node.get("occluded") else "",
            *(f"{a['part']} {a['type']} {100 * a['opening']:.0f} %" for a in node["articulation"]),
        ]
        parent = f"{node.get('relation', 'on')} {node['parent']}" if node.get("parent") else "world"
        if node.get("parent_link"):
            parent += f" ({node['parent_link']})"
        rows.append(
            [
                node["name"],
                node["label"],
                parent,
                " × ".join(f"{100 * v:.1f}" for v in size),
                f"{math.degrees(node['box3d'].get('yaw', 0.0)):.0f}",
                ", ".join(flag for flag in flags if flag),
            ]
        )
    camera = tree["camera"]
    caption = (
        f"Camera {camera['height']:.2f} m high, pitched down "
        f"{math.degrees(camera['pitch']):.1f}°, vertical field of view "
        f"{math.degrees(camera['fovy']):.1f}°."
    )
    heads = ["object", "label", "stands", "#size, cm", "#yaw, deg", "notes"]
    return section(
        "Parse",
        f'<div class="pictures" style="max-width:720px">{picture(folder / PARSED, caption)}</div>',
        table(heads, rows),
    )


def verdicts(home: Path, verification: dict[str, Any] | None) -> Html:
    """Show an object's signals and verify.json: every check with number, threshold and verdict."""
    parts = [_signals(read_json(home / "program.json") or {})]
    if verification is None:
        return Html("".join([*parts, missing("No verify.json yet.")]))
    rows = [
        [
            f"{check.get('scenario', '')} {check.get('name', '')}".replace("_", " ").strip(),
            with_unit(check.get("value"), check.get("unit")),
            with_unit(check.get("threshold"), check.get("unit")),
            outcome_mark(check.get("outcome"), doubtful=bool(check.get("doubtful"))),
            check.get("hint") or check.get("evidence") or "",
        ]
        for check in verification.get("checks", [])
    ]
    parts.append(table(["check", "#value", "#threshold", "verdict", "note"], rows))
    if findings := verification.get("seen"):
        parts.append(
            table(["findings of the critic in key frames"], [[finding] for finding in findings])
        )
    films = [film_strip(home / f"{kind}.gif", name) for kind, name in FILMS.items()]
    return Html("".join([*parts, *films]))


def _signals(program: dict[str, Any]) -> Html:
    """List the signals of an object's program, allowed overlaps with their reasons among them."""
    rows = [
        [
            signal["code"].replace("_", " "),
            signal["message"],
            with_unit(signal.get("value"), ""),
            with_unit(signal.get("threshold"), ""),
        ]
        for signal in program.get("signals", [])
    ]
    heads = ["of the program", "", "#value, SI", "#threshold, SI"]
    return table(heads, rows) if rows else Html("")


def placed(scene: dict[str, Any]) -> Html:
    """Show the poses in scene.json, and the misfit of sizes to the parsed boxes after rescaling."""
    if not scene.get("objects"):
        return section("Scene", missing("No scene.json yet."))
    rows = []
    for obj in scene["objects"]:
        residual = obj.get("scale_residual")
        x, y = obj["xy"]
        rows.append(
            [
                obj["name"],
                f"{obj.get('relation', 'on')} {obj['parent']}" if obj.get("parent") else "world",
                f"{1000 * x:.1f}, {1000 * y:.1f}, {1000 * obj.get('z', 0.0):.1f}",
                f"{math.degrees(obj.get('yaw', 0.0)):.1f}",
                " / ".join(f"{100 * v:+.0f}" for v in residual) if residual else "",
                "static" if obj.get("environment") or obj.get("fixed_base") else "movable",
            ]
        )
    heads = ["object", "stands", "#x, y, z in parent, mm", "#yaw, deg", "#size off x/y/z, %", ""]
    note = '<p class="dim">Size off: against the parsed box, after isotropic rescaling.</p>'
    return section("Scene", table(heads, rows), note)


def agreement(run: dict[str, Any]) -> Html:
    """Show how far each object's visible box overlaps the parsed one, from step to step."""
    title = "Agreement with the photograph"
    measured = run["metrics"].get("box_iou")
    if not measured or not measured["objects"]:
        return section(title, missing(f"Measured after refine; {where(run)}."))
    steps = ("parsed", "composed", "refined")
    number = lambda value: "" if value is None else f"{value:.2f}"
    means = [["mean", *(number(measured[step]) for step in steps)]]
    rows = [
        [name, *(number(values[step]) for step in steps)]
        for name, values in sorted(
            measured["objects"].items(), key=lambda item: item[1]["refined"] or 0.0
        )
    ]
    note = (
        '<p class="dim">Intersection over union of the box of what is visible with the box that '
        "was parsed, the worst first; parsed: of the 3D boxes, which hide nothing.</p>"
    )
    return section(title, table(["object", *(f"#{step}" for step in steps)], means + rows), note)


def joints(folder: Path, scene: dict[str, Any]) -> Html:
    """List the joints of all objects, from scene.json or else from each spec.json."""
    specs: list[tuple[dict[str, Any], dict[str, float]]] = [
        (obj["spec"], obj.get("joint_state", {})) for obj in scene.get("objects", [])
    ]
    names = [obj["name"] for obj in scene.get("objects", [])]
    if not specs:
        files = sorted((folder / "objects").glob("*/spec.json"))
        loaded = [(file.parent.name, read_json(file)) for file in files]
        specs = [(spec, {}) for _, spec in loaded if spec]
        names = [name for name, spec in loaded if spec]
    rows = []
    for name, (spec, state) in zip(names, specs, strict=True):
        for joint in spec.get("joints", []):
            if joint["type"] == "fixed":
                continue
            unit, factor = ("mm", 1000.0) if joint["type"] == "prismatic" else ("°", 180 / math.pi)
            span = f"{factor * joint['lower']:.0f} to {factor * joint['upper']:.0f} {unit}"
            ball = joint["type"] == "ball"
            axis = "(" + ", ".join(f"{v:.2f}" for v in joint["axis"]) + ")"
            free = joint["type"] == "continuous" or (ball and joint["upper"] == 0)
            keys = [f"{joint['name']}.{k}" for k in "xyz"] if ball else [joint["name"]]
            now = [state.get(key, 0.0) for key in keys]
            rows.append(
                [
                    name,
                    joint["name"],
                    joint["type"],
                    f"{joint['parent']} → {joint['child']}",
                    "any" if ball else axis,
                    "unlimited" if free else span,
                    f"{factor * (math.hypot(*now) if ball else now[0]):.0f} {unit}",
                    f"{joint['damping']:.2g}",
                ]
            )
    heads = ["object", "joint", "type", "links", "axis", "#range", "#now", "#damping, SI"]
    if rows:
        return section("Joints", table(heads, rows))
    return section("Joints", missing("No object has a joint." if specs else "No objects yet."))


def penetrations(run: dict[str, Any]) -> Html:
    """Compare the pairs that intersect, and the drift in free fall, before and after Step 5."""
    after = run["metrics"]
    before = after.get("before") or {}
    if "depths_m" not in after:
        return section("Penetrations and drift", missing(f"Measured after refine; {where(run)}."))
    old, new = before.get("depths_m", {}), after["depths_m"]
    limit = run["config"]["refine"]["max_depth_m"]
    pairs = [
        [
            pair.replace("|", " – "),
            _mm(old.get(pair, 0.0)) if before else "",
            _mm(new.get(pair, 0.0)),
            verdict(new.get(pair, 0.0) <= limit),
        ]
        for pair in sorted({*old, *new}, key=lambda p: -max(old.get(p, 0.0), new.get(p, 0.0)))
    ]
    heads = ["pair", "#depth composed, mm", "#depth refined, mm", "verdict"]
    none = "<p>No two objects intersect, before or after.</p>"
    moved = [
        [
            name,
            _mm(before.get("drift_m", {}).get(name)),
            _mm(drift),
            _degrees(before.get("tilt_deg", {}).get(name)),
            _degrees(after.get("tilt_deg", {}).get(name)),
        ]
        for name, drift in after.get("drift_m", {}).items()
    ]
    drifts = [
        "object",
        "#drift composed, mm",
        "#drift refined, mm",
        "#turn composed",
        "#turn refined",
    ]
    return section(
        "Penetrations and drift",
        table(heads, pairs) if pairs else none,
        table(drifts, moved) if moved else "",
    )


def where(run: dict[str, Any]) -> str:
    """Return the run's status and the steps done, in words."""
    finished = [step for step in STEPS if any(n.partition("/")[0] == step for n in run["steps"])]
    return f"this run is {run['status']}, done so far: {', '.join(finished) or 'nothing'}"


def read_json(path: Path) -> dict[str, Any] | None:
    """Read a JSON object; None if it is absent or damaged."""
    try:
        return read_object(path, RunError) if path.is_file() else None
    except RunError:
        return None


def outcome_mark(outcome: Any, *, doubtful: bool = False) -> Html:
    """Return the outcome of a check as a coloured word."""
    if doubtful:
        return Html(f"{verdict(passed=True)} only just")
    if outcome in ("PASS", "FAIL"):
        return verdict(outcome == "PASS")
    words = {"SKIP": "skipped", "TOOL_FAILURE": "could not be tested"}.get(outcome, "unknown")
    return Html(f'<span class="dim">{words}</span>')


def with_unit(value: Any, unit: Any) -> str:
    """Return a value of a check for people: lengths in mm, angles in degrees."""
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if unit == "m":
        return f"{1000 * value:.2f} mm"
    if unit == "rad":
        return f"{math.degrees(value):.2f}°"
    return f"{value:.4g} {unit or ''}".strip()


def _mm(value: float | None) -> str:
    return "" if value is None else f"{1000 * value:.2f}"


def _degrees(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}°"
