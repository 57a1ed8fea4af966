"""The suites of `neoworld bench`: each takes its options, logs rows as they come, and returns
JSON.
"""

import json
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
from pydantic import ValidationError

from neoworld_mjx.config import Config
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.io.files import write_atomic

from . import suites
from .engines import agreement as comparing
from .engines.growth import Growth, growth, growth_svg
from .engines.kernel_times import dispatch, kernels
from .engines.penetration import accuracy, random_pairs
from .engines.throughput import PhysicsRow, physics
from .machine import machine
from .rows import collect, log, plain

if TYPE_CHECKING:
    from .bench_commands import BenchChartCommand, BenchMakeCommand, BenchTableCommand


def physics_result(o: suites.Physics) -> dict[str, Any]:
    """Time engines."""
    about = machine()
    rows = collect(
        physics(
            o.objects,
            o.population,
            o.engine,
            duration=o.duration,
            budget=o.budget,
            seed=o.seed,
        )
    )
    if o.chart is not None:
        _write(o.chart, growth_svg(growth(rows)))
    return {"machine": about, "rows": plain(rows), "growth": _exponents(growth(rows))}


def kernels_result(o: suites.Kernels) -> dict[str, Any]:
    """Time penetration terms."""
    about = machine()
    rows = collect(
        kernels(o.objects, o.population, samples=o.samples, seed=o.seed, budget=o.budget)
    )
    if o.table is not None:
        _enter(o.table, dispatch(rows))
    pairs = plain(collect(accuracy(random_pairs(o.pairs, seed=o.seed)))) if o.pairs else []
    return {"machine": about, "rows": plain(rows), "accuracy": pairs}


def agreement_result(o: suites.Agreement) -> dict[str, Any]:
    """Compare engines."""
    rows = collect(comparing.agreement(o.scene, o.engine, layouts=o.layouts, seed=o.seed))
    return {
        **comparing.agreed(rows),
        "machine": machine(),
        "models": plain([row for row in rows if isinstance(row, comparing.ModelRow)]),
        "verdicts": plain([row for row in rows if isinstance(row, comparing.VerdictRow)]),
    }


def refine_result(o: suites.Refine, config: Config) -> dict[str, Any]:
    """Refine from noisy starts, with the configuration's options of refinement."""
    if o.real:
        from .photographs.real_scenes import real_refinements

        real = real_refinements(o.scene, seed=o.seed, options=config.refine, engine=o.engine)
        return {"machine": machine(), "scenes": plain(collect(real))}
    from .refine import refinements, summary

    rows = collect(
        refinements(
            o.scene,
            seeds=o.seeds,
            baseline_seeds=o.baseline_seeds,
            baselines=o.baseline,
            options=config.refine,
            engine=o.engine,
        )
    )
    return {**summary(rows), "machine": machine(), "rows": plain(rows)}


def photos_result(o: suites.Photos, config: Config) -> dict[str, Any]:
    """Measure errors by step, or how often S_sem prefers the truth."""
    from .fidelity import semantic_ranking as photo_semantics
    from .fidelity import step_errors as photos

    scenes = o.scenes or (photos.QUICK if o.quick else ())
    if o.semantic:
        rows = collect(photo_semantics.semantic_rows(scenes, draws=o.draws))
        lower = [row.lower for row in rows]
        return {
            "lower_mean": sum(lower) / len(lower),
            "lower_least": min(lower),
            "machine": machine(),
            "rows": plain(rows),
        }
    measured = collect(
        photos.photo_rows(
            scenes,
            search=not o.no_search,
            seed=o.seed,
            compose_options=config.compose,
            refine_options=photos.searching_little(config.refine) if o.quick else config.refine,
            engine=o.engine,
        )
    )
    answer = {**photos.photo_summary(measured), "machine": machine(), "rows": plain(measured)}
    for line in photos.lines(answer):
        log.info(line)
    return answer


def scenes_result(o: suites.SceneSet, config: Config) -> dict[str, Any]:
    """Run methods on the scenes of the benchmark."""
    from .methods.scene_runs import chosen_scenes, run_scenes
    from .tables.scene_summary import summarise

    rows = run_scenes(
        chosen_scenes(o.scenes),
        o.method,
        starts=o.starts,
        seed=o.seed,
        refine=config.refine,
        compose=config.compose,
        noise=o.noise,
        workers=o.workers,
        out=o.out,
        submission=o.submission,
    )
    return {**summarise(rows), "machine": machine()}


