"""Functions that run the suites of `neoworld bench run`: options in, a JSON object out.

Rows are kept as they come, and an interrupted run continues: see `rows`. Every result states its
`n`.
"""

import dataclasses
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from neoworld_mjx.config import Config
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.mllm import Panel, open_panel

from . import suites
from .rows import RowStore, collect, kept_rows, plain


def run_scenes(o: suites.SceneSet, config: Config) -> dict[str, Any]:
    """Run methods on the thirty scenes."""
    from .methods.method_runs import run_jobs, run_settings
    from .methods.scene_methods import check_methods
    from .methods.scene_runs import SceneRow, chosen_scenes, scene_rows, submission_rows
    from .tables.scene_figures import scene_summary

    settings = run_settings(o, config, o.evidence)
    scenes = chosen_scenes(o.scenes)
    if o.submission is not None:
        rows = collect(submission_rows(scenes, o.submission, settings))
        return {**scene_summary(rows), "rows": plain(rows)}
    check_methods(o.method)
    with kept_rows(o, config) as store:
        rows = run_jobs(
            scene_rows,
            SceneRow,
            starts=dict.fromkeys(scenes, range(o.starts)),
            methods=o.method,
            settings=settings,
            machines=o.machines,
            store=store,
        )
    return {**scene_summary(rows), "rows": plain(rows)}


def run_tasks(o: suites.Tasks, config: Config) -> dict[str, Any]:
    """Plan tasks in reconstructed scenes, and execute the plans."""
    from .methods.method_runs import run_jobs, run_settings
    from .methods.scene_methods import check_methods
    from .tables.task_figures import task_summary
    from .tasks.catalogue import find_tasks
    from .tasks.success_runs import TRUTH, SuccessRow, success_rows

    settings = dataclasses.replace(run_settings(o, config, o.evidence), samples=o.samples)
    tasks = find_tasks(o.task)
    check_methods(o.method, [TRUTH])
    with kept_rows(o, config) as store:
        rows = run_jobs(
            success_rows,
            SuccessRow,
            starts={task.name: range(o.starts) for task in tasks},
            methods=o.method,
            settings=settings,
            machines=o.machines,
            store=store,
        )
    return {**task_summary(rows), "rows": plain(rows)}


def run_plans(o: suites.Plans, config: Config) -> dict[str, Any]:
    """Request plans from a model, and execute them."""
    from .methods.method_runs import run_settings
    from .tasks.catalogue import find_tasks
    from .tasks.model_plans import plan_figures, plan_rows

    settings = run_settings(o, config, [o.evidence])
    tasks = find_tasks(o.task)
    with kept_rows(o, config) as store, _panel(o, config, store) as models:
        plan = partial(plan_rows, models, methods=o.method, starts=o.starts, settings=settings)
        rows = store.all({task.name: partial(plan, task) for task in tasks})
    return {**plan_figures(rows), "rows": plain(rows)}


def run_policies(o: suites.Policies, config: Config) -> dict[str, Any]:
    """Train policies in reconstructions, and run them in the ground truth."""
    from neoworld_mjx.environments.policy import Setting
    from neoworld_mjx.environments.training import Training

    from .methods.method_runs import run_jobs, run_settings
    from .tables.policy_figures import policy_summary
    from .tasks.catalogue import find_tasks
    from .tasks.policy_runs import (
        HORIZON,
        ROBOT_HORIZON,
        SNAPSHOTS,
        PolicyRow,
        PolicyTraining,
        drawn_tasks,
        policy_rows,
    )

    settings = run_settings(o, config, o.evidence)
    names = [task.name for task in find_tasks(o.task or drawn_tasks(o.each))]
    training = Training(o.steps, o.minutes, o.draws, o.seed, o.engine, snapshots=SNAPSHOTS)
    setting = Setting(task=".", horizon=HORIZON if o.robot is None else ROBOT_HORIZON)
    with kept_rows(o, config) as store, TemporaryDirectory() as scratch:
        folder = o.keep or (store.folder or Path(scratch)) / "policies"
        work = partial(
            policy_rows,
            PolicyTraining(training, o.worlds, o.samples, setting, folder, o.robot, o.method),
        )
        rows = run_jobs(
            work,
            PolicyRow,
            starts={name: range(o.starts) for name in names},
            methods=o.trained_in,
            settings=settings,
            machines=o.machines,
            store=store,
            in_turn=True,
        )
    return {**policy_summary(rows), "rows": plain(rows)}


