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

import numpy as np
from jinja2 import TemplateError
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from ...config import Config
from ...errors import NeoWorldError, RunError
from ...io import read_arrays
from ...io.files import write_output
from ...quantities import count
from ...run_folder import STEPS, read_run, refuse_links, step_times, verdict_line
from ...spec import read_scene
from . import objects, photograph, scene_3d
from .page import document, elements, picture, read_json

_ERRORS = (
    *(ArithmeticError, AttributeError, LookupError, MemoryError, NeoWorldError),
    *(TemplateError, TypeError, ValueError),
)
"""Exceptions that a section may raise if a file has an unexpected structure."""


def write_report(folder: Path) -> Path:
    """Write `report.html` into a run folder and return its path.

    Raises:
        RunError: the folder is not a run folder.
    """
    folder = Path(folder)
    run = read_run(folder)
    refuse_links(folder)
    tree = read_json(folder / "tree.json") or {}
    title = run["photo"].get("name") or folder.resolve().name
    sections: list[tuple[str, Callable[[], Markup]]] = [
        (title, lambda: _header(run, title)),
        ("Fallbacks", lambda: _fallbacks(run)),
        ("Notes", lambda: _notes(run)),
        ("Checks", lambda: _checks(run)),
        ("Pictures", lambda: _pictures(folder, tree)),
        (photograph.TITLE, lambda: photograph.photograph_section(folder)),
        (objects.TITLE, lambda: objects.object_rows(folder, run, tree)),
        (scene_3d.TITLE, lambda: _scene_3d(folder)),
        (SEARCH, lambda: _convergence(folder / "refine" / "history.npz")),
        ("Time", lambda: _time(run)),
        ("Models", lambda: _models(run)),
        ("Options and versions", lambda: _settings(run)),
    ]
    page = document(
        f"{title}: scene report",
        [_draw_section(name, section) for name, section in sections],
        [scene_3d.script_hash()],
    )
    path = folder / "report.html"
    # JSON escapes may contain unpaired surrogates, which become question marks.
    write_output(path, page.encode("utf-8", "replace"), RunError)
    return path


def _draw_section(title: str, section: Callable[[], Markup]) -> Markup:
    """Return a section, or a note if a file does not have the expected structure."""
    try:
        return section()
    except _ERRORS as error:
        note = f"A file of this run has an unexpected structure: {type(error).__name__}: {error}"
        return elements.section(title, elements.missing(note))


