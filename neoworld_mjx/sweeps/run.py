"""Sweeps and ablations: refinements of scenes with many options and seeds, in one table."""

import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

from ..config import option_values
from ..errors import ConfigError, RunError
from ..io.files import content_hash
from ..io.names import repeated
from ..machines import HERE, Machines, check_machines, run_tasks
from ..progress import report
from ..run_folder import versions
from ..spec import SceneSpec
from .figure import draw
from .folder import CSV, FIGURE, FORMAT, TABLE, SweepFolder, read_rows, row_key, sweep_of
from .plan import Ablation, Plan, Point, points, read_plan
from .result import SweepResult, comma_separated, commit, result_of
from .runs import Case, Key, Row, Run, case, compute

SHARED_ENTRIES = ("kind", "plan", "points", "scenes", "versions", "commit")
"""Entries of sweep.json that must be equal in all shards of a sweep."""


def sweep(
    plan: Plan | Mapping[str, Any] | Path | str,
    out: Path | str | None = None,
    *,
    cases: Sequence[Case | SceneSpec] = (),
    resume: bool = False,
    overwrite: bool = False,
    shard: tuple[int, int] = (1, 1),
    machines: Machines = HERE,
) -> SweepResult:
    """Refine scenes with every combination of the values of some options, and with several seeds.

    Every run is one `refine`, with S_sem by geometry.

    Args:
        plan: a plan, or its YAML file, or a mapping.
        out: folder for results.parquet, table.md, sweep.json and other files. If None, no files are
            written.
        cases: scenes in addition to the scenes of the plan.
        resume: continue the sweep in `out`.
        overwrite: replace the sweep in `out`.
        shard: (K, N) computes only the K-th of N shares of the runs. Compute every share in another
            process or on another machine, and join the folders by `merge`.
        machines: where the runs are computed.

    Raises:
        ConfigError: the plan is invalid. This is raised before any run.
        EngineError: the cluster of `machines` does not answer. This is raised before any run.
        SpecError: a scene does not exist.
        RunError: the folder cannot be written, is in use, or contains files that must not be
            replaced.
    """
    return _run(read_plan(plan, Plan), out, cases, resume, overwrite, shard, machines)


def ablate(
    plan: Ablation | Mapping[str, Any] | Path | str,
    out: Path | str | None = None,
    *,
    cases: Sequence[Case | SceneSpec] = (),
    resume: bool = False,
    overwrite: bool = False,
    shard: tuple[int, int] = (1, 1),
    machines: Machines = HERE,
) -> SweepResult:
    """Refine scenes with base options and named variants, and estimate the differences.

    The arguments and errors are those of `sweep`.
    """
    return _run(read_plan(plan, Ablation), out, cases, resume, overwrite, shard, machines)


def merge(
    folders: Sequence[Path | str], out: Path | str, *, overwrite: bool = False
) -> SweepResult:
    """Join the rows of shards, and write the tables and the figure of the whole sweep or ablation.

    Unfinished shards can be merged, too. The number of runs that no shard contains is written into
    sweep.json as "missing". To compute these runs, sweep or ablate into the merged folder with
    `resume`.

    Args:
        folders: folders of the shards, or of several parts of a sweep that have the same plan.
        out: folder for the merged files, which must be new or empty.
        overwrite: replace an earlier sweep in `out`.

    Raises:
        RunError: a folder contains no sweep; shards differ in plan, scenes, versions or commit;
            two shards have rows with different fingerprints for the same run; or `out` cannot be
            written.
    """
    paths = [Path(folder) for folder in folders]
    if not paths:
        raise RunError("merge: name the folders of the shards")
    if len({path.resolve() for path in [*paths, Path(out)]}) < len(paths) + 1:
        raise RunError("merge: a folder appears twice")
    first: dict[str, Any] = {}
    rows: dict[Key, Row] = {}
    for path in paths:
        about = sweep_of(path)
        if about is None or not all(name in about for name in SHARED_ENTRIES):
            raise RunError(f"merge: {path} holds no sweep or ablation of this version")
        first = first or about
        for name in SHARED_ENTRIES:
            if about[name] != first[name]:
                difference = _difference(first[name], about[name])
                raise RunError(f"merge: {paths[0]} and {path} differ in {name}: {difference}")
        for row in read_rows(path):
            if rows.setdefault(row_key(row), row)["fingerprint"] != row["fingerprint"]:
                scene, point, seed = row_key(row)
                raise RunError(
                    f"merge: {path} and another folder have different inputs for scene {scene}, "
                    f"point {point}, seed {seed}"
                )
    order = [
        (scene, point["label"], seed)
        for scene in first["scenes"]
        for point in first["points"]
        for seed in first["plan"]["seeds"]
    ]
    about = first | {"shard": [1, 1], "shards": [str(path) for path in paths], "seconds": 0.0}
    ordered = [rows[key] for key in order if key in rows]
    with SweepFolder(out, first["kind"], resume=False, overwrite=overwrite) as folder:
        folder.keep(ordered)
        return _finish(ordered, about, len(order), folder)


