"""Sweeps and ablations: settings of the search, on scenes, with seeds, into one table."""

import json
import logging
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax

from ..config import RefineOptions, option_values
from ..errors import ConfigError
from ..files import content_hash
from ..physics.engine import Engine
from ..physics.model import SceneModel
from ..physics.simulate import open_engine
from ..refinement.loop import SearchRun, search
from ..refinement.outcome import choose
from ..refinement.scene_refinement import compile_for_search, refine
from ..run_folder import versions
from ..spec import SceneSpec
from .cases import Case, Source, case
from .compiles import compilations
from .folder import FORMAT, TABLE, SweepFolder
from .grouping import TRACED, PointGroup, grouped, reasons
from .plan import Ablation, Plan, Point, points, read
from .run_rows import Key, Row, row_of_refined, row_of_search
from .table import differences, markdown, summary

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Swept:
    """The result of a sweep or an ablation."""

    rows: list[Row]
    """One row of each scene, point and seed; columns as in `run_rows.COLUMNS`."""
    points: list[dict[str, Any]]
    """Summary of each point over scenes and seeds; see `table.summary`."""
    differences: list[dict[str, Any]]
    """Differences of an ablation's variants from the base; see `table.differences`."""
    table: str
    """Both, as Markdown."""
    about: dict[str, Any] = field(default_factory=dict)
    """The content of sweep.json."""


