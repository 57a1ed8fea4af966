"""One run of a sweep: the scene, its refinement with the options of a point, and its row."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ..benchmark import named_scenes
from ..cache import compiled
from ..errors import SpecError, choices
from ..physics.engine import open_engine
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.native import NativeEngine
from ..search.loop import Iteration
from ..search.scene_refinement import Refined, read_composed, refine
from ..search.searched_scene import compile_for_search
from ..spec import SceneSpec
from .plan import Point

Row = dict[str, Any]
"""Row of a run (scene, point, seed, values of the point, and results), or of an iteration."""
Key = tuple[str, str, int]
"""Scene, point and seed of a run."""

KEYS: dict[str, type] = {"scene": str, "point": str, "seed": int}
"""Columns that identify a run."""
TERM_COLUMNS = {"d_pen": "d_pen_m", "d_drift": "d_drift", "s_sem": "s_sem", "prior": "prior"}
"""Columns of the reward terms that every run has, by the name of the term."""
TERM = "term_"
"""Prefix of the columns of further reward terms."""
_TERMS: dict[str, type] = dict.fromkeys(TERM_COLUMNS.values(), float)

COLUMNS: dict[str, type] = {
    "valid": bool,
    "passed": bool,
    "reward": float,
    **_TERMS,
    "iterations": int,
    "rollouts": int,
    "iterations_to_valid": int,
    "rollouts_to_valid": int,
    "mean_log_scale": float,
    "max_depth_m": float,
    "max_drift_m": float,
    "max_tilt_deg": float,
    "xy_error_m": float,
    "yaw_error_deg": float,
    "scale_error": float,
    "box_iou": float,
    "seconds": float,
    "to_valid_s": float,
    "engine": str,
    "fingerprint": str,
}
"""Columns of a run. A value is None if it does not apply to the run.

- `passed`, `max_depth_m`, `max_drift_m` and `max_tilt_deg`: result and measures of the final check.
- `valid`, `reward` and the terms: values of the winning candidate, by which the search ranked it.
- `xy_error_m`, `yaw_error_deg`, `scale_error` and `box_iou`: errors of the delivered scene, if the
  scene has ground truth. `box_iou` compares visible boxes with the parsed boxes.
- `iterations_to_valid` and `rollouts_to_valid`: iterations and rollouts up to the end of the first
  iteration with a valid candidate. They are 0 if the initial layout passes the final check; it is
  then not scored.
- `seconds` and `to_valid_s`: times of the search and of its part up to the first valid candidate,
  without compilation.
"""

ITERATION_COLUMNS: dict[str, type] = {
    **KEYS,
    "iteration": int,
    "rollouts": int,
    "best": float,
    "mean": float,
    "valid": float,
    **_TERMS,
}
"""Columns of an iteration.

