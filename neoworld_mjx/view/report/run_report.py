"""Write report.html, a report on a run in one page.

The page needs no server and no network. The report can be written after any step. It shows the
contents of the run folder and names missing files. Verdicts and numbers come from run.json and
verify.json.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jinja2 import TemplateError
from markupsafe import Markup

from ...config import Config
from ...errors import NeoWorldError, RunError
from ...io.files import write_atomic
from ...run_folder import STEPS, read_run, refuse_links
from ...spec import read_scene
from . import (
    changes,
    charts,
    convergence,
    film_strips,
    object_rows,
    photograph_section,
    scene_3d,
)
from .formatting import progress_of, read_json
from .page import document, elements
from .pictures import picture
from .tables import agreement, joints, parse_section, penetrations, scene_section

_ERRORS = (
    *(ArithmeticError, AttributeError, LookupError, MemoryError, NeoWorldError),
    *(TemplateError, TypeError, ValueError),
)
"""Exceptions that a section may raise if a file has an unexpected structure."""
SECTIONS_NOT_IN_RESCUE = (
    *("Before and after", object_rows.TITLE, "Parse", changes.TITLE, "Models"),
    "Agreement with the photograph",
)
"""Sections about steps that do not belong to a rescue."""


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
    title = run["photo"].get("name") or folder.resolve().name
    sections: list[tuple[str, Callable[[], Markup]]] = [
        (title, lambda: _header(run, title, folder)),
        ("Fallbacks", lambda: _fallbacks(run)),
        ("Notes", lambda: _notes(run)),
        (changes.RESCUE, lambda: changes.given_moves(folder)),
        ("Numbers", lambda: _numbers(run)),
        ("Before and after", lambda: _pictures(folder)),
        (photograph_section.TITLE, lambda: photograph_section.photograph_section(folder)),
        (object_rows.TITLE, lambda: object_rows.object_rows(folder, run, tree)),
        (scene_3d.TITLE, lambda: _scene_3d(folder)),
        (film_strips.TITLE, lambda: _film_strips(folder, run)),
        ("Parse", lambda: parse_section(folder, tree)),
        (changes.TITLE, lambda: changes.changes(folder)),
        ("Scene", lambda: scene_section(scene)),
        ("Agreement with the photograph", lambda: agreement(run)),
        (
            convergence.TITLE,
            lambda: convergence.convergence(folder / "refine" / "history.npz"),
        ),
        ("Joints", lambda: joints(folder, scene)),
        ("Penetrations and drift", lambda: penetrations(run)),
        ("Time", lambda: _time(run)),
        ("Models", lambda: _models(run)),
        ("Options and versions", lambda: _settings(run)),
    ]
    if (folder / changes.GIVEN).is_file():
        sections = [entry for entry in sections if entry[0] not in SECTIONS_NOT_IN_RESCUE]
    page = document(
        f"{title}: scene report",
        [_draw_section(name, section) for name, section in sections],
        [scene_3d.script_hash()],
    )
    path = folder / "report.html"
    try:
        # JSON escapes may contain unpaired surrogates, which become question marks.
        write_atomic(path, page.encode("utf-8", "replace"))
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None
    return path


def _draw_section(title: str, section: Callable[[], Markup]) -> Markup:
    """Return a section, or a note if a file does not have the expected structure."""
    try:
        return section()
    except _ERRORS as error:
        note = f"A file of this run has an unexpected structure: {type(error).__name__}: {error}"
        return elements.section(title, elements.missing(note))


def _header(run: dict[str, Any], title: str, folder: Path) -> Markup:
    """Return the header with the status of the run, and reasons if the scene is not valid."""
    status = str(run["status"])
    color = {"finished": "good", "failed": "bad", "interrupted": "bad"}.get(status, "dim")
    errors = [run["error"]] if run.get("error") else []
    causes, passed = object_rows.violated_limits(run), run["metrics"].get("passed")
    if causes or passed is False:
        status, color = f"{status}, but the scene is not valid", "bad"
        details = "; ".join(f"{name} {', '.join(reasons)}" for name, reasons in causes.items())
        errors.append(f"Not valid: {details or 'see the numbers below'}")
    elif passed:
        status = f"{status}, valid"
    check = read_json(folder / "compose" / "check.json") or {}
    moving = [str(entry["phrase"]) for entry in check.get("unstable", [])]
    if moving and not (passed and not causes):
        count = "1 object does" if len(moving) == 1 else f"{len(moving)} objects do"
        errors.append(f"Before the search {count} not stay in place: {'; '.join(moving)}")
    facts = [
        f"seed {run.get('seeds', {}).get('run')}",
        f"options {run.get('fingerprint')}",
        f"engine {run['device']['engine']}" if run["device"].get("engine") else "",
        f"on {run['device'].get('cores')} cores",
        f"started {run['started']}" if run.get("started") else "",
    ]
    return elements.header(title, status, color, " · ".join(filter(None, facts)), errors)


def _fallbacks(run: dict[str, Any]) -> Markup:
    entries = run["fallbacks"]
    if not entries:
        return elements.paragraph("No fallback was used.", "dim")
    title = "1 fallback was used" if len(entries) == 1 else f"{len(entries)} fallbacks were used"
    return elements.section(title, elements.entries(entries), kind="warn")


def _notes(run: dict[str, Any]) -> Markup:
    entries = run.get("notes", [])
    return elements.section("Notes", elements.entries(entries)) if entries else Markup()


def _numbers(run: dict[str, Any]) -> Markup:
    metrics = run["metrics"]
    if not metrics:
        note = f"Measured after refine; {progress_of(run)}."
        return elements.section("Numbers", elements.missing(note))
    limits = run["config"]["refine"]

    def number(key: str) -> float:
        value = metrics.get(key)
        return math.nan if value is None else float(value)

    pairs, depth, drift = number("s_pen"), number("max_depth_m"), number("max_drift_m")
    turn, scale, stable = number("max_tilt_deg"), number("mean_log_scale"), metrics.get("s_stab")
    shift = f"{number('mean_shift_m') * 1000:.1f} mm, {number('mean_turn_deg'):.1f}°"
    drift_limit = f"{limits['max_drift_m'] * 1000:g} mm in {limits['check_duration_s']:g} s"
    cards: list[tuple[str, str, str, str, bool | None]] = [
        ("s_pen", "S-Pen (exported scene)", f"{pairs:.0f}", "target 0", pairs == 0),
        (
            *("max_depth_m", "deepest penetration", f"{depth * 1000:.2f} mm"),
            *(f"limit {limits['max_depth_m'] * 1000:g} mm", depth <= limits["max_depth_m"]),
        ),
        ("s_stab", "S-Stab", "stable" if stable else "not stable", "free fall", stable),
        (
            *("max_drift_m", "largest drift", f"{drift * 1000:.2f} mm"),
            *(f"limit {drift_limit}", drift < limits["max_drift_m"]),
        ),
        (
            *("max_tilt_deg", "largest turn", f"{turn:.2f}°"),
            *(f"limit {limits['max_tilt_deg']:g}°", turn < limits["max_tilt_deg"]),
        ),
        (
            *("movable", "movable objects", f"{number('movable'):.0f}"),
            *(f"of {metrics.get('objects', '?')}", None),
        ),
        (
            *("mean_log_scale", "mean log scale", f"{scale:+.4f}"),
            *(f"mean size {100 * math.expm1(scale):+.1f} %", None),
        ),
        (
            "mean_shift_m",
            "moved after composition",
            shift,
            "mean, settling and tilt included",
            None,
        ),
    ]
    drawn = [
        elements.card(name, value, limit, passed)
        if metrics[key] is not None
        else elements.card(name, "unknown", limit if passed is not None else "", passed)
        for key, name, value, limit, passed in cards
        if key in metrics
    ]
    waited = sum(entry.get("waiting_s", 0.0) for entry in run["steps"].values())
    total = sum(entry["seconds"] for entry in run["steps"].values()) - waited
    waits = f"and {waited:.1f} s of waiting for models" if waited >= 0.05 else ""
    drawn.append(elements.card("computing, all steps", f"{total:.1f} s", waits))
    return elements.section("Numbers", elements.div("cards", *drawn))


def _pictures(folder: Path) -> Markup:
    pictures = [
        picture(folder / "photo.png", "Photograph"),
        picture(folder / "pictures" / "before.png", "Composed, before refinement"),
        picture(folder / "pictures" / "after.png", "Refined"),
    ]
    return elements.section("Before and after", elements.div("pictures", *pictures))


def _scene_3d(folder: Path) -> Markup:
    """Return the interactive view of the refined scene or, if missing, of the composed scene."""
    for name in ("scene.json", "compose/scene.json"):
        if (folder / name).is_file():
            return scene_3d.scene_3d(read_scene(folder / name))
    return elements.section(scene_3d.TITLE, elements.missing("No scene.json yet."))


def _film_strips(folder: Path, run: dict[str, Any]) -> Markup:
    return film_strips.film_strips(folder, float(run["config"]["refine"]["check_duration_s"]))


def _time(run: dict[str, Any]) -> Markup:
    seconds: dict[str, float] = {}
    waiting: dict[str, float] = {}
    for name, entry in run["steps"].items():
        step = name.partition("/")[0]
        seconds[step] = seconds.get(step, 0.0) + entry["seconds"]
        waiting[step] = waiting.get(step, 0.0) + entry.get("waiting_s", 0.0)
    if not seconds:
        return elements.section("Time", elements.missing("No step has finished yet."))
    steps = [step for step in STEPS if step in seconds]
    waits = [f"{step} {waiting[step]:.1f} s" for step in steps if waiting[step] >= 0.05]
    computing = [(step, max(seconds[step] - waiting[step], 0.0)) for step in steps]
    return elements.section(
        "Time",
        elements.div("bars", charts.bars(computing, "s")),
        elements.paragraph(f"In addition, waiting for models: {', '.join(waits) or 'none'}."),
    )


def _models(run: dict[str, Any]) -> Markup:
    used = run["mllm"]
    if not used:
        return elements.section("Models", elements.missing("No model was called yet."))
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
    provider = f"Provider: {used['provider']}." if used.get("provider") else ""
    cost = "unknown" if used.get("cost_usd") is None else f"{used['cost_usd']:.4f} USD"
    return elements.section(
        "Models",
        elements.paragraph(provider),
        elements.paragraph(f"{used.get('calls', 0)} calls, cost {cost}."),
        elements.table(heads, rows) if rows else "",
    )


def _settings(run: dict[str, Any]) -> Markup:
    changed = sorted(_differences(Config().model_dump(mode="json"), run["config"] or {}))
    rows = [[key, json.dumps(new), json.dumps(old)] for key, old, new in changed]
    versions = elements.table(["package", "version"], sorted((run["versions"] or {}).items()))
    options = elements.preformatted(json.dumps(run["config"], indent=1))
    return elements.section(
        "Options and versions",
        elements.table(["option", "value", "default"], rows)
        if rows
        else elements.paragraph("All options have their default values."),
        elements.details("all options", options),
        elements.details("versions", versions),
    )


def _differences(default: Any, configured: Any, path: str = "") -> list[tuple[str, Any, Any]]:
    """Return the path, default and value of each option that differs from its default."""
    if isinstance(default, dict) and isinstance(configured, dict):
        return [
            difference
            for key in {*default, *configured}
            for difference in _differences(
                default.get(key), configured.get(key), f"{path}.{key}" if path else str(key)
            )
        ]
    return [] if default == configured else [(path, default, configured)]
