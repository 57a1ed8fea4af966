"""Write report.html: a run on one page that needs no server and no network.

It shows what the run folder has and names what is missing, so that it can be written after any
step. Verdicts and numbers are those in run.json and verify.json.
"""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...config import Config
from ...errors import NeoWorldError, RunError
from ...io.files import write_atomic
from ...run_folder import STEPS, read_run, refuse_links
from ...spec import read_scene
from . import charts
from .changes import TITLE, changes
from .convergence import convergence
from .film_strips import TITLE as FALL
from .film_strips import film_strips
from .object_rows import TITLE as OBJECTS
from .object_rows import object_rows, unstable
from .page import Html, card, document, missing, picture, section, table, text
from .scene_3d import TITLE as IN_3D
from .scene_3d import scene_3d, script_hash
from .tables import agreement, joints, parsed, penetrations, placed, read_json, where

CHECK = "compose/check.json"
PHOTO, BEFORE, AFTER = "photo.png", "pictures/before.png", "pictures/after.png"


def write_report(folder: Path) -> Path:
    """Write `report.html` into a run folder and return its path.

    Raises:
        RunError: the folder is not a run folder.
    """
    folder = Path(folder)
    run = read_run(folder)
    refuse_links(folder)
    scene = read_json(folder / "scene.json") or {}
    tree = read_json(folder / "tree.json") or {}
    title = f"{run['photo'].get('name') or folder.resolve().name}"
    sections = {
        "Fallbacks": lambda: _fallbacks(run),
        "Notes": lambda: _notes(run),
        "Numbers": lambda: _numbers(run),
        "Before and after": lambda: _pictures(folder),
        OBJECTS: lambda: object_rows(folder, run, tree),
        IN_3D: lambda: _turning(folder),
        FALL: lambda: film_strips(folder, float(run["config"]["refine"]["check_duration_s"])),
        "Parse": lambda: parsed(folder, tree),
        TITLE: lambda: changes(folder),
        "Scene": lambda: placed(scene),
        "Agreement with the photograph": lambda: agreement(run),
        "Convergence of the search": lambda: convergence(folder / "refine" / "history.npz"),
        "Joints": lambda: joints(folder, scene),
        "Penetrations and drift": lambda: penetrations(run),
        "Time": lambda: _time(run),
        "Models asked": lambda: _models(run),
        "Options and versions": lambda: _settings(run),
    }
    parts = [
        _safely(title, lambda: _head(run, title, _moving(folder))),
        *(_safely(name, draw) for name, draw in sections.items()),
    ]
    path = folder / "report.html"
    text = document(f"{title}: scene report", parts, [script_hash()])
    try:
        # Half a character, which only escapes in JSON can hold, becomes a question mark.
        write_atomic(path, text.encode("utf-8", "replace"))
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None
    return path


def _turning(folder: Path) -> Html:
    """Return the scene in three dimensions, refined or else as composed."""
    for name in ("scene.json", "compose/scene.json"):
        if (folder / name).is_file():
            return scene_3d(read_scene(folder / name))
    return section(IN_3D, missing("No scene.json yet."))


def _moving(folder: Path) -> list[str]:
    """Return the objects that did not stay in the composed scene, in words."""
    return [str(each["phrase"]) for each in (read_json(folder / CHECK) or {}).get("unstable", [])]


def _safely(title: str, draw: Callable[[], Html]) -> Html:
    """Draw a section; a file that was edited into another shape costs that section only."""
    try:
        return draw()
    except (ArithmeticError, AttributeError, LookupError, NeoWorldError, TypeError, ValueError,
            MemoryError) as error:  # fmt: skip
        cause = f"{type(error).__name__}: {error}"
        return section(title, missing(f"A file of this run does not fit: {cause}"))


