"""Functions that run the suites of `neoworld bench run`: options in, a JSON object out.

Rows are kept as they come, and an interrupted run continues: see `unfinished_runs`.
"""

from functools import partial
from pathlib import Path
from typing import Any

from neoworld_mjx.config import Config
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.mllm import Panel, open_panel

from . import suites
from .machine import machine
from .rows import collect, log, plain
from .unfinished_runs import KeptRows, unfinished


def run_physics(o: suites.Physics) -> dict[str, Any]:
    """Time engines."""
    from .engines.growth import growth, growth_json, require_matplotlib, write_chart
    from .engines.throughput import physics

    if o.chart is not None:
        require_matplotlib()
    described = machine()
    limits = {"duration": o.duration, "budget": o.budget, "seed": o.seed}
    with unfinished(o) as folder:
        kept = KeptRows(folder)
        rows = list(physics(o.objects, o.population, o.engine, **limits, kept=kept))
    curves = growth(rows)
    if o.chart is not None:
        write_chart(o.chart, curves)
    return {"machine": described, "rows": plain(rows), "growth": growth_json(curves)}


def run_kernels(o: suites.Kernels) -> dict[str, Any]:
    """Time the implementations of the penetration term."""
    from .engines.kernel_times import kernels, update_dispatch_table
    from .engines.penetration import accuracy, random_pairs

    described = machine()
    limits = {"samples": o.samples, "seed": o.seed, "budget": o.budget}
    jobs = {
        f"{count} objects": partial(kernels, (count,), o.population, **limits)
        for count in o.objects
    }
    with unfinished(o) as folder:
        kept = KeptRows(folder)
        rows = kept.all(jobs)
        if o.table is not None:
            update_dispatch_table(o.table, rows)
        pairs = []
        if o.pairs:
            pairs = kept.rows("pairs", lambda: accuracy(random_pairs(o.pairs, seed=o.seed)))
    return {"machine": described, "rows": plain(rows), "accuracy": plain(pairs)}


def run_devices(o: suites.Devices) -> dict[str, Any]:
    """Compare one device with several."""
    import jax

    from .methods.device_scaling import device_counts, in_a_process, scaling, scaling_tasks

    counts = o.devices or device_counts(len(jax.local_devices()))
    tasks = scaling_tasks(
        counts,
        () if o.no_rollouts else o.objects,
        o.population,
        None if o.no_sweep else (o.points, o.seeds, o.sweep_population, o.iterations),
        repeats=o.repeats,
        seed=o.seed,
    )
    rows = scaling(tasks, lambda task: in_a_process(task, o.budget))
    return {"rows": plain(collect(rows))}


def run_agreement(o: suites.Agreement) -> dict[str, Any]:
    """Compare engines with MuJoCo."""
    from .engines.agreement import ModelRow, VerdictRow, agreed, agreement, chosen_scenes

    jobs = {
        name: partial(agreement, (name,), o.engine, layouts=o.layouts, seed=o.seed)
        for name in chosen_scenes(o.scene)
    }
    with unfinished(o) as folder:
        rows = KeptRows(folder).all(jobs)
    return {
        **agreed(rows),
        "n": len(rows),
        "models": plain([row for row in rows if isinstance(row, ModelRow)]),
        "verdicts": plain([row for row in rows if isinstance(row, VerdictRow)]),
    }


def run_examples(o: suites.Examples, config: Config) -> dict[str, Any]:
    """Reconstruct the bundled examples."""
    from .photographs.example_runs import difference_lines, differences, example_jobs

    jobs = example_jobs(o.example, config, o.provider, o.out)
    with unfinished(o, config) as folder:
        rows = KeptRows(folder).all(jobs)
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
    with unfinished(o, config) as folder:
        rows = KeptRows(folder).all(jobs)
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
    jobs = {str(n): partial(steps, (n,)) for n in chosen_numbers(o.scenes)}
    with unfinished(o, config) as folder:
        rows = KeptRows(folder).all(jobs)
    return {**photo_summary(rows), "rows": plain(rows)}


