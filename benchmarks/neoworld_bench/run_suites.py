"""Functions that run the suites of `neoworld bench run`: options in, a JSON object out.

Rows are kept as they come, and an interrupted run continues: see `rows`. Every result states its
`n`.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from neoworld_mjx.config import Config
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.mllm import Panel, open_panel

from . import suites
from .rows import ROWS, RowStore, collect, kept_rows, log, plain


@contextmanager
def _store(o: suites.SceneSet | suites.Tasks, config: Config) -> Iterator[RowStore]:
    """Yield the rows of the folder `out`, or those that are kept until the run has finished."""
    if o.out is not None:
        yield RowStore(o.out / ROWS)
        return
    with kept_rows(o, config) as store:
        yield store


def run_scenes(o: suites.SceneSet, config: Config) -> dict[str, Any]:
    """Run methods on the thirty scenes."""
    from .methods.method_runs import RunSettings, read_methods
    from .methods.scene_runs import chosen_scenes
    from .methods.scene_runs import run_scenes as run_methods
    from .tables.scene_table import scene_summary

    methods, named = read_methods(o.method, config)
    settings = RunSettings(o.seed, config.refine, config.compose, o.noise, named)
    with _store(o, config) as store:
        rows = run_methods(
            chosen_scenes(o.scenes),
            methods,
            settings,
            starts=o.starts,
            place=o.place,
            store=store,
            submission=o.submission,
        )
    return scene_summary(rows)


def run_tasks(o: suites.Tasks, config: Config) -> dict[str, Any]:
    """Plan tasks in reconstructed scenes, and execute the plans."""
    from .methods.method_runs import RunSettings
    from .tables.task_table import task_summary
    from .tasks.catalogue import find_tasks
    from .tasks.success_runs import run_successes

    settings = RunSettings(o.seed, config.refine, config.compose, o.noise)
    tasks = find_tasks(o.task)
    with _store(o, config) as store:
        rows = run_successes(tasks, o.method, settings, starts=o.starts, place=o.place, store=store)
    return task_summary(rows)


def run_plans(o: suites.Plans, config: Config) -> dict[str, Any]:
    """Request plans from a model, and execute them."""
    from .methods.method_runs import RunSettings
    from .tasks.catalogue import find_tasks
    from .tasks.model_plans import plan_figures, plan_rows

    settings = RunSettings(o.seed, config.refine, config.compose, o.noise)
    tasks = find_tasks(o.task)
    with kept_rows(o, config) as store, _panel(o, config, store) as models:
        plan = partial(plan_rows, models, methods=o.method, starts=o.starts, settings=settings)
        rows = store.all({task.name: partial(plan, task) for task in tasks})
    return {**plan_figures(rows), "rows": plain(rows)}


def run_openings(o: suites.Openings) -> dict[str, Any]:
    """Measure the openings of joints before and after the alignment."""
    from .methods.joint_openings import opening_rows, opening_summary
    from .methods.scene_runs import chosen_scenes

    rows_of = partial(opening_rows, starts=o.starts, seed=o.seed)
    with kept_rows(o) as store:
        rows = store.all({name: partial(rows_of, name) for name in chosen_scenes(o.scenes)})
    return {**opening_summary(rows), "rows": plain(rows)}


def run_coverage(o: suites.Coverage) -> dict[str, Any]:
    """Count the intervals of aligned objects that contain the truth."""
    from .methods.interval_coverage import interval_coverage, interval_rows
    from .methods.scene_runs import chosen_scenes

    jobs = {name: partial(interval_rows, name, o.starts) for name in chosen_scenes(o.scenes)}
    with kept_rows(o) as store:
        rows = store.all(jobs)
    return {"n": len(rows), "table": interval_coverage(rows)}


def run_rescue(o: suites.Rescues) -> dict[str, Any]:
    """Rescue disturbed scenes of meshes."""
    from .rescues.rescue_rows import rescue_figures, rescue_rows

    jobs = {str(seed): partial(rescue_rows, seed, photo=o.photo) for seed in range(o.scenes)}
    with kept_rows(o) as store:
        rows = store.all(jobs)
    return {**rescue_figures(rows), "rows": plain(rows)}


def run_engines(o: suites.Engines) -> dict[str, Any]:
    """Time engines, and compare their verdicts with C MuJoCo."""
    from neoworld_mjx.sweeps.cases import case

    from .engines.throughput import EngineTask, engine_rows

    tasks = [
        EngineTask(
            engine=engine,
            population=population,
            devices=devices,
            early_stop=o.early_stop,
            duration_s=o.duration,
            seed=o.seed,
            budget_s=o.budget,
        )
        for engine in o.engine
        for population in o.population
        for devices in (o.devices if engine == "mjx" and o.devices else (0,))
    ]
    scenes = {name: case(name).scene for name in o.scenes}
    jobs = {name: partial(engine_rows, name, scene, tasks) for name, scene in scenes.items()}
    with kept_rows(o) as store:
        rows = store.all(jobs)
    return {"n": len(rows), "rows": plain(rows)}


def run_examples(o: suites.Examples, config: Config) -> dict[str, Any]:
    """Reconstruct the bundled examples."""
    from .photographs.example_runs import difference_lines, differences, example_jobs

    jobs = example_jobs(o.example, config, o.provider, o.out)
    with kept_rows(o, config) as store:
        rows = store.all(jobs)
    for line in difference_lines(rows):
        log.info(line)
    return {"differences": differences(rows), "rows": plain(rows)}


def run_refine(o: suites.Refine, config: Config) -> dict[str, Any]:
    """Time the search on the scenes of photographs."""
    from .photographs.real_scenes import chosen_photographs, real_refinements

    search = {"seed": o.seed, "options": config.refine, "engine": o.engine}
    jobs = {
        name: partial(real_refinements, (name,), **search) for name in chosen_photographs(o.scene)
    }
    with kept_rows(o, config) as store:
        rows = store.all(jobs)
    return {"rows": plain(rows)}


def run_photos(o: suites.Photos, config: Config) -> dict[str, Any]:
    """Measure the errors of each step."""
    from .fidelity.step_errors import (
        QUICK,
        chosen_numbers,
        lines,
        photo_rows,
        photo_summary,
        searching_little,
    )

    scenes = chosen_numbers(o.scenes or (QUICK if o.quick else ()))
    steps = partial(
        photo_rows,
        search=not o.no_search,
        seed=o.seed,
        compose_options=config.compose,
        refine_options=searching_little(config.refine) if o.quick else config.refine,
        engine=o.engine,
    )
    with kept_rows(o, config) as store:
        rows = store.all({str(n): partial(steps, (n,)) for n in scenes})
    summary = photo_summary(rows)
    for line in lines(summary):
        log.info(line)
    return {**summary, "rows": plain(rows)}


def run_real_poses(o: suites.RealPoses, config: Config) -> dict[str, Any]:
    """Score reconstructions of real photographs."""
    from .real_poses.pose_estimates import estimate_figures, estimate_rows
    from .real_poses.real_views import real_figures, score_real_views
    from .tables.real_table import real_table
    from .tables.text_cells import records

    if o.data is None:
        raise ConfigError("real-poses needs DATA, the folder of the data set")
    result: dict[str, Any] = {}
    if o.poses is not None:
        estimates = list(estimate_rows(o.data, o.poses))
        result |= {"pose_figures": estimate_figures(estimates), "poses": plain(estimates)}
    if o.poses is None or o.runs or o.submission is not None:
        with kept_rows(o, config) as store:
            views, objects = score_real_views(
                o.data,
                runs=o.runs,
                submission=o.submission,
                kind=o.format,
                views=o.view,
                align=o.align,
                intrinsics=o.intrinsics,
                depth_scale=o.depth_scale,
                volumes=not o.no_volumes,
                options=config.refine,
                out=o.out,
                kept=store,
            )
        result |= {"figures": real_figures(views, objects), "views": plain(views)}
        result |= {"n": len(views), "rows": plain(objects), "table": records(real_table(objects))}
    return result


def run_joints(o: suites.ObjectSuite, config: Config) -> dict[str, Any]:
    """Score reconstructed objects."""
    from .objects.object_scores import score_figures, score_objects
    from .tables.joint_table import NOTE, PAPER, joint_table
    from .tables.text_cells import records

    if o.made is None:
        raise ConfigError("joints needs --made DIR, the objects, and --partnet PATH or --truth DIR")
    with kept_rows(o, config) as store:
        scored = score_objects(
            o.made,
            partnet=o.partnet,
            truth=o.truth,
            objects=o.object,
            front=o.front,
            options=config.program,
            out=o.out,
            kept=store,
        )
        rows = list(scored)
    paper = {"joints": PAPER, "note": NOTE}
    figures = {**score_figures(rows), "n": len(rows), "table": records(joint_table(rows))}
    return {**figures, "paper": paper, "rows": plain(rows)}


def run_pictures(o: suites.PictureSuite) -> dict[str, Any]:
    """Compare rendered images with photographs."""
    from .judge.made_scenes import made_scenes
    from .judge.picture_rows import picture_figures, picture_rows
    from .measures.picture_similarity import PictureModels

    models = PictureModels.load(clip=o.clip, dino=o.dino, lpips=o.lpips, uni3d=o.uni3d)
    compare = partial(picture_rows, models=models, side=o.size, objects=not o.no_objects, out=o.out)
    scenes = made_scenes(o.folders, o.data)
    with kept_rows(o) as store:
        rows = store.all({scene.numbered: partial(compare, [scene]) for scene in scenes})
    return {**picture_figures(rows), "models": models.described(), "rows": plain(rows)}


def run_judge(o: suites.Judge, config: Config) -> dict[str, Any]:
    """Let a model judge scenes."""
    from .judge.made_scenes import made_scenes
    from .judge.scene_judge import rating_figures, rating_rows

    scenes = made_scenes(o.folders, o.data)
    # Responses are kept on a tape, from which an interrupted run takes them.
    with kept_rows(o, config) as store, _panel(o, config, store) as models:
        rows = collect(rating_rows(models, scenes, repeats=o.repeats, out=o.out))
    return {**rating_figures(rows), "rows": plain(rows)}


def run_joint_videos(o: suites.JointVideos, config: Config) -> dict[str, Any]:
    """Let a model compare the motions of joints."""
    from .judge.joint_films import object_pairs
    from .judge.joint_hits import joint_hit_figures, joint_hit_rows

    pairs = object_pairs(o.made, o.truth, config.program, front=o.front)
    with kept_rows(o, config) as store, _panel(o, config, store) as models:
        rows = collect(joint_hit_rows(models, pairs, repeats=o.repeats, out=o.out))
    return {**joint_hit_figures(rows, pairs), "rows": plain(rows)}


def _panel(o: suites.ModelRequests, config: Config, store: RowStore) -> Panel:
    """Open the models; responses are recorded in the folder of an unfinished run by default."""
    tapes = () if o.tape is None else (o.tape,)
    record = o.record or (store.folder and store.folder / "responses.tape.json")
    return open_panel(config.mllm, o.provider, tapes=tapes, mailbox=o.mailbox, record=record)
