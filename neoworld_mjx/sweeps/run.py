"""Sweeps and ablations: settings of the search, on scenes, with seeds, into one table."""

import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax

from ..compilations import compiled
from ..config import RefineOptions, option_values
from ..errors import ConfigError
from ..io.files import content_hash
from ..physics.engine import Engine
from ..physics.model import SceneModel
from ..physics.simulate import open_engine
from ..progress import report
from ..refinement.loop import search
from ..refinement.scene_refinement import compile_for_search, refine
from ..refinement.search_run import SearchRun
from ..run_folder import versions
from ..spec import SceneSpec
from .cases import Case, Source, case
from .folder import CSV, FORMAT, LATEX, TABLE, SweepFolder
from .grouping import TRACED, PointGroup, grouped, reasons
from .histories import so_far, summaries
from .model_scores import ModelScores, asks_a_model
from .plan import Ablation, Plan, Point, points, read, shared_config
from .run_rows import Key, Row, row_of_refined, row_of_search
from .table import comma_separated, differences, flat, latex, markdown, summary
from .winners import winners

BATCHES = 4
"""Batches of a population, at most, that are rolled out one after the other on an accelerator."""


@dataclass(frozen=True)
class Swept:
    """The result of a sweep or an ablation."""

    rows: list[Row]
    """One row of each scene, point and seed; columns as in `run_rows.COLUMNS`, and under "history"
    the iterations with the columns of `histories.COLUMNS`."""
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

    Runs that differ in traced options alone are one computation; see `refinement.loop.search`.

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

    Each run is a refinement of its own unless the plan sets `fold`; the first of a kind runs twice,
    so that no time includes compilation. See `sweep` for arguments and errors.
    """
    return _run(read(plan, Ablation), out, cases, sources or {}, engine, resume, overwrite)


def _run(
    plan: Plan | Ablation,
    out: Path | str | None,
    scenes: Sequence[Case | SceneSpec],
    sources: Mapping[str, Source],
    engine: Engine | None,
    resume: bool,
    overwrite: bool,
) -> Swept:
    settings = points(plan)
    cases = _cases(plan, scenes, sources)
    options = [point.options for point in settings]
    by_model = [point for point in settings if asks_a_model(point.options)]
    # A run that a model scores is searched by itself, as its answers come when they come.
    fold = plan.fold and not by_model
    groups = grouped(options, fold=fold)
    kind = "sweep" if isinstance(plan, Plan) else "ablation"
    total = len(cases) * len(settings) * len(plan.seeds)
    report(
        f"{kind}: {len(settings)} points x {len(plan.seeds)} seeds x {len(cases)} scenes = "
        f"{total} runs",
        step=f"{kind} of {total} runs",
    )
    lines = reasons(options, fold=fold)
    if plan.fold and by_model:
        lines = [*lines, "a model scores candidates: every run is a refinement of its own"]
    for line in lines:
        report(f"static: {line}")
    fingerprints = _fingerprints(plan, settings, cases, groups, engine, fold)
    folder = None
    completed: dict[Key, Row] = {}
    if out is not None:
        folder = SweepFolder(Path(out), kind, resume=resume, overwrite=overwrite)
        completed = folder.keep(fingerprints)
        if completed:
            report(f"{len(completed)} of {total} runs are there already")
    scores = None
    if by_model:
        scores = ModelScores(
            shared_config(plan),
            recorded=plan.scores,
            tapes=plan.tapes,
            out=None if folder is None else folder.path,
            earlier={} if folder is None else folder.ledger,
        )
        for scene in cases:
            scores.check(scene)
    columns = list(settings[0].values)
    about = _about(kind, plan, settings, lines)
    about["groups"] = folder.groups if folder is not None else []

    def save(finished: bool) -> Swept:
        rows = [completed[key] for key in fingerprints if key in completed]
        about["finished"] = finished
        for name in ("seconds", "compilations", "compile_s"):
            about[name] = sum(group.get(name, 0) for group in about["groups"])
        if scores is not None:
            about["mllm"] = scores.ledger
        swept = _swept(kind, rows, [point.label for point in settings], about)
        if folder is not None:
            folder.write(rows, columns, _tables(kind.capitalize(), swept))
            folder.write_about(about)
            if finished:
                about["figure"] = folder.write_figure(rows, columns)
        return swept

    began, computed = time.perf_counter(), 0
    for scene in cases:
        models: dict[tuple[float, int], SceneModel] = {}
        warm: set[str] = set()
        for number, group in enumerate(groups, start=1):
            pending = [
                (settings[k], seed)
                for k in group.members
                for seed in plan.seeds
                if (scene.name, settings[k].label, seed) not in completed
            ]
            if not pending:
                continue
            start, before = time.perf_counter(), compiled()
            reach = group.reach
            shape = (reach.rollout.timestep_s, reach.rollout.samples_per_object)
            if shape not in models:
                models[shape] = compile_for_search(scene.scene, reach)
            model = models[shape]
            rollout_engine = engine or open_engine(reach.rollout.engine)
            runs = [
                SearchRun(
                    point.options, seed, None if scene.start is None else scene.start(model, seed)
                )
                for point, seed in pending
            ]
            if fold:
                rows = _folded(scene, reach, model, runs, rollout_engine)
            else:
                labels = [point.label for point, _ in pending]
                try:
                    rows = _one_by_one(scene, model, runs, labels, rollout_engine, warm, scores)
                except BaseException:
                    save(False)  # What was paid for is on record.
                    raise
            for (point, seed), row in zip(pending, rows, strict=True):
                key = (scene.name, point.label, seed)
                head = {"scene": scene.name, "point": point.label, "seed": seed}
                fingerprint = {"fingerprint": fingerprints[key]}
                completed[key] = head | point.values | row | fingerprint
            elapsed = time.perf_counter() - start
            programs, compile_s = (a - b for a, b in zip(compiled(), before, strict=True))
            about["groups"].append(
                {
                    "scene": scene.name,
                    "points": [settings[k].label for k in group.members],
                    "runs": len(runs),
                    "seconds": elapsed,
                    "compilations": int(programs),
                    "compile_s": compile_s,
                }
            )
            computed += len(runs)
            left = (total - len(completed)) * (time.perf_counter() - began) / computed
            report(
                f"{scene.name}, group {number} of {len(groups)}: {len(runs)} runs in "
                f"{elapsed:.1f} s, {compile_s:.1f} s of it compiling {programs:.0f} programs; "
                f"{len(completed)} of {total} runs done, about {left:.0f} s left",
                step=f"{kind} of {total} runs, {len(completed)} done, {left:.0f} s left",
            )
            save(False)
    result = save(True)
    if scores is not None:
        scores.close()
    return result


def _folded(
    scene: Case,
    reach: RefineOptions,
    model: SceneModel,
    runs: Sequence[SearchRun],
    engine: Engine,
) -> list[Row]:
    """Search all runs at once, in few large rollouts."""
    clock: dict[str, float] = {}
    before = compiled().seconds
    results = search(model, [in_few_batches(run) for run in runs], engine, keep=False, clock=clock)
    seconds = max(clock["search"] - (compiled().seconds - before), 0.0) / len(runs)
    timing = {"seconds": seconds, "to_valid_s": None, "engine": engine.name}

    chosen = winners(scene.scene, reach, model, results)
    return [
        row_of_search(scene, model, result, winner) | timing | {"history": so_far(result.summaries)}
        for result, winner in zip(results, chosen, strict=True)
    ]


def in_few_batches(run: SearchRun) -> SearchRun:
    """Return the run with larger batches where an accelerator rolls them out.

    Pruning then leaves out a few candidates less, and no elite is another.
    """
    c = run.options.cem
    if jax.default_backend() == "cpu":
        return run
    cem = c.model_copy(update={"batch": max(c.batch, -(-c.population // BATCHES))})
    return run._replace(options=run.options.model_copy(update={"cem": cem}))


def _one_by_one(
    scene: Case,
    model: SceneModel,
    runs: Sequence[SearchRun],
    labels: Sequence[str],
    engine: Engine,
    warm: set[str],
    scores: ModelScores | None,
) -> list[Row]:
    """Refine runs one by one; the first of each kind runs twice, to leave compilation untimed.

    What a model would score is compiled by a run that geometry scores, which costs no call.
    """
    rows = []
    for run, label in zip(runs, labels, strict=True):
        kind = {name: v for name, v in option_values(run.options).items() if name not in TRACED}
        text = json.dumps([kind, list(run.options.reward.terms)], sort_keys=True)
        if text not in warm:
            warm.add(text)
            geometric = run.options.semantic.model_copy(update={"scorer": "geometric"})
            unscored = run.options.model_copy(update={"semantic": geometric})
            refine(model, unscored, seed=run.seed, start=run.start, engine=engine)
        given: dict[str, Any] = {}
        if scores is not None and asks_a_model(run.options):
            given = scores.of(scene, label, run.seed)
        refined = refine(model, run.options, seed=run.seed, start=run.start, engine=engine, **given)
        if scores is not None:
            scores.refuse_partial(refined, scene, label, run.seed)
        history = so_far(summaries(refined.history))
        rows.append(row_of_refined(scene, model, refined) | {"history": history})
    return rows


def _cases(
    plan: Plan | Ablation, scenes: Sequence[Case | SceneSpec], sources: Mapping[str, Source]
) -> list[Case]:
    cases = [case(name, sources) for name in plan.scenes]
    cases += [entry if isinstance(entry, Case) else Case(entry.name, entry) for entry in scenes]
    if not cases:
        raise ConfigError("scenes: name at least one, as a scene.json, a run folder or KIND:NAME")
    names = [entry.name for entry in cases]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"scenes: {', '.join(twice)} comes twice")
    return cases


def _fingerprints(
    plan: Plan | Ablation,
    settings: Sequence[Point],
    cases: Sequence[Case],
    groups: Sequence[PointGroup],
    engine: Engine | None,
    fold: bool,
) -> dict[Key, str]:
    """Return a hash of every run's inputs, in the order of the table's rows."""
    shared = {
        "versions": versions(),
        "fold": fold,
        "engine": None if engine is None else engine.name,
        "sigma_xy": groups[0].reach.cem.sigma_xy,
    }
    config = shared_config(plan)
    asked = {"provider": config.provider, "model": config.mllm.critic.model}
    asked = {"recorded": str(plan.scores)} if plan.scores is not None else asked
    fingerprints = {}
    for scene in cases:
        scene_hash = content_hash(scene.scene)
        for point in settings:
            options = option_values(point.options)
            for seed in plan.seeds:
                inputs = [shared, scene.name, scene_hash, options, seed]
                inputs += [asked] if asks_a_model(point.options) else []
                fingerprints[scene.name, point.label, seed] = content_hash(inputs)[:16]
    return fingerprints


def _about(
    kind: str, plan: Plan | Ablation, settings: Sequence[Point], lines: list[str]
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "kind": kind,
        "plan": plan.model_dump(mode="json"),
        "points": [{"label": point.label, **point.values} for point in settings],
        "options": _shown(settings[0].options),
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


def _tables(title: str, swept: Swept) -> dict[str, str]:
    """Return the tables by the names of their files."""
    tex = latex(title, swept.points)
    if swept.differences:
        tex += "\n" + latex(f"{title}: differences", swept.differences, signed=True)
    return {TABLE: swept.table, CSV: comma_separated(swept.points), LATEX: tex}


def answer(swept: Swept, out: Path) -> dict[str, Any]:
    """Return the JSON answer of the command."""
    return {
        "folder": str(out),
        "table": str(out / TABLE),
        "figure": swept.about.get("figure"),
        "runs": len(swept.rows),
        "seconds": swept.about["seconds"],
        "compile_s": swept.about["compile_s"],
        "compilations": swept.about["compilations"],
        "static": swept.about["static"],
        **({"mllm": swept.about["mllm"]} if "mllm" in swept.about else {}),
        "points": flat(swept.points),
        **({"differences": flat(swept.differences)} if swept.differences else {}),
    }