def run_openings(o: suites.Openings) -> dict[str, Any]:
    """Measure the openings of joints before and after the alignment."""
    from .methods.joint_openings import opening_rows, opening_summary
    from .methods.scene_runs import chosen_scenes

    jobs = {
        name: partial(opening_rows, name, starts=o.starts, seed=o.seed)
        for name in chosen_scenes(o.scenes)
    }
    with unfinished(o) as folder:
        rows = KeptRows(folder).all(jobs)
    return {**opening_summary(rows), "rows": plain(rows)}


def run_coverage(o: suites.Coverage) -> dict[str, Any]:
    """Count the intervals of the alignment that hold the truth."""
    from .methods.interval_coverage import interval_coverage, interval_rows
    from .methods.scene_runs import chosen_scenes

    jobs = {name: partial(interval_rows, name, o.starts) for name in chosen_scenes(o.scenes)}
    with unfinished(o) as folder:
        rows = KeptRows(folder).all(jobs)
    return {"n": len(rows), "table": interval_coverage(rows)}


def run_scenes(o: suites.SceneSet, config: Config) -> dict[str, Any]:
    """Run methods on the thirty scenes."""
    from .methods.method_runs import RunSettings
    from .methods.named_methods import read_methods
    from .methods.scene_runs import chosen_scenes
    from .methods.scene_runs import run_scenes as run_methods_on_scenes
    from .tables.figure_tables import scene_figure_table
    from .tables.scene_summary import summarise

    methods, named = read_methods(o.method, o.label, config)
    with unfinished(o, config) as folder:
        rows = run_methods_on_scenes(
            chosen_scenes(o.scenes),
            methods,
            RunSettings(o.seed, config.refine, config.compose, o.noise, named),
            starts=o.starts,
            place=o.place,
            out=o.out or folder,
            submission=o.submission,
        )
    return {**summarise(rows), **scene_figure_table(rows, methods)}


def run_real_poses(o: suites.RealPoses, config: Config) -> dict[str, Any]:
    """Score reconstructions of real photographs."""
    from .real_poses.real_views import real_figures, score_real_views

    if o.data is None or o.runs is None:
        raise ConfigError("real-poses needs DATA, the folder of the data set, and --runs DIR")
    with unfinished(o, config) as folder:
        views, objects = score_real_views(o.data, o.runs, config.refine, KeptRows(folder))
    return {"figures": real_figures(views, objects), "views": plain(views), "rows": plain(objects)}


def run_joints(o: suites.ObjectSuite, config: Config) -> dict[str, Any]:
    """Score reconstructed objects."""
    from .measures.object_scores import object_names, score_figures, score_object
    from .paper_figures import PAPER_JOINTS, PAPER_SURFACES

    if o.made is None or o.truth is None:
        raise ConfigError("joints needs --made DIR and --truth DIR, folders of objects")
    score = partial(score_object, made=o.made, truth=o.truth, front=o.front, options=config.program)
    jobs = {name: partial(score, name) for name in object_names(o.made, o.truth, o.object)}
    with unfinished(o, config) as folder:
        rows = KeptRows(folder).all(jobs)
    paper = {"joints": PAPER_JOINTS, "surfaces": PAPER_SURFACES}
    return {**score_figures(rows), "paper": paper, "rows": plain(rows)}


def run_rescue(o: suites.Rescues) -> dict[str, Any]:
    """Rescue disturbed scenes of meshes."""
    from neoworld_mjx.cache import keep_compilations

    from .rescues.rescue_rows import rescue_figures, rescue_rows

    keep_compilations()
    jobs = {str(seed): partial(rescue_rows, seed, photo=o.photo) for seed in range(o.scenes)}
    with unfinished(o) as folder:
        rows = KeptRows(folder).all(jobs)
    return {**rescue_figures(rows), "rows": plain(rows)}


