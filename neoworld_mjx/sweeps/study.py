"""Studies: adaptive search for options by Optuna (Akiba et al., arXiv:1907.10902).

Each trial refines one point of the sweep with every seed on every scene. The value of a trial is
the mean of a column of its rows. With several worker processes, the same number of trials run at a
time. Optuna is installed by the extra `optuna`.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import ConfigError, EngineError, RunError, choices
from ..io.files import content_hash
from ..progress import report
from .axes import read_axes
from .cases import Case
from .folder import SweepFolder, sweep_of
from .plan import Plan, Point, point_of, points, shared_config, takes_integers
from .result import SweepResult, stored_result
from .run_rows import COLUMNS, Row

JOURNAL = "study.journal"
"""Name of Optuna's journal in the folder of a sweep."""


class StudyTask(NamedTuple):
    """Refinements of one scene in a trial."""

    trial: int
    """Index of the trial among those that run at the same time."""
    plan: Plan
    """Plan whose only point is the point of the trial."""
    case: Case


RunPoints = Callable[[Sequence[StudyTask]], Iterable[tuple[int, SweepResult]]]
"""Function that runs tasks, and returns `StudyTask.trial` and the result of each, in any order."""


def open_optuna() -> Any:
    """Import Optuna.

    Raises:
        EngineError: Optuna is not installed.
    """
    try:
        import optuna  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise EngineError("study needs optuna: uv sync --inexact --extra optuna") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def check_study(plan: Plan) -> None:
    """Validate a plan with a study, before anything runs.

    Raises:
        ConfigError: the goal is not a numeric column, there are no axes, the plan has `zip` or
            `samples`, or an option is invalid.
        EngineError: Optuna is not installed.
    """
    assert plan.study is not None
    numeric = [name for name, kind in COLUMNS.items() if kind in (float, int, bool)]
    if plan.study.goal not in numeric:
        raise ConfigError(f"study.goal: {choices(plan.study.goal, numeric)}")
    if not plan.axes or plan.zip or plan.samples:
        raise ConfigError("study: the trials choose the values of axes, without zip and samples")
    # Validate every value of a list and both ends of a range.
    ends = {
        path: value
        if isinstance(value, list | tuple)
        else [dict(value).get("low"), dict(value).get("high")]
        for path, value in plan.axes.items()
        if isinstance(value, list | tuple | Mapping)
    }
    read_axes(plan.axes, takes_integers)
    for path, values in ends.items():
        points(plan.model_copy(update={"axes": {path: list(dict.fromkeys(values))}}))
    open_optuna()


def run_study(
    plan: Plan,
    cases: Sequence[Case],
    run_points: RunPoints,
    out: Path | None,
    *,
    width: int = 1,
    resume: bool,
    overwrite: bool,
) -> SweepResult:
    """Run the trials of a plan's study, and save the rows and tables after every `width` trials.

    A resumed study continues with its journal. The trials that were running when it was killed are
    run again. With `prune`, a trial ends early if its mean over the first scenes is among the worst
    two thirds (asynchronous successive halving).

    Args:
        plan: the plan, which `check_study` has accepted.
        cases: the scenes.
        run_points: function that runs the refinements.
        out: folder of the sweep and of Optuna's journal. If None, both are kept in memory.
        width: number of trials that run at a time. Their points are chosen without knowledge of
            each other's values.
        resume: continue the study in `out`.
        overwrite: replace the study in `out`.

    Raises:
        RunError: the folder cannot be written, or contains a study of another plan.
    """
    if out is None:
        return _trials(plan, cases, run_points, width, None, [], None)
    with SweepFolder(out, "sweep", resume=resume, overwrite=overwrite) as folder:
        about = sweep_of(out) or {}
        if overwrite:
            (out / JOURNAL).unlink(missing_ok=True)
        elif folder.rows and _identity(about.get("plan", {})) != _identity(_json(plan)):
            raise RunError(
                f"{out} holds a study of another plan: only study.trials may change; use "
                "--overwrite, or name a new folder"
            )
        return _trials(plan, cases, run_points, width, folder, folder.rows, about)


def _json(plan: Plan) -> dict[str, Any]:
    return plan.model_dump(mode="json")


def _identity(plan: Mapping[str, Any]) -> str:
    study = {k: v for k, v in (plan.get("study") or {}).items() if k != "trials"}
    return content_hash([{**plan, "study": study}])