def make_result(o: "BenchMakeCommand") -> dict[str, Any]:
    """Write the data set."""
    from .dataset.make_dataset import make_dataset

    return make_dataset(o.out, seed=o.seed, workers=o.workers or os.cpu_count() or 1)


def table_result(o: "BenchTableCommand") -> dict[str, Any]:
    """Write the tables of a folder of results."""
    from .tables.result_tables import write_tables

    return write_tables(o.folder)


def joints_result(o: suites.ObjectSuite, config: Config) -> dict[str, Any]:
    """Score made objects."""
    from .objects.joint_table import NOTE, PAPER
    from .objects.object_scores import score_figures, score_objects

    if o.made is None:
        raise ConfigError("joints needs --made DIR, the objects, and --partnet PATH or --truth DIR")
    rows = collect(
        score_objects(
            o.made,
            partnet=o.partnet,
            truth=o.truth,
            objects=o.object,
            front=o.front,
            options=config.program,
            out=o.out,
        )
    )
    paper = {"joints": PAPER, "note": NOTE}
    return {**score_figures(rows), "paper": paper, "rows": plain(rows)}


def tasks_result(o: suites.Tasks) -> dict[str, Any]:
    """Check tasks on truth."""
    from .tasks.catalogue import all_tasks, find_task
    from .tasks.task_checks import check_tasks, summarised

    if not 0 <= o.directions <= 64:
        raise ConfigError(f"--directions takes 0 to 64, got {o.directions}")
    tasks = [find_task(name) for name in o.task] or list(all_tasks())
    rows = collect(check_tasks(tasks, o.directions))
    return {**summarised(rows), "machine": machine(), "rows": plain(rows)}


def task_success_result(o: suites.TaskSuccess, config: Config) -> dict[str, Any]:
    """Plan tasks in what methods make of starts, and carry the plans out."""
    from .tasks.catalogue import all_tasks, find_task
    from .tasks.success_runs import run_successes
    from .tasks.success_summary import success_summary

    rows = run_successes(
        [find_task(name) for name in o.task] or list(all_tasks()),
        o.method,
        starts=o.starts,
        seed=o.seed,
        refine=config.refine,
        compose=config.compose,
        noise=o.noise,
        workers=o.workers,
        out=o.out,
    )
    return {**success_summary(rows), "machine": machine()}


def plans_result(o: suites.Plans, config: Config) -> dict[str, Any]:
    """Ask a model for plans."""
    from neoworld_mjx.mllm import open_panel

    from .tasks.catalogue import all_tasks, find_task
    from .tasks.model_plans import plan_figures, plan_rows

    if not 0 <= o.offset <= 1 or not 0 <= o.rounds <= 20:
        raise ConfigError(
            f"--offset takes 0 to 1 m and --rounds 0 to 20, got {o.offset:g} and {o.rounds}"
        )
    tasks = [find_task(name) for name in o.task] or list(all_tasks())
    tapes = () if o.tape is None else (o.tape,)
    with open_panel(
        config.mllm, o.provider, tapes=tapes, mailbox=o.mailbox, record=o.record
    ) as models:
        rows = collect(
            plan_rows(
                models,
                tasks,
                rounds=o.rounds,
                offset_m=o.offset,
                feedback=o.feedback,
                seed=o.seed,
            )
        )
    return {**plan_figures(rows), "machine": machine(), "rows": plain(rows)}


def chart_result(o: "BenchChartCommand") -> dict[str, Any]:
    """Draw the growth of cost from stored rows."""
    try:
        answer = json.loads(o.rows.read_text(encoding="utf-8"))
        rows = [PhysicsRow.model_validate(row) for row in answer["rows"]]
    except OSError as error:
        raise ConfigError(f"cannot read {o.rows}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, ValidationError):
        raise ConfigError(f"{o.rows} is not what bench run physics --json prints") from None
    curves = growth(rows, core=o.core)
    _write(o.out, growth_svg(curves, core=o.core))
    return {"chart": str(o.out), "growth": _exponents(curves)}


def _exponents(curves: Iterable[Growth]) -> list[dict[str, Any]]:
    return [
        {
            "label": g.label,
            "objects": g.objects,
            "cost_ms": g.cost_ms,
            "exponent": None if math.isnan(g.exponent) else g.exponent,
        }
        for g in curves
    ]


def _enter(path: Path, entry: dict[str, Any]) -> None:
    """Add or replace this device's entry in a table of measured devices."""
    try:
        table = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"devices": {}}
        table["devices"][jax.devices()[0].device_kind] = entry
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} is no table of measured devices: {error}") from None
    _write(path, json.dumps(table, indent=1) + "\n")


def _write(path: Path, text: str) -> None:
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from None