def _head(run: dict[str, Any], title: str, moving: Sequence[str] = ()) -> Html:
    """Return the page's head.

    Args:
        run: run.json.
        title: of the page.
        moving: the objects that did not stay in the composed scene, in words.
    """
    status = str(run["status"])
    colour = {"finished": "good", "failed": "bad", "interrupted": "bad"}.get(status, "dim")
    error = f'<p class="bad">{text(run["error"])}</p>' if run.get("error") else ""
    causes, failed = unstable(run), run["metrics"].get("passed") is False
    if causes or failed:
        status, colour = f"{status}, but the scene is not valid", "bad"
        said = "; ".join(f"{name} {', '.join(why)}" for name, why in causes.items())
        error += f'<p class="bad">Not valid: {text(said or "see the numbers below")}</p>'
    elif run["metrics"].get("passed"):
        status = f"{status}, valid"
    if moving and not (run["metrics"].get("passed") and not causes):
        count = "1 object does" if len(moving) == 1 else f"{len(moving)} objects do"
        error += f'<p class="bad">Before the search {count} not stay: {text("; ".join(moving))}</p>'
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
    title = "1 fallback was used" if len(entries) == 1 else f"{len(entries)} fallbacks were used"
    return section(title, _listed(entries), kind="warn")


def _notes(run: dict[str, Any]) -> Html:
    entries = run.get("notes", [])
    return section("Far moves", _listed(entries)) if entries else Html("")


def _listed(entries: Sequence[dict[str, str]]) -> Html:
    items = "".join(
        f"<li><b>{text(e['step'])}</b>: {text(e['what'])} — {text(e['why'])}</li>" for e in entries
    )
    return Html(f"<ul>{items}</ul>")


def _numbers(run: dict[str, Any]) -> Html:
    metrics = run["metrics"]
    if not metrics:
        return section("Numbers", missing(f"Measured after refine; {where(run)}."))
    limits = run["config"]["refine"]
    cards = []

    def add(key: str, name: str, text: str, limit: str = "", passed: bool | None = None) -> None:
        if key in metrics:
            cards.append(card(name, text if metrics[key] is not None else "unknown", limit, passed))

    def number(key: str) -> float:
        value = metrics.get(key)
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
    stable = metrics.get("s_stab")
    fell = "" if stable is None else "free fall"
    add("s_stab", "S-Stab", "stable" if stable else "not stable", fell, stable)
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
    add(
        "movable",
        "movable objects",
        f"{number('movable'):.0f}",
        f"of {metrics.get('objects', '?')}",
    )
    scale = number("mean_log_scale")
    percent = f"mean size {100 * math.expm1(scale):+.1f} %" if math.isfinite(scale) else ""
    add("mean_log_scale", "mean log scale", f"{scale:+.4f}", percent)
    moved = f"{number('mean_shift_m') * 1000:.1f} mm, {number('mean_turn_deg'):.1f}°"
    add("mean_shift_m", "moved from the parse", moved, "mean of optimised objects")
    total = sum(entry["seconds"] for entry in run["steps"].values())
    cards.append(card("all steps", f"{total:.1f} s"))
    return section("Numbers", f'<div class="cards">{"".join(cards)}</div>')


def _pictures(folder: Path) -> Html:
    pictures = [
        picture(folder / PHOTO, "Photograph"),
        picture(folder / BEFORE, "Composed, before refinement"),
        picture(folder / AFTER, "Refined"),
    ]
    return section("Before and after", f'<div class="pictures">{"".join(pictures)}</div>')


def _time(run: dict[str, Any]) -> Html:
    spent: dict[str, float] = {}
    waiting: dict[str, float] = {}
    for name, entry in run["steps"].items():
        head = name.partition("/")[0]
        spent[head] = spent.get(head, 0.0) + entry["seconds"]
        waiting[head] = waiting.get(head, 0.0) + entry.get("waiting_s", 0.0)
    if not spent:
        return section("Time", missing("No step has finished yet."))
    items = [(step, spent[step]) for step in STEPS if step in spent]
    awaited = [f"{step} {waiting[step]:.1f} s" for step, _ in items if waiting[step] >= 0.05]
    line = f"<p>Of these, waiting for answers: {', '.join(awaited) or 'nothing'}.</p>"
    return section("Time", f'<div style="max-width:620px">{charts.bars(items, "s")}</div>', line)


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


def _differences(default: Any, configured: Any, at: str = "") -> list[tuple[str, Any, Any]]:
    if isinstance(default, dict) and isinstance(configured, dict):
        differences = []
        for key in {*default, *configured}:
            where = f"{at}.{key}" if at else str(key)
            differences += _differences(default.get(key), configured.get(key), where)
        return differences
    return [] if default == configured else [(at, default, configured)]