def _run(
    plan: Plan | Ablation,
    out: Path | str | None,
    scenes: Sequence[Case | SceneSpec],
    resume: bool,
    overwrite: bool,
    shard: tuple[int, int],
    machines: Machines,
) -> SweepResult:
    number, count = shard
    if not 1 <= number <= count:
        raise ConfigError(f"shard: K/N with K from 1 to N, such as 2/4, got {number}/{count}")
    settings = points(plan)
    _refuse_scores_by_model(settings)
    check_machines(machines)
    cases = _cases(plan, scenes, machines)
    # Successive runs cost about the same, so taking every N-th run balances the shards.
    every = _runs(plan, cases, settings, machines)
    runs = {(run.case.name, run.point.label, run.seed): run for run in every[number - 1 :: count]}
    if not runs:
        raise ConfigError(f"shard: {number}/{count} of {len(every)} runs is empty")
    kind = "sweep" if isinstance(plan, Plan) else "ablation"
    share = f", of which shard {number}/{count} has {len(runs)}" if count > 1 else ""
    report(
        f"{kind}: {len(settings)} points x {len(plan.seeds)} seeds x {len(cases)} scenes = "
        f"{len(every)} runs{share}",
        step=f"{kind} of {len(runs)} runs",
    )
    about = {
        "format": FORMAT,
        "kind": kind,
        "plan": plan.model_dump(mode="json"),
        "scenes": [scene.name for scene in cases],
        "shard": list(shard),
        "commit": commit(),
        "points": [{"label": point.label, **point.values} for point in settings],
        "options": {"refine": settings[0].options.model_dump(mode="json")},
        "versions": versions(),
        "machine": {
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "processes": 1 if machines.ray is not None else machines.processes,
            "devices": [f"{d.platform}: {d.device_kind}" for d in jax.devices()],
        },
    }
    if out is None:
        return _compute(runs, {}, about, machines, None)
    with SweepFolder(out, kind, resume=resume, overwrite=overwrite) as folder:
        completed = folder.completed({key: run.fingerprint for key, run in runs.items()})
        # The labels of the points may have changed.
        completed = {
            key: row
            | dict(zip(("scene", "point", "seed"), key, strict=True))
            | runs[key].point.values
            for key, row in completed.items()
        }
        if completed:
            report(f"{len(completed)} of {len(runs)} runs are complete")
        return _compute(runs, completed, about, machines, folder)