def run_tasks(o: suites.Tasks) -> dict[str, Any]:
    """Check tasks on the ground truth."""
    from .tasks.catalogue import find_tasks
    from .tasks.task_checks import check_tasks, summarised

    if not 0 <= o.directions <= 64:
        raise ConfigError(f"--directions takes 0 to 64, got {o.directions}")
    jobs = {task.name: partial(check_tasks, [task], o.directions) for task in find_tasks(o.task)}
    with unfinished(o) as folder:
        rows = KeptRows(folder).all(jobs)
    return {**summarised(rows), "rows": plain(rows)}


def run_task_success(o: suites.TaskSuccess, config: Config) -> dict[str, Any]:
    """Plan tasks in reconstructed scenes, and execute the plans."""
    from .methods.method_runs import RunSettings
    from .tables.figure_tables import task_figure_table
    from .tasks.catalogue import find_tasks
    from .tasks.success_runs import run_successes
    from .tasks.success_summary import success_summary

    with unfinished(o, config) as folder:
        rows = run_successes(
            find_tasks(o.task),
            o.method,
            RunSettings(o.seed, config.refine, config.compose, o.noise),
            starts=o.starts,
            place=o.place,
            out=o.out or folder,
        )
    return {**success_summary(rows), **task_figure_table(rows, o.method)}


def run_plans(o: suites.Plans, config: Config) -> dict[str, Any]:
    """Request plans from a model, and execute them."""
    from .methods.method_runs import RunSettings
    from .tasks.catalogue import find_tasks
    from .tasks.model_plans import plan_figures, plan_rows

    if not 0 <= o.offset <= 1 or not 0 <= o.rounds <= 20:
        raise ConfigError(
            f"--offset takes 0 to 1 m and --rounds 0 to 20, got {o.offset:g} and {o.rounds}"
        )
    if o.offset and o.method:
        raise ConfigError("--offset displaces the true scene: give it without --method")
    tasks = find_tasks(o.task)
    with unfinished(o, config) as folder, _panel(o, config, folder) as models:
        plan = partial(
            plan_rows,
            models,
            rounds=o.rounds,
            offset_m=o.offset,
            feedback=o.feedback,
            seed=o.seed,
            sees=o.sees,
            methods=o.method,
            starts=o.starts,
            settings=RunSettings(o.seed, config.refine, config.compose, o.noise),
        )
        rows = KeptRows(folder).all({task.name: partial(plan, [task]) for task in tasks})
    return {**plan_figures(rows), "rows": plain(rows)}


def run_pictures(o: suites.PictureSuite) -> dict[str, Any]:
    """Compare rendered images with photographs."""
    from .judge.made_scenes import made_scenes
    from .judge.picture_rows import picture_figures, picture_rows
    from .measures.picture_similarity import PictureModels

    models = PictureModels(clip=o.clip, dino=o.dino, lpips=o.lpips, uni3d=o.uni3d)
    compare = partial(picture_rows, models=models, side=o.size)
    jobs = {each.numbered: partial(compare, each) for each in made_scenes(o.folders, o.data)}
    with unfinished(o) as folder:
        rows = KeptRows(folder).all(jobs)
    return {**picture_figures(rows), "models": models.described(), "rows": plain(rows)}


def run_judge(o: suites.Judge, config: Config) -> dict[str, Any]:
    """Let a model judge scenes."""
    from .judge.made_scenes import made_scenes
    from .judge.scene_judge import rating_figures, rating_rows

    scenes = made_scenes(o.folders, o.data)
    # Responses are kept on a tape, from which an interrupted run takes them.
    with unfinished(o, config) as folder, _panel(o, config, folder) as models:
        rows = collect(rating_rows(models, scenes, repeats=o.repeats))
    return {**rating_figures(rows), "rows": plain(rows)}


def _panel(o: suites.ModelRequests, config: Config, folder: Path | None) -> Panel:
    """Open the models; responses are recorded in the folder of an unfinished run by default."""
    tapes = () if o.tape is None else (o.tape,)
    record = o.record or (folder and folder / "responses.tape.json")
    return open_panel(config.mllm, o.provider, tapes=tapes, mailbox=o.mailbox, record=record)
