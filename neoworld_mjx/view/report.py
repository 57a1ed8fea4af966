"""report.html: a run at a glance, in one file that needs no server and no network.

Reads what the run folder has and says what is not there yet, so that it can be written after any
step. It judges nothing itself: verdicts and numbers are those in run.json and verify.json.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..config import Config
from ..files import write_atomic
from ..run_folder import STEPS, read_run
from . import charts
from .convergence import convergence
from .page import Html, card, document, missing, picture, section, table, text, verdict

PHOTO, PARSED, BEFORE, AFTER = (
    "photo.png",
    "pictures/parse.png",
    "pictures/before.png",
    "pictures/after.png",
)


def write_report(folder: Path) -> Path:
    """Write `report.html` into a run folder and return its path.

    Raises:
        RunError: the folder is not a run folder.
    """
    folder = Path(folder)
    run = read_run(folder)
    scene = _json(folder / "scene.json") or {}
    tree = _json(folder / "tree.json") or {}
    title = f"{run.get('photo', {}).get('name') or folder.resolve().name}"
    sections = {
        "Fallbacks": lambda: _fallbacks(run),
        "Numbers": lambda: _numbers(run),
        "Before and after": lambda: _pictures(folder),
        "Parse": lambda: _parse(folder, tree),
        "Objects and their verdicts": lambda: _objects(folder),
        "Scene": lambda: _placed(scene),
        "Convergence of the search": lambda: convergence(folder / "refine" / "history.npz"),
        "Joints": lambda: _joints(folder, scene),
        "Penetrations": lambda: _penetrations(run),
        "Time": lambda: _time(run),
        "Models asked": lambda: _models(run),
        "Options and versions": lambda: _settings(run),
    }
    parts = [_head(run, title), *(_safely(name, draw) for name, draw in sections.items())]
    path = folder / "report.html"
    write_atomic(path, document(f"{title}: scene report", parts))
    return path


def _safely(title: str, draw: Callable[[], Html]) -> Html:
    """Draw a section; a file that was edited into another shape costs that section only."""
    try:
        return draw()
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        said = f"{type(error).__name__}: {error}"
        return section(title, missing(f"A file of this run does not fit: {said}"))


def _head(run: dict[str, Any], title: str) -> Html:
    status = str(run["status"])
    colour = {"finished": "good", "failed": "bad", "interrupted": "bad"}.get(status, "dim")
    error = f'<p class="bad">{text(run["error"])}</p>' if run.get("error") else ""
    facts = [
        f"seed {run.get('seeds', {}).get('run')}",
        f"options {run.get('fingerprint')}",
        f"engine {run['device']['engine']}" if run["device"].get("engine") else "",
        f"on {run['device'].get('cores')} cores",
        f"begun {run['started']}" if run.get("started") else "",
    ]
    line = " · ".join(fact for fact in facts if fact)
    return Html(
        f"<header><h1>{text(title)}</h1>"
        f'<p><span class="{colour}">{text(status)}</span> '
        f'<span class="dim">· {text(line)}</span></p>{error}</header>'
    )


def _fallbacks(run: dict[str, Any]) -> Html:
    entries = run["fallbacks"]
    if not entries:
        return Html('<p class="dim">No fallback was used.</p>')
    items = "".join(
        f"<li><b>{text(e['step'])}</b>: {text(e['what'])} — {text(e['why'])}</li>" for e in entries
    )
    title = "1 fallback was used" if len(entries) == 1 else f"{len(entries)} fallbacks were used"
    return section(title, f"<ul>{items}</ul>", kind="warn")


def _numbers(run: dict[str, Any]) -> Html:
    found = run["metrics"]
    if not found:
        return section("Numbers", missing(f"Measured after refine; {_where(run)}."))
    limits = run["config"]["refine"]
    cards = []

    def add(key: str, name: str, shown: str, limit: str = "", passed: bool | None = None) -> None:
        if key in found:
            cards.append(card(name, shown if found[key] is not None else "unknown", limit, passed))

    def number(key: str) -> float:
        value = found.get(key)
        return math.nan if value is None else float(value)

    pairs = number("s_pen")
    add("s_pen", "S-Pen (exported scene)", f"{pairs:.0f}", "0 wanted", pairs == 0)
    depth, deepest = number("max_depth_m"), limits["max_depth_m"]
    add(
        "max_depth_m",
        "deepest penetration",
        f"{depth * 1000:.2f} mm",
        f"limit {deepest * 1000:g} mm",
        depth <= deepest,
    )
    stable = found.get("s_stab")
    add("s_stab", "S-Stab", "stable" if stable else "not stable", "free fall", bool(stable))
    drift, furthest = number("max_drift_m"), limits["max_drift_m"]
    add(
        "max_drift_m",
        "largest drift",
        f"{drift * 1000:.2f} mm",
        f"limit {furthest * 1000:g} mm in {limits['check_duration_s']:g} s",
        drift < furthest,
    )
    turn, widest = number("max_tilt_deg"), limits["max_tilt_deg"]
    add("max_tilt_deg", "largest turn", f"{turn:.2f}°", f"limit {widest:g}°", turn < widest)
    add("movable", "movable objects", f"{number('movable'):.0f}", f"of {found.get('objects', '?')}")
    scale = number("mean_log_scale")
    percent = f"mean size {100 * math.expm1(scale):+.1f} %" if math.isfinite(scale) else ""
    add("mean_log_scale", "mean log scale", f"{scale:+.4f}", percent)
    total = sum(entry["seconds"] for entry in run["steps"].values())
    cards.append(card("all steps", f"{total:.1f} s"))
    return section("Numbers", f'<div class="cards">{"".join(cards)}</div>')


def _pictures(folder: Path) -> Html:
    shown = [
        picture(folder / PHOTO, "Photograph"),
        picture(folder / BEFORE, "Composed, before refinement"),
        picture(folder / AFTER, "Refined"),
    ]
    return section("Before and after", f'<div class="pictures">{"".join(shown)}</div>')


def _parse(folder: Path, tree: dict[str, Any]) -> Html:
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
    seen = (
        f"Camera {camera['height']:.2f} m high, pitched down "
        f"{math.degrees(camera['pitch']):.1f}°, vertical field of view "
        f"{math.degrees(camera['fovy']):.1f}°."
    )
    heads = ["object", "label", "stands", "#size, cm", "#yaw, deg", "notes"]
    return section(
        "Parse",
        f'<div class="pictures" style="max-width:720px">{picture(folder / PARSED, seen)}</div>',
        table(heads, rows),
    )


def _objects(folder: Path) -> Html:
    homes = sorted(path for path in (folder / "objects").glob("*") if path.is_dir())
    if not homes:
        return section("Objects and their verdicts", missing("No objects yet."))
    parts = []
    for home in homes:
        found = _json(home / "verify.json")
        passed = found.get("passed") if found else None
        parts.append(f"<h3>{text(home.name)} {verdict(passed) if found else ''}</h3>")
        shots = [(home / "crop.png", "photograph"), (home / "render.png", "program")]
        if any(path.is_file() for path, _ in shots):
            thumbs = "".join(picture(path, caption) for path, caption in shots)
            parts.append(f'<div class="thumbs">{thumbs}</div>')
        if found is None:
            parts.append(missing("No verify.json yet."))
            continue
        rows = [
            [
                str(check.get("name", "?")).replace("_", " "),
                _value(check.get("value"), check.get("unit")),
                _value(check.get("threshold"), check.get("unit")),
                verdict(check.get("passed")),
                check.get("hint") or check.get("note") or "",
            ]
            for check in found.get("checks", [])
        ]
        parts.append(table(["check", "#value", "#threshold", "verdict", "note"], rows))
    return section("Objects and their verdicts", *parts)


def _placed(scene: dict[str, Any]) -> Html:
    if not scene.get("objects"):
        return section("Scene", missing("No scene.json yet."))
    rows = []
    for item in scene["objects"]:
        residual = item.get("scale_residual")
        x, y = item["xy"]
        rows.append(
            [
                item["name"],
                f"{item.get('relation', 'on')} {item['parent']}" if item.get("parent") else "world",
                f"{1000 * x:.1f}, {1000 * y:.1f}, {1000 * item.get('z', 0.0):.1f}",
                f"{math.degrees(item.get('yaw', 0.0)):.1f}",
                " / ".join(f"{100 * v:+.0f}" for v in residual) if residual else "",
                "static" if item.get("environment") or item.get("fixed_base") else "movable",
            ]
        )
    heads = ["object", "stands", "#x, y, z in parent, mm", "#yaw, deg", "#size off x/y/z, %", ""]
    note = '<p class="dim">Size off: against the parsed box, after isotropic rescaling.</p>'
    return section("Scene", table(heads, rows), note)


def _joints(folder: Path, scene: dict[str, Any]) -> Html:
    specs: list[tuple[dict[str, Any], dict[str, float]]] = [
        (item["spec"], item.get("joint_state", {})) for item in scene.get("objects", [])
    ]
    names = [item["name"] for item in scene.get("objects", [])]
    if not specs:
        files = sorted((folder / "objects").glob("*/spec.json"))
        loaded = [(file.parent.name, _json(file)) for file in files]
        specs = [(spec, {}) for _, spec in loaded if spec]
        names = [name for name, spec in loaded if spec]
    rows = []
    for name, (spec, state) in zip(names, specs, strict=True):
        for joint in spec.get("joints", []):
            if joint["type"] == "fixed":
                continue
            unit, factor = ("mm", 1000.0) if joint["type"] == "prismatic" else ("°", 180 / math.pi)
            span = f"{factor * joint['lower']:.0f} to {factor * joint['upper']:.0f} {unit}"
            rows.append(
                [
                    name,
                    joint["name"],
                    joint["type"],
                    f"{joint['parent']} → {joint['child']}",
                    "(" + ", ".join(f"{v:.2f}" for v in joint["axis"]) + ")",
                    "unlimited" if joint["type"] == "continuous" else span,
                    f"{factor * state.get(joint['name'], 0.0):.0f} {unit}",
                    f"{joint['damping']:.2g}",
                ]
            )
    heads = ["object", "joint", "type", "links", "axis", "#range", "#now", "#damping, SI"]
    if rows:
        return section("Joints", table(heads, rows))
    return section("Joints", missing("No object has a joint." if specs else "No objects yet."))


def _penetrations(run: dict[str, Any]) -> Html:
    pairs = run["metrics"].get("penetrations")
    if pairs is None:
        return section("Penetrations", missing(f"Measured after refine; {_where(run)}."))
    if not pairs:
        return section("Penetrations", "<p>No two objects intersect, before or after.</p>")
    limit = run["config"]["refine"]["max_depth_m"]
    rows = []
    for pair in pairs:
        before, after = pair.get("before_m"), pair.get("after_m")
        passed = None if after is None else after <= limit
        rows.append([f"{pair['a']} – {pair['b']}", _mm(before), _mm(after), verdict(passed)])
    return section(
        "Penetrations", table(["pair", "#composed, mm", "#refined, mm", "verdict"], rows)
    )


def _time(run: dict[str, Any]) -> Html:
    spent: dict[str, float] = {}
    for name, entry in run["steps"].items():
        head = name.partition("/")[0]
        spent[head] = spent.get(head, 0.0) + entry["seconds"]
    if not spent:
        return section("Time", missing("No step has finished yet."))
    items = [(step, spent[step]) for step in STEPS if step in spent]
    return section("Time", f'<div style="max-width:620px">{charts.bars(items, "s")}</div>')


def _models(run: dict[str, Any]) -> Html:
    used = run["mllm"]
    if not used:
        return section("Models asked", missing("Nothing was asked yet."))
    rows = [
        [
            row.get("role", ""),
            row.get("model", ""),
            row.get("calls", 0),
            row.get("failed_calls", 0),
            row.get("tokens", {}).get("input", 0),
            row.get("tokens", {}).get("output", 0),
            "unknown" if row.get("cost_usd") is None else f"{row['cost_usd']:.4f}",
        ]
        for row in used.get("by_role_and_model", [])
    ]
    heads = ["role", "model", "#calls", "#failed", "#tokens in", "#tokens out", "#cost, USD"]
    via = f"<p>Provider: {text(used['provider'])}.</p>" if used.get("provider") else ""
    cost = used.get("cost_usd")
    total = "unknown" if cost is None else f"{cost:.4f} USD"
    line = f"<p>{text(used.get('calls', 0))} calls, cost {text(total)}.</p>"
    return section("Models asked", via, line, table(heads, rows) if rows else "")


def _settings(run: dict[str, Any]) -> Html:
    changed = sorted(_differences(Config().model_dump(mode="json"), run["config"] or {}))
    rows = [[key, json.dumps(new), json.dumps(old)] for key, old, new in changed]
    options = (
        table(["option", "here", "default"], rows)
        if rows
        else "<p>All options have their default values.</p>"
    )
    versions = table(["package", "version"], sorted((run["versions"] or {}).items()))
    whole = json.dumps(run["config"], indent=1)
    return section(
        "Options and versions",
        options,
        f"<details><summary>all options</summary><pre>{text(whole)}</pre></details>",
        f"<details><summary>versions</summary>{versions}</details>",
    )


def _differences(default: Any, given: Any, at: str = "") -> list[tuple[str, Any, Any]]:
    if isinstance(default, dict) and isinstance(given, dict):
        found = []
        for key in {*default, *given}:
            where = f"{at}.{key}" if at else str(key)
            found += _differences(default.get(key), given.get(key), where)
        return found
    return [] if default == given else [(at, default, given)]


def _where(run: dict[str, Any]) -> str:
    done = [step for step in STEPS if any(n.partition("/")[0] == step for n in run["steps"])]
    return f"this run is {run['status']}, done so far: {', '.join(done) or 'nothing'}"


def _value(value: Any, unit: Any) -> str:
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


def _json(path: Path) -> dict[str, Any] | None:
    """Read a JSON object; None if it is absent or damaged."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return data if isinstance(data, dict) else None