def _trials(
    plan: Plan,
    cases: Sequence[Case],
    run_points: RunPoints,
    width: int,
    folder: SweepFolder | None,
    rows: list[Row],
    earlier: Mapping[str, Any] | None,
) -> SweepResult:
    optuna, options = open_optuna(), plan.study
    assert options is not None
    study = _open_study(plan, optuna, folder)
    complete = (optuna.trial.TrialState.COMPLETE, optuna.trial.TrialState.PRUNED)
    finished_trials = [
        trial for trial in study.get_trials(deepcopy=False) if trial.state in complete
    ]
    labels = {trial.user_attrs["point"] for trial in finished_trials}
    by_point = {label: [row for row in rows if row["point"] == label] for label in labels}
    earlier_points = list((earlier or {}).get("points", []))
    about: dict[str, Any] = {
        "points": [p for p in earlier_points if p["label"] in labels],
        "groups": [],
    }
    base = shared_config(plan).model_dump(mode="json")
    result: SweepResult | None = None
    for first in range(len(finished_trials), options.trials, width):
        trials = [study.ask() for _ in range(first, min(first + width, options.trials))]
        trial_points = [point_of(base, _suggest_values(plan, trial)) for trial in trials]
        for trial, point in zip(trials, trial_points, strict=True):
            trial.set_user_attr("point", point.label)
        collected: list[list[Row]] = [[] for _ in trials]
        running = list(range(len(trials)))
        # With pruning, scenes are run one after the other; otherwise all are run at once.
        for scenes in [[case] for case in cases] if options.prune else [cases]:
            tasks = [
                StudyTask(k, _single_point_plan(plan, trial_points[k]), case)
                for k in running
                for case in scenes
            ]
            for k, part in run_points(tasks):
                collected[k] += part.rows
                groups = about["groups"] + part.about["groups"]
                about = {**part.about, "points": about["points"], "groups": groups}
            for k in running:
                step = len({row["scene"] for row in collected[k]})
                trials[k].report(_value(collected[k], plan), step=step)
            if options.prune and scenes[-1] is not cases[-1]:
                ending = [k for k in running if trials[k].should_prune()]
                for k in ending:
                    study.tell(trials[k], state=optuna.trial.TrialState.PRUNED)
                running = [k for k in running if k not in ending]
        for k, point in enumerate(trial_points):
            if k in running:
                study.tell(trials[k], _value(collected[k], plan))
            if point.label not in by_point:
                about["points"].append({"label": point.label, **point.values})
            order = [case.name for case in cases]
            by_point[point.label] = sorted(
                collected[k], key=lambda row: (order.index(row["scene"]), row["seed"])
            )
            report(f"trial {first + k + 1} of {options.trials}: {point.label}: "
                   f"{options.goal} {_value(collected[k], plan):.4g}")  # fmt: skip
        result = _save(plan, cases, about, by_point, folder, first + width >= options.trials)
    if result is None:
        if earlier is None or "kind" not in earlier:
            raise RunError("the study is complete, but its sweep.json is damaged; use --overwrite")
        about = {**earlier, "points": about["points"]}
        result = _save(plan, cases, about, by_point, folder, finished=True)
    return result


def _single_point_plan(plan: Plan, point: Point) -> Plan:
    """Return a plan whose only point is the given one, without scenes."""
    axes = {path: [value] for path, value in point.values.items()}
    return plan.model_copy(update={"axes": axes, "study": None, "scenes": ()})


def _save(
    plan: Plan,
    cases: Sequence[Case],
    about: dict[str, Any],
    by_point: Mapping[str, list[Row]],
    folder: SweepFolder | None,
    finished: bool,
) -> SweepResult:
    options = plan.study
    assert options is not None
    values = {label: _value(rows, plan) for label, rows in by_point.items()}
    best_of = max if options.direction == "maximize" else min
    # A pruned trial lacks the rows of some scenes.
    complete = {
        label: value
        for label, value in values.items()
        if len(by_point[label]) == len(cases) * len(plan.seeds)
    }
    best = best_of(complete, key=lambda label: complete[label]) if complete else None
    about = {
        **about,
        "plan": _json(plan),
        "scenes": [case.name for case in cases],
        "best": None if best is None else {"point": best, options.goal: complete[best]},
    }
    rows = [row for point in about["points"] for row in by_point[point["label"]]]
    return stored_result(rows, about, folder, finished=finished)


def _open_study(plan: Plan, optuna: Any, folder: SweepFolder | None) -> Any:
    options = plan.study
    assert options is not None
    storage = None
    if folder is not None:
        journal = optuna.storages.journal.JournalFileBackend(str(folder.path / JOURNAL))
        storage = optuna.storages.JournalStorage(journal)
    samplers = {
        "tpe": lambda seed: optuna.samplers.TPESampler(seed=seed),
        "cma_es": lambda seed: optuna.samplers.CmaEsSampler(seed=seed),
        "random": lambda seed: optuna.samplers.RandomSampler(seed=seed),
    }
    pruner = (
        optuna.pruners.SuccessiveHalvingPruner(min_resource=1, reduction_factor=3)
        if options.prune
        else optuna.pruners.NopPruner()
    )
    study = optuna.create_study(
        study_name="sweep",
        storage=storage,
        pruner=pruner,
        direction=options.direction,
        load_if_exists=True,
    )
    trials = study.get_trials(deepcopy=False)
    # A resumed study must not sample its first trials again.
    study.sampler = samplers[options.sampler](options.seed + len(trials))
    for trial in trials:
        if trial.state == optuna.trial.TrialState.RUNNING:  # The study was killed.
            study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
            study.enqueue_trial(trial.params)
    return study


def _suggest_values(plan: Plan, trial: Any) -> dict[str, Any]:
    axes = read_axes(plan.axes, takes_integers)
    values: dict[str, Any] = {}
    for path in plan.axes:
        limits = axes.ranges.get(path)
        if limits is None:
            values[path] = trial.suggest_categorical(path, axes.lists[path])
        elif takes_integers(path):
            ends = round(limits.low), round(limits.high)
            values[path] = trial.suggest_int(path, *ends, log=limits.log)
        else:
            values[path] = trial.suggest_float(path, limits.low, limits.high, log=limits.log)
    return values


def _value(rows: Sequence[Row], plan: Plan) -> float:
    """Return the mean of the goal over runs. A run without a finite value counts as the worst."""
    assert plan.study is not None
    goal, sign = plan.study.goal, 1.0 if plan.study.direction == "maximize" else -1.0
    values = [math.nan if row.get(goal) is None else float(row[goal]) for row in rows]
    worst = sign * min((sign * v for v in values if math.isfinite(v)), default=-1e6)
    return sum(v if math.isfinite(v) else worst for v in values) / max(len(values), 1)