def run_rescue(o: suites.Rescues) -> dict[str, Any]:
    """Rescue disturbed scenes of meshes."""
    from .rescues.rescue_rows import rescue_figures, rescue_rows

    jobs = {str(seed): partial(rescue_rows, seed, photo=o.photo) for seed in range(o.scenes)}
    with kept_rows(o) as store:
        rows = store.all(jobs)
    return {**rescue_figures(rows), "rows": plain(rows)}


def run_engines(o: suites.Engines) -> dict[str, Any]:
    """Time engines, and compare their verdicts with C MuJoCo."""
    from neoworld_mjx.sweeps import case

    from .engines.throughput import EngineTask, engine_rows

    tasks = [
        EngineTask(
            engine=engine,
            population=population,
            early_stop=o.early_stop,
            duration_s=o.duration,
            seed=o.seed,
            budget_s=o.budget,
        )
        for engine in o.engine
        for population in o.population
    ]
    scenes = {name: case(name).scene for name in o.scenes}
    jobs = {name: partial(engine_rows, name, scene, tasks) for name, scene in scenes.items()}
    with kept_rows(o) as store:
        rows = store.all(jobs)
    return {"n": len(rows), "rows": plain(rows)}


def run_examples(o: suites.Examples, config: Config) -> dict[str, Any]:
    """Reconstruct the bundled examples."""
    from .photographs.example_runs import example_jobs

    jobs = example_jobs(o.example, config)
    with kept_rows(o, config) as store:
        rows = store.all(jobs)
    return {"rows": plain(rows)}


def run_photos(o: suites.Photos, config: Config) -> dict[str, Any]:
    """Measure each step's errors."""
    from .fidelity.step_errors import chosen_numbers, photo_rows, photo_summary

    steps = partial(
        photo_rows,
        search=not o.no_search,
        seed=o.seed,
        compose_options=config.compose,
        refine_options=config.refine,
        engine=o.engine,
    )
    jobs = {str(n): partial(steps, n) for n in chosen_numbers(o.scenes)}
    with kept_rows(o, config) as store:
        rows = store.all(jobs)
    return {**photo_summary(rows), "rows": plain(rows)}


def run_real_poses(o: suites.RealPoses, config: Config) -> dict[str, Any]:
    """Score reconstructions of real photographs."""
    from .real_poses.real_views import real_figures, score_real_views

    if o.data is None or o.runs is None:
        raise ConfigError("real-poses needs DATA, the folder of the data set, and --runs DIR")
    with kept_rows(o, config) as store:
        views, objects = score_real_views(o.data, o.runs, config, store, place_with=o.place_with)
    return {"figures": real_figures(views, objects), "views": plain(views), "rows": plain(objects)}


def run_joints(o: suites.ObjectSuite, config: Config) -> dict[str, Any]:
    """Score reconstructed objects."""
    from .measures.object_scores import object_names, score_figures, score_object
    from .paper_figures import PAPER_JOINTS, PAPER_SURFACES

    if o.made is None or o.truth is None:
        raise ConfigError("joints needs --made DIR and --truth DIR, folders of objects")
    score = partial(score_object, made=o.made, truth=o.truth, front=o.front, options=config.program)
    jobs = {name: partial(score, name) for name in object_names(o.made, o.truth, o.object)}
    with kept_rows(o, config) as store:
        rows = store.all(jobs)
    paper = {"joints": PAPER_JOINTS, "surfaces": PAPER_SURFACES}
    return {**score_figures(rows), "paper": paper, "rows": plain(rows)}


def run_all(o: suites.All) -> dict[str, Any]:
    """Make the tables of docs/results.md."""
    from .all_tables import run_tables

    return run_tables(o.out, o.tables, o.workers, o.against)


def _panel(o: suites.ModelRequests, config: Config, store: RowStore) -> Panel:
    """Open the models; responses are recorded in the folder of an unfinished run by default."""
    tapes = () if o.tape is None else (o.tape,)
    record = o.record or (store.folder and store.folder / "responses.tape.json")
    return open_panel(config.mllm, o.provider, tapes=tapes, mailbox=o.mailbox, record=record)