def sweep(
    plan: Plan | Mapping[str, Any] | Path | str,
    out: Path | str | None = None,
    *,
    cases: Sequence[Case | SceneSpec] = (),
    sources: Mapping[str, Source] | None = None,
    engine: Engine | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> Swept:
    """Refine scenes with every combination of some options' values, with several seeds.

    Runs that differ in traced options alone are one computation; see `refinement.loop.search`. They
    are not pruned, which changes no elite.

    Args:
        plan: a plan, or its YAML file or mapping.
        out: folder to write results.parquet, table.md and sweep.json into; None writes nothing.
        cases: scenes besides those that the plan names.
        sources: by KIND, functions that make the scenes named as KIND:NAME.
        engine: the physics engine; opened from the options by default.
        resume: go on with the sweep in `out`.
        overwrite: replace the sweep in `out`.

    Raises:
        ConfigError: the plan is wrong; raised before anything runs.
        SpecError: there is no such scene.
        RunError: the folder cannot be written, or holds files that must stay.
    """
    return _run(read(plan, Plan), out, cases, sources or {}, engine, resume, overwrite)


def ablate(
    plan: Ablation | Mapping[str, Any] | Path | str,
    out: Path | str | None = None,
    *,
    cases: Sequence[Case | SceneSpec] = (),
    sources: Mapping[str, Source] | None = None,
    engine: Engine | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> Swept:
    """Refine scenes with a base and named changes of it, and estimate their differences.

    Runs are by themselves unless the plan says `fold`, the first of a kind twice, so that none is
    timed while it compiles. See `sweep` for arguments and errors.
    """
    return _run(read(plan, Ablation), out, cases, sources or {}, engine, resume, overwrite)


def _run(
    plan: Plan | Ablation,
    out: Path | str | None,
    given: Sequence[Case | SceneSpec],
    sources: Mapping[str, Source],
    engine: Engine | None,
    resume: bool,
    overwrite: bool,
) -> Swept:
    at = points(plan)
    cases = _cases(plan, given, sources)
    every = [point.options for point in at]
    groups = grouped(every, fold=plan.fold)
    kind = "sweep" if isinstance(plan, Plan) else "ablation"
    total = len(cases) * len(at) * len(plan.seeds)
    _log.info(
        "%s: %d points x %d seeds x %d scenes = %d runs",
        *(kind, len(at), len(plan.seeds), len(cases), total),
    )
    lines = reasons(every, fold=plan.fold)
    for line in lines:
        _log.info("static: %s", line)
    wanted = _fingerprints(plan, at, cases, groups, engine)
    folder = None
    done: dict[Key, Row] = {}
    if out is not None:
        folder = SweepFolder(Path(out), kind, resume=resume, overwrite=overwrite)
        done = folder.keep(wanted)
        if done:
            _log.info("%d of %d runs are there already", len(done), total)
    columns = list(at[0].values)
    about = _about(kind, plan, at, lines)
    about["groups"] = folder.groups if folder is not None else []

    def save(finished: bool) -> Swept:
        rows = [done[key] for key in wanted if key in done]
        about["finished"] = finished
        for name in ("seconds", "compilations"):
            about[name] = sum(group[name] for group in about["groups"])
        swept = _swept(kind, rows, [point.label for point in at], about)
        if folder is not None:
            folder.write(rows, columns, swept.table)
            folder.write_about(about)
        return swept

    for scene in cases:
        models: dict[tuple[float, int], SceneModel] = {}
        warm: set[str] = set()
        for number, group in enumerate(groups, start=1):
            pending = [(k, seed) for k in group.members for seed in plan.seeds]
            pending = [(k, s) for k, s in pending if (scene.name, at[k].label, s) not in done]
            if not pending:
                continue
            start, compile_count = time.perf_counter(), compilations()
            reach = group.reach
            shape = (reach.rollout.timestep_s, reach.rollout.samples_per_object)
            if shape not in models:
                models[shape] = compile_for_search(scene.scene, reach)
            rollout_engine = engine or open_engine(reach.rollout.engine)
            runs = [
                SearchRun(
                    at[k].options,
                    seed,
                    None if scene.start is None else scene.start(models[shape], seed),
                )
                for k, seed in pending
            ]
            run_all = _folded if plan.fold else _apart
            rows = run_all(scene, models[shape], runs, rollout_engine, warm)
            for (k, seed), row in zip(pending, rows, strict=True):
                key = (scene.name, at[k].label, seed)
                head = {"scene": scene.name, "point": at[k].label, "seed": seed}
                done[key] = head | at[k].values | row | {"fingerprint": wanted[key]}
            elapsed, compile_count = time.perf_counter() - start, compilations() - compile_count
            about["groups"].append(
                {
                    "scene": scene.name,
                    "points": [at[k].label for k in group.members],
                    "runs": len(runs),
                    "seconds": elapsed,
                    "compilations": compile_count,
                }
            )
            _log.info(
                "%s, group %d of %d: %d runs in %.1f s, %d programs compiled",
                *(scene.name, number, len(groups), len(runs), elapsed, compile_count),
            )
            save(False)
    return save(True)


def _folded(
    scene: Case, model: SceneModel, runs: Sequence[SearchRun], engine: Engine, warm: set[str]
) -> list[Row]:
    """Search all runs at once, without pruning, so that rollouts are few and large."""
    del warm
    clock: dict[str, float] = {}
    results = search(model, [unpruned(run) for run in runs], engine, keep=False, clock=clock)
    timing = {"seconds": clock["search"] / len(runs), "to_valid_s": None, "engine": engine.name}
    rows = []
    for run, result in zip(runs, results, strict=True):
        chosen = choose(model, result.rounds, run.options, run.start)
        rows.append(row_of_search(scene, model, result, chosen, run.start) | timing)
    return rows


def unpruned(run: SearchRun) -> SearchRun:
    """Return the run with every candidate rolled out, which changes no elite."""
    o = run.options
    return run._replace(
        options=o.model_copy(update={"cem": o.cem.model_copy(update={"prune": False})})
    )


def _apart(
    scene: Case, model: SceneModel, runs: Sequence[SearchRun], engine: Engine, warm: set[str]
) -> list[Row]:
    """Refine runs one by one; the first of each kind runs twice, so that compiling is not timed."""
    rows = []
    for run in runs:
        kind = {name: v for name, v in option_values(run.options).items() if name not in TRACED}
        text = json.dumps([kind, list(run.options.reward.terms)], sort_keys=True)
        if text not in warm:
            warm.add(text)
            refine(model, run.options, seed=run.seed, start=run.start, engine=engine)
        refined = refine(model, run.options, seed=run.seed, start=run.start, engine=engine)
        rows.append(row_of_refined(scene, model, refined))
    return rows


def _cases(
    plan: Plan | Ablation, given: Sequence[Case | SceneSpec], sources: Mapping[str, Source]
) -> list[Case]:
    cases = [case(name, sources) for name in plan.scenes]
    cases += [item if isinstance(item, Case) else Case(item.name, item) for item in given]
    if not cases:
        raise ConfigError("scenes: name at least one, as a scene.json, a run folder or KIND:NAME")
    names = [item.name for item in cases]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"scenes: {', '.join(twice)} comes twice")
    return cases


def _fingerprints(
    plan: Plan | Ablation,
    at: Sequence[Point],
    cases: Sequence[Case],
    groups: Sequence[PointGroup],
    engine: Engine | None,
) -> dict[Key, str]:
    """Return a hash of every run's inputs, in the order of the table's rows."""
    shared = {
        "versions": versions(),
        "fold": plan.fold,
        "engine": None if engine is None else engine.name,
        "sigma_xy": groups[0].reach.cem.sigma_xy,
    }
    fingerprints = {}
    for scene in cases:
        scene_hash = content_hash(scene.scene)
        for point in at:
            options = option_values(point.options)
            for seed in plan.seeds:
                inputs = [shared, scene.name, scene_hash, options, seed]
                fingerprints[scene.name, point.label, seed] = content_hash(inputs)[:16]
    return fingerprints


def _about(
    kind: str, plan: Plan | Ablation, at: Sequence[Point], lines: list[str]
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "kind": kind,
        "plan": plan.model_dump(mode="json"),
        "points": [{"label": point.label, **point.values} for point in at],
        "options": _shown(at[0].options),
        "static": lines,
        "versions": versions(),
        "machine": {
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "devices": [f"{d.platform}: {d.device_kind}" for d in jax.devices()],
        },
    }


def _shown(options: RefineOptions) -> dict[str, Any]:
    return {"refine": options.model_dump(mode="json")}


def _swept(kind: str, rows: list[Row], labels: list[str], about: dict[str, Any]) -> Swept:
    labels = [label for label in labels if any(row["point"] == label for row in rows)]
    summed = summary(rows, labels)
    against = differences(rows, labels) if kind == "ablation" else []
    notes = (
        "Means over scenes and seeds with 95 % intervals: Wilson's for rates, Student's t for the "
        "others. n counts runs. Runs on one scene are alike, so intervals over few scenes are too "
        "narrow for others. The reward is by each point's own weights: where weights differ, "
        "compare what it is made of."
    )
    return Swept(rows, summed, against, markdown(kind.capitalize(), summed, against, notes), about)


def answer(swept: Swept, out: Path) -> dict[str, Any]:
    """Return the JSON answer of the command."""
    flat = lambda rows: [
        {"point": row["point"], "n": row["n"]}
        | {
            name if part == "mean" else f"{name}_{part}": value
            for name, estimate in row.items()
            if isinstance(estimate, dict)
            for part, value in estimate.items()
        }
        for row in rows
    ]
    return {
        "folder": str(out),
        "table": str(out / TABLE),
        "runs": len(swept.rows),
        "seconds": swept.about["seconds"],
        "compilations": swept.about["compilations"],
        "static": swept.about["static"],
        "points": flat(swept.points),
        **({"differences": flat(swept.differences)} if swept.differences else {}),
    }