- `iteration`: number of the iteration, counted from 1.
- `rollouts`: number of rollouts so far.
- `best`: best reward so far.
- `mean`: mean reward of the candidates that did not fail.
- `valid`: fraction of the candidates that are valid.
- The terms, and a column for each further reward term: values of the iteration's best candidate.
"""


@dataclass(frozen=True)
class Case:
    """A scene to refine."""

    name: str
    scene: SceneSpec
    start: Callable[[SceneModel, int], Layout] | None = None
    """Function that returns a layout for a seed, with a population axis of length 1, of which the
    initial scene is made.

    If None, the search starts at the composed scene."""
    errors: Callable[[SceneSpec], dict[str, float]] | None = None
    """Function that returns the errors of a delivered scene; None if there is no ground truth."""


def case(name: str) -> Case:
    """Return a scene by name: KIND:NAME, or the path of a scene.json or of a run folder.

    The benchmark has scenes of the kinds `bench`, `crowded` and `photo`. The scene of a run folder
    is the composed scene, before refinement.

    Raises:
        SpecError: the scene does not exist.
    """
    sources = named_scenes()
    kind, colon, inner = name.partition(":")
    if colon and kind in sources:
        return sources[kind](inner)
    path = Path(name)
    if not path.exists():
        if colon:
            raise SpecError(f"scene {name}: {choices(kind, sources)}, or the path of a file")
        kinds = ", ".join(f"{kind}:NAME" for kind in sources)
        raise SpecError(f"scene {name}: no such file or folder, nor is it one of {kinds}")
    return Case(name, read_composed(path))


class Run(NamedTuple):
    """Refinement of a scene with the options of a point and a seed."""

    case: Case
    point: Point
    seed: int
    fingerprint: str
    """Hash of everything on which the row depends."""
    threads: int
    """Number of threads of an engine that runs on the CPU."""


def compute(run: Run) -> Iterator[Row]:
    """Refine the scene of a run, and yield its row.

    A row has the columns KEYS, the values of the point, COLUMNS, and a column for each further
    reward term. Under "history" it has the iterations, with ITERATION_COLUMNS but without KEYS.
    """
    options, scene = run.point.options, run.case.scene
    engine = open_engine(options.rollout.engine)
    if isinstance(engine, NativeEngine):
        engine.threads = run.threads
    if run.case.start is not None:
        model = compile_for_search(scene, options)
        scene = model.apply(run.case.start(model, run.seed), 0)
    iterations: list[Iteration] = []
    compile_s: list[float] = []  # Time of compilation up to the end of each iteration.
    before = compiled().seconds

    def on_iteration(iteration: Iteration) -> None:
        iterations.append(iteration)
        compile_s.append(compiled().seconds - before)

    refined = refine(scene, options, seed=run.seed, engine=engine, on_iteration=on_iteration)
    first = next((k for k, step in enumerate(iterations) if step.valid), None)
    numbers: dict[str, Any] = {"iterations": None, "rollouts": None, "s": None}
    if first is not None:
        numbers = {
            "iterations": first + 1,
            "rollouts": sum(step.candidates for step in iterations[: first + 1]),
            "s": max(refined.seconds["to_valid"] - compile_s[first], 0.0),
        }
    elif refined.passed:
        numbers = {"iterations": 0, "rollouts": 0, "s": refined.seconds["to_valid"]}
    yield {
        "scene": run.case.name,
        "point": run.point.label,
        "seed": run.seed,
        **run.point.values,
        "passed": refined.passed,
        **_score_columns(refined),
        "iterations": refined.iterations,
        "rollouts": refined.rollouts,
        "iterations_to_valid": numbers["iterations"],
        "rollouts_to_valid": numbers["rollouts"],
        "mean_log_scale": refined.mean_log_scale,
        "max_depth_m": refined.measure.max_depth_m,
        "max_drift_m": refined.measure.max_drift_m,
        "max_tilt_deg": refined.measure.max_tilt_deg,
        **_error_columns(run.case, refined.scene),
        "seconds": max(refined.seconds["search"] - max(compile_s, default=0.0), 0.0),
        "to_valid_s": numbers["s"],
        "engine": refined.engine,
        "fingerprint": run.fingerprint,
        "history": _iteration_rows(iterations),
    }


def _score_columns(refined: Refined) -> Row:
    """Return the scores of the winning candidate; None if not finite."""
    scores = refined.scores
    row: Row = {"valid": bool(scores.get("valid", refined.passed))}
    for name in ("reward", *map(str, refined.history["term_names"])):
        value = scores.get(name, math.nan)
        column = name if name == "reward" else TERM_COLUMNS.get(name, TERM + name)
        row[column] = value if math.isfinite(value) else None
    return row


def _error_columns(case: Case, scene: SceneSpec) -> Row:
    errors = case.errors(scene) if case.errors is not None else {}
    return {
        "xy_error_m": errors.get("xy_m"),
        "yaw_error_deg": errors.get("yaw_deg"),
        "scale_error": errors.get("scale"),
        "box_iou": errors.get("box_iou"),
    }


def _iteration_rows(iterations: list[Iteration]) -> list[Row]:
    rows: list[Row] = []
    best: list[float] = []
    rollouts = 0
    for number, step in enumerate(iterations, start=1):
        rollouts += step.candidates
        best += [] if step.best is None else [step.best]
        rows.append(
            {
                "iteration": number,
                "rollouts": rollouts,
                "best": max(best, default=None),
                "mean": step.mean,
                "valid": step.valid / max(step.candidates, 1),
                **{TERM_COLUMNS.get(name, name): value for name, value in step.terms.items()},
            }
        )
    return rows