def _compute(
    runs: Mapping[Key, Run],
    completed: dict[Key, Row],
    about: dict[str, Any],
    machines: Machines,
    folder: SweepFolder | None,
) -> SweepResult:
    """Compute the runs that `completed` lacks, and save each of them."""
    began, before = time.perf_counter(), len(completed)
    if folder is not None:
        folder.write_about(about | {"finished": False})
        folder.keep(_in_order(runs, completed))
    pending = [run for key, run in runs.items() if key not in completed]
    for row in run_tasks(compute, pending, machines):
        completed[row_key(row)] = row
        if folder is not None:
            folder.add(row)
        done = len(completed)
        left = (len(runs) - done) * (time.perf_counter() - began) / (done - before)
        report(
            f"{row['scene']}, {row['point']}, seed {row['seed']}: {row['rollouts']} rollouts "
            f"in {row['seconds']:.1f} s; {done} of {len(runs)} runs done, about {left:.0f} s "
            "left",
            step=f"{about['kind']} of {len(runs)} runs, {done} done, {left:.0f} s left",
        )
    about = about | {"seconds": time.perf_counter() - began}
    return _finish(_in_order(runs, completed), about, len(runs), folder)


def _in_order(runs: Mapping[Key, Run], completed: Mapping[Key, Row]) -> list[Row]:
    return [completed[key] for key in runs if key in completed]


def _finish(
    rows: Sequence[Row], about: Mapping[str, Any], expected: int, folder: SweepFolder | None
) -> SweepResult:
    """Summarize the rows, of which a complete sweep has `expected`, and write tables and figure."""
    missing = expected - len(rows)
    about = {**about, "missing": missing, "finished": not missing}
    figure = None if folder is None else draw(rows, _value_columns(about))
    if folder is not None:
        about["figure"] = None if figure is None else str(folder.path / FIGURE)
    result = result_of(rows, about)
    if folder is not None:
        folder.write_tables(rows, _value_columns(about))
        folder.write(TABLE, result.table)
        folder.write(CSV, comma_separated(result.points))
        if figure is not None:
            folder.write(FIGURE, figure)
        folder.write_about(about)
    return result


def _value_columns(about: Mapping[str, Any]) -> list[str]:
    """Return the columns that distinguish points."""
    return [name for name in about["points"][0] if name != "label"]


def _runs(
    plan: Plan | Ablation, cases: Sequence[Case], settings: Sequence[Point], machines: Machines
) -> list[Run]:
    """Return all runs, in the order of the table."""
    runs = []
    for scene in cases:
        scene_hash = content_hash(scene.scene)
        for point in settings:
            shared = [versions(), scene.name, scene_hash, option_values(point.options)]
            for seed in plan.seeds:
                fingerprint = content_hash([*shared, seed])[:16]
                runs.append(Run(scene, point, seed, fingerprint, machines.threads))
    return runs


def _refuse_scores_by_model(settings: Sequence[Point]) -> None:
    for point in settings:
        if point.options.semantic.scorer == "mllm" and point.options.reward.w_sem > 0:
            raise ConfigError(
                f"point {point.label}: runs of a sweep score S_sem by geometry; set "
                "refine.semantic.scorer: geometric, or call refine with a photo and a panel"
            )


def _read_case(name: str) -> Iterator[Case]:
    yield case(name)


def _cases(
    plan: Plan | Ablation, scenes: Sequence[Case | SceneSpec], machines: Machines
) -> list[Case]:
    # Scenes of the benchmark are composed on this machine, which takes seconds.
    report(f"reading {len(plan.scenes)} scenes", step=f"reading {len(plan.scenes)} scenes")
    here = Machines(workers=machines.workers) if machines.ray is None else HERE
    named = {loaded.name: loaded for loaded in run_tasks(_read_case, plan.scenes, here)}
    cases = [named[name] for name in plan.scenes]
    cases += [scene if isinstance(scene, Case) else Case(scene.name, scene) for scene in scenes]
    if not cases:
        raise ConfigError("scenes: name at least one, as a scene.json, a run folder or KIND:NAME")
    if twice := repeated(case.name for case in cases):
        raise ConfigError(f"scenes: {', '.join(twice)} appears twice")
    return cases


def _difference(first: Any, second: Any) -> str:
    """Describe the first difference between two entries."""
    if isinstance(first, dict) and isinstance(second, dict):
        for name in dict.fromkeys([*first, *second]):
            if first.get(name) != second.get(name):
                return f"{name}: {_difference(first.get(name), second.get(name))}"
    one, other = (str(value)[:60] for value in (first, second))
    return f"{one} and {other}"
