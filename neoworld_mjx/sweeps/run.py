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
    """One of each scene, point and seed; columns as in `run_rows.COLUMNS`."""
    points: list[dict[str, Any]]
    """Each point over scenes and seeds; see `table.summary`."""
    differences: list[dict[str, Any]]
    """Of an ablation: each variant from the base; see `table.differences`."""
    table: str
    """Both, as Markdown."""
    about: dict[str, Any] = field(default_factory=dict)
    """What sweep.json holds."""


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
        plan: a YAML file, or what it would hold.
        out: folder to write results.parquet, table.md and sweep.json into; None writes nothing.
        cases: scenes besides those that the plan names.
        sources: what makes scenes that the plan names as KIND:NAME.
        engine: what rolls candidates out; opened from the options by default.
        resume: go on with the sweep in `out`.
        overwrite: replace the sweep in `out`.

    Raises:
        ConfigError: the plan is wrong; nothing has run then.
        SpecError: there is no such scene.
        RunError: the folder may not be touched.
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
    """Refine scenes with a base and named changes of it, and tell their differences.

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
    known: dict[Key, Row] = {}
    if out is not None:
        folder = SweepFolder(Path(out), kind, resume=resume, overwrite=overwrite)
        known = folder.keep(wanted)
        if known:
            _log.info("%d of %d runs are there already", len(known), total)
    columns = list(at[0].values)
    about = _about(kind, plan, at, lines)
    about["groups"] = folder.groups if folder is not None else []

    def kept(finished: bool) -> Swept:
        rows = [known[key] for key in wanted if key in known]
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
            asked = [(k, seed) for k in group.members for seed in plan.seeds]
            asked = [(k, s) for k, s in asked if (scene.name, at[k].label, s) not in known]
            if not asked:
                continue
            start, built = time.perf_counter(), compilations()
            reach = group.reach
            shape = (reach.rollout.timestep_s, reach.rollout.samples_per_object)
            if shape not in models:
                models[shape] = compile_for_search(scene.scene, reach)
            rolls = engine or open_engine(reach.rollout.engine)
            runs = [
                SearchRun(
                    at[k].options,
                    seed,
                    None if scene.start is None else scene.start(models[shape], seed),
                )
                for k, seed in asked
            ]
            run_all = _folded if plan.fold else _apart
            rows = run_all(scene, models[shape], runs, rolls, warm)
            for (k, seed), row in zip(asked, rows, strict=True):
                key = (scene.name, at[k].label, seed)
                head = {"scene": scene.name, "point": at[k].label, "seed": seed}
                known[key] = head | at[k].values | row | {"fingerprint": wanted[key]}
            spent, built = time.perf_counter() - start, compilations() - built
            about["groups"].append(
                {
                    "scene": scene.name,
                    "points": [at[k].label for k in group.members],
                    "runs": len(runs),
                    "seconds": spent,
                    "compilations": built,
                }
            )
            _log.info(
                "%s, group %d of %d: %d runs in %.1f s, %d programs compiled",
                *(scene.name, number, len(groups), len(runs), spent, built),
            )
            kept(False)
    return kept(True)


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
    """Run one after the other, as `refine` does; the first of a kind also unmeasured before."""
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
    """Return a hash of all that decides a run, in the order of the table's rows."""
    shared = {
        "versions": versions(),
        "fold": plan.fold,
        "engine": None if engine is None else engine.name,
        "sigma_xy": groups[0].reach.cem.sigma_xy,
    }
    fingerprints = {}
    for scene in cases:
        described = content_hash(scene.scene)
        for point in at:
            options = option_values(point.options)
            for seed in plan.seeds:
                decides = [shared, scene.name, described, options, seed]
                fingerprints[scene.name, point.label, seed] = content_hash(decides)[:16]
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
    """Return what the command prints."""
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