def _header(run: dict[str, Any], title: str) -> Markup:
    """Return the header with the status of the run and the verdict on its scene."""
    status, metrics = str(run["status"]), run["metrics"]
    passed = metrics.get("passed")
    color = {"finished": "good", "failed": "bad", "interrupted": "bad"}.get(status, "dim")
    errors = [run["error"]] if run.get("error") else []
    if passed is False:
        color = "bad"
        errors.append(verdict_line(metrics))
    else:
        status = f"{status}, {verdict_line(metrics)}"
    facts = [
        f"seed {run.get('seeds', {}).get('run')}",
        f"options {run.get('fingerprint')}",
        f"engine {metrics['engine']}" if metrics.get("engine") else "",
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


def _checks(run: dict[str, Any]) -> Markup:
    """Return the checks of the refined scene."""
    metrics = run["metrics"]
    if not metrics:
        finished = {name.partition("/")[0] for name in run["steps"]}
        steps = ", ".join(step for step in STEPS if step in finished) or "none"
        note = f"Checked after refine; this run is {run['status']}; finished steps: {steps}."
        return elements.section("Checks", elements.missing(note))
    rows = [
        [elements.verdict(bool(check["passed"])), check["phrase"]]
        for check in metrics.get("checks", ())
    ]
    facts = [f"{count(metrics.get('movable', 0), 'movable object')} of {metrics.get('objects')}"]
    iou = (metrics.get("box_iou") or {}).get("refined")
    if iou is not None:
        facts.append(f"mean IoU of the visible and the parsed 2D boxes {iou:.2f}")
    duration = run["config"]["refine"]["check_duration_s"]
    return elements.section(
        "Checks",
        elements.table(["verdict", f"check, motions in {duration:g} s of free fall"], rows),
        elements.paragraph("; ".join(facts) + "."),
    )


def _pictures(folder: Path, tree: dict[str, Any]) -> Markup:
    camera = tree.get("camera")
    boxes = "Parsed boxes"
    if isinstance(camera, dict):
        pitch, fovy = math.degrees(camera["pitch"]), math.degrees(camera["fovy"])
        boxes += (
            f"; camera {camera['height']:.2f} m high, pitched down {pitch:.1f}°, vertical field of "
            f"view {fovy:.1f}°"
        )
    captions = {
        "photo.png": "Photograph",
        "pictures/parse.png": boxes,
        "pictures/before.png": "Composed, before refinement",
        "pictures/after.png": "Refined",
    }
    files = {folder / file: caption for file, caption in captions.items()}
    pictures = [picture(file, caption) for file, caption in files.items() if file.is_file()]
    shown = (
        elements.div("pictures", *pictures) if pictures else elements.missing("No pictures yet.")
    )
    return elements.section("Pictures", shown)


def _scene_3d(folder: Path) -> Markup:
    """Return the interactive view of the refined scene or, if missing, of the composed scene."""
    for name in ("scene.json", "compose/scene.json"):
        if (folder / name).is_file():
            return scene_3d.scene_3d(read_scene(folder / name))
    return elements.section(scene_3d.TITLE, elements.missing("No scene.json yet."))


def _time(run: dict[str, Any]) -> Markup:
    times = step_times(run)
    if not times:
        return elements.section("Time", elements.missing("No step has finished yet."))
    rows = [
        [step, f"{max(times[step][0] - times[step][1], 0.0):.1f}", f"{times[step][1]:.1f}"]
        for step in STEPS
        if step in times
    ]
    return elements.section(
        "Time", elements.table(["step", "#computing, s", "#waiting for models, s"], rows)
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
    cost = "unknown" if used.get("cost_usd") is None else f"{used['cost_usd']:.4f} USD"
    provider, calls = used.get("provider", "unknown"), used.get("calls", 0)
    return elements.section(
        "Models",
        elements.paragraph(f"Provider {provider}: {calls} calls, cost {cost}."),
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


SEARCH = "Convergence of the search"
_TERMS = "Terms are those of the candidate with the best reward, in SI units, with their weights."


def _convergence(path: Path) -> Markup:
    """Return the section with rewards, terms and numbers of candidates by iteration.

    Args:
        path: history.npz, with the arrays `reward`, `valid` and `status` and an array for each
            name in `term_names`, all of shape [iteration, candidate], and `term_weights` [term].
    """
    if not path.exists():
        return elements.section(SEARCH, elements.missing("No refine/history.npz yet."))
    try:
        history = read_arrays(path, RunError)
    except RunError as error:
        note = f"refine/history.npz cannot be read: {error}"
        return elements.section(SEARCH, elements.missing(note))
    reward = history["reward"]
    if not len(reward):
        note = "The composed scene was accepted; no search was needed."
        return elements.section(SEARCH, elements.paragraph(note))
    names = [str(name) for name in history["term_names"]]
    valid = np.sum(history["valid"], axis=1)
    failed = np.sum(~np.isfinite(reward), axis=1)
    best, mean = _over_finite(reward, np.max), _over_finite(reward, np.mean)
    chosen = np.where(np.isfinite(reward), reward, -np.inf).argmax(axis=1)
    rows = [
        [
            *(t + 1, f"{best[t]:.4f}", f"{mean[t]:.4f}", reward.shape[1], valid[t], failed[t]),
            *(f"{history[name][t, chosen[t]]:.4g}" for name in names),
        ]
        for t in range(len(reward))
    ]
    heads = ["#iteration", "#best reward", "#mean reward", "#sampled", "#valid", "#failed"]
    weights = history["term_weights"]
    heads += [f"#{name} × {weight:g}" for name, weight in zip(names, weights, strict=True)]
    return elements.section(SEARCH, elements.table(heads, rows), elements.paragraph(_TERMS, "dim"))


def _over_finite(values: ArrayLike, function: Callable[[NDArray], Any]) -> NDArray:
    """Reduce the finite values of each iteration to one number, or NaN if there are none."""
    rows = [row[np.isfinite(row)] for row in np.asarray(values, float)]
    return np.array([float(function(row)) if row.size else np.nan for row in rows])
