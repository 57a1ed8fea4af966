"""Sweeps and ablations: refinements of scenes with many options and seeds, in one table."""

import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax

from ..config import option_values
from ..errors import ConfigError, RunError
from ..io.files import content_hash
from ..io.names import repeated
from ..physics.engine import Engine
from ..places import HERE, Place, check_place, run_tasks
from ..progress import report
from ..run_folder import versions
from ..spec import SceneSpec
from .cases import Case, Source, case
from .folder import FORMAT, RESULTS, SweepFolder
from .group_runs import SweepPart, compute, forget_compiled, runs_at_once
from .grouping import group_points, grouping_reasons
from .model_scores import ModelScores, scored_by_model
from .plan import Ablation, Plan, Request, points, read_plan, shared_config
from .result import SweepResult, commit, stored_result
from .run_rows import Key, Row, read_runs, row_key
from .study import StudyTask, check_study, run_study
from .trackers import OnIteration, TrackedRun


def sweep(
    plan: Plan | Mapping[str, Any] | Path | str,
    out: Path | str | None = None,
    *,
    cases: Sequence[Case | SceneSpec] = (),
    sources: Mapping[str, Source] | None = None,
    engine: Engine | None = None,
    resume: bool = False,
    overwrite: bool = False,
    shard: tuple[int, int] = (1, 1),
    place: Place = HERE,
    on_iteration: OnIteration | None = None,
) -> SweepResult:
    """Refine scenes with every combination of the values of some options, and with several seeds.

    Runs that differ only in traced options share one computation; see `refinement.loop.search`.

    Args:
        plan: a plan, or its YAML file, or a mapping.
        out: folder for results.parquet, table.md, sweep.json and other files. If None, no files are
            written.
        cases: scenes in addition to the scenes of the plan.
        sources: functions that return the scenes named KIND:NAME, by KIND. If None, the scenes of
            the benchmark are available as `bench:NAME`, `crowded:N` and `photo:NAME`.
        engine: physics engine. If None, the options name the engine.
        resume: continue the sweep in `out`.
        overwrite: replace the sweep in `out`.
        shard: (K, N) computes only the K-th of N shares of the runs. Compute every share in another
            process or on another machine, and join the folders by `merge`.
        place: where the runs are computed.
        on_iteration: function that receives every iteration of each new run as soon as the run is
            complete; see `trackers.OnIteration`.

    Raises:
        ConfigError: the plan is invalid. This is raised before any run.
        EngineError: the cluster of `place` does not answer. This is raised before any run.
        SpecError: a scene does not exist.
        RunError: the folder cannot be written, is in use, or contains files that must not be
            replaced.
    """
    plan = read_plan(plan, Plan)
    if plan.study is not None:
        if shard != (1, 1):
            raise ConfigError(
                "shard: the trials of a study depend on each other; run the study with --workers, "
                "--ray or --slurm instead"
            )
        check_study(plan)
        check_place(place)
        by_model = scored_by_model(shared_config(plan).refine)
        _check_ledger(by_model or "refine.semantic.scorer" in plan.axes, place)

        def run_points(tasks: Sequence[StudyTask]) -> Iterator[tuple[int, SweepResult]]:
            work = partial(_run_trial, engine=engine, threads=place.threads)
            for task, result in run_tasks(work, tasks, place):
                for row in result.rows if on_iteration is not None else ():
                    _track(on_iteration, row, task.plan.axes)
                yield task.trial, result

        scenes = _cases(plan, cases, sources, place)
        path = None if out is None else Path(out)
        return run_study(
            plan,
            scenes,
            run_points,
            path,
            width=place.processes,
            resume=resume,
            overwrite=overwrite,
        )
    runner = _Runner(plan, cases, sources, engine, shard, place, on_iteration)
    return runner.run(out, resume=resume, overwrite=overwrite)


def ablate(
    plan: Ablation | Mapping[str, Any] | Path | str,
    out: Path | str | None = None,
    *,
    cases: Sequence[Case | SceneSpec] = (),
    sources: Mapping[str, Source] | None = None,
    engine: Engine | None = None,
    resume: bool = False,
    overwrite: bool = False,
    shard: tuple[int, int] = (1, 1),
    place: Place = HERE,
    on_iteration: OnIteration | None = None,
) -> SweepResult:
    """Refine scenes with base options and named variants, and estimate the differences.

    Unless the plan sets `fold`, every run is a separate refinement, and the first run with given
    static options runs twice, so that times exclude compilation. The arguments and errors are those
    of `sweep`.
    """
    runner = _Runner(read_plan(plan, Ablation), cases, sources, engine, shard, place, on_iteration)
    return runner.run(out, resume=resume, overwrite=overwrite)


def check(
    plan: Request | Mapping[str, Any] | Path | str,
    out: Path | str,
    kind: type[Request],
    *,
    cases: Sequence[Case | SceneSpec] = (),
    sources: Mapping[str, Source] | None = None,
    engine: Engine | None = None,
) -> dict[str, Any]:
    """Check that the rows in a folder can be compared with each other, without computing anything.

    The fingerprint of each row must be the one that follows from the plan, the scenes and the
    installed versions. The rows then differ only in their options and seeds.

    Args:
        plan: see `sweep` and `ablate`.
        out: folder of the rows.
        kind: Plan or Ablation.
        cases: see `sweep`.
        sources: see `sweep`.
        engine: see `sweep`.

    Returns:
        "checked" is the number of rows, and "missing" the number of runs that have no row.

    Raises:
        RunError: a row has another fingerprint or belongs to no run of the plan, or the folder
            cannot be read.
    """
    runner = _Runner(read_plan(plan, kind), cases, sources, engine, (1, 1), HERE, None)
    rows = {row_key(row): row["fingerprint"] for row in read_runs(Path(out) / RESULTS)}
    mismatched = [key for key, mark in rows.items() if runner.fingerprints.get(key) != mark]
    if mismatched:
        scene, point, seed = mismatched[0]
        raise RunError(
            f"{out}: {len(mismatched)} of {len(rows)} rows come from other scenes, options or "
            f"versions than those of this plan here, such as scene {scene}, point {point}, "
            f"seed {seed}: they must not be compared; compute them again with --resume"
        )
    return {"checked": len(rows), "missing": runner.total - len(rows)}


def _check_ledger(by_model: bool, place: Place) -> None:
    if by_model and (place.remote or place.processes > 1):
        raise ConfigError(
            "a sweep that is scored by a model has one ledger: it runs in one process on this "
            "machine"
        )


def _run_trial(
    task: StudyTask, engine: Engine | None, threads: int
) -> Iterator[tuple[StudyTask, SweepResult]]:
    """Refine a scene with the single point of a trial's plan."""
    runner = _Runner(task.plan, [task.case], {}, engine, (1, 1), HERE, None)
    runner.threads = threads
    yield task, runner.run(None, resume=False, overwrite=False)


def _track(on_iteration: OnIteration | None, row: Row, values: Mapping[str, Any]) -> None:
    if on_iteration is None:
        return
    for step in row["history"]:
        on_iteration(TrackedRun(row["scene"], row["point"], row["seed"], dict(values)), step)


class _Runner:
    """A validated plan with its scenes, points and groups, and the rows that have been computed."""

    def __init__(
        self,
        plan: Plan | Ablation,
        scenes: Sequence[Case | SceneSpec],
        sources: Mapping[str, Source] | None,
        engine: Engine | None,
        shard: tuple[int, int],
        place: Place,
        on_iteration: OnIteration | None,
    ) -> None:
        shard_number, shard_count = self.shard = shard
        if not 1 <= shard_number <= shard_count:
            raise ConfigError(
                f"shard: K/N with K from 1 to N, such as 2/4, got {shard_number}/{shard_count}"
            )
        self.plan, self.engine, self.place = plan, engine, place
        self.threads = place.threads
        self.on_iteration = on_iteration
        self.kind = "sweep" if isinstance(plan, Plan) else "ablation"
        self.points = points(plan)
        check_place(place)
        self.cases = _cases(plan, scenes, sources, place)
        self.by_model = any(scored_by_model(point.options) for point in self.points)
        _check_ledger(self.by_model, place)
        # Runs that wait for responses of a model cannot share a computation.
        self.together = plan.fold and not self.by_model
        options = [point.options for point in self.points]
        self.groups = group_points(options, together=self.together)
        self.static = grouping_reasons(options, together=self.together)
        if plan.fold and self.by_model:
            self.static.append("scores by a model: every run is a separate refinement")
        # Successive runs cost about the same, so taking every N-th run balances the shards.
        all_runs = list(self._fingerprints().items())
        self.fingerprints = dict(all_runs[shard_number - 1 :: shard_count])
        if not self.fingerprints:
            raise ConfigError(
                f"shard: {shard_number}/{shard_count} of {len(all_runs)} runs is empty"
            )
        self.total = len(self.fingerprints)
        self.completed: dict[Key, Row] = {}
        self.folder: SweepFolder | None = None
        self.scores: ModelScores | None = None
        self.about: dict[str, Any] = {}

    def run(self, out: Path | str | None, *, resume: bool, overwrite: bool) -> SweepResult:
        """Compute all runs that `out` does not contain yet, and save the rows after each part."""
        shard_number, shard_count = self.shard
        share = (
            f", of which shard {shard_number}/{shard_count} has {self.total}"
            if shard_count > 1
            else ""
        )
        run_count = len(self.points) * len(self.plan.seeds) * len(self.cases)
        report(
            f"{self.kind}: {len(self.points)} points x {len(self.plan.seeds)} seeds x "
            f"{len(self.cases)} scenes = {run_count} runs{share}",
            step=f"{self.kind} of {self.total} runs",
        )
        for line in self.static:
            report(f"static: {line}")
        if out is None:
            return self._run_groups()
        with SweepFolder(Path(out), self.kind, resume=resume, overwrite=overwrite) as self.folder:
            run_columns = self._run_columns()
            completed = self.folder.completed(self.fingerprints)
            self.completed = {key: row | run_columns[key] for key, row in completed.items()}
            if self.completed:
                report(f"{len(self.completed)} of {self.total} runs are complete")
            return self._run_groups()

    def _run_groups(self) -> SweepResult:
        if self.by_model:
            self.scores = self._open_scores()
        self.about = self._about()
        forget_compiled()
        began, before, run_columns = time.perf_counter(), len(self.completed), self._run_columns()
        work = partial(compute, scores=self.scores)
        try:
            for part, rows, timing in run_tasks(work, self._parts(), self.place):
                for (point, seed), row in zip(part.runs, rows, strict=True):
                    key = (part.case.name, point.label, seed)
                    self.completed[key] = (
                        run_columns[key] | row | {"fingerprint": self.fingerprints[key]}
                    )
                    _track(self.on_iteration, self.completed[key], point.values)
                self.about["groups"].append(timing)
                done = len(self.completed)
                left = (self.total - done) * (time.perf_counter() - began) / (done - before)
                report(
                    f"{part.case.name}: {timing['runs']} runs in {timing['seconds']:.1f} s, "
                    f"{timing['compile_s']:.1f} s of it compiling {timing['compilations']} "
                    f"programs; {done} of {self.total} runs done, about {left:.0f} s left",
                    step=f"{self.kind} of {self.total} runs, {done} done, {left:.0f} s left",
                )
                self._save(finished=False)
        except BaseException:
            if self.scores is not None:
                self._save(finished=False)  # Record the costs so far.
            raise
        result = self._save(finished=True)
        if self.scores is not None:
            self.scores.close()
        return result

    def _run_columns(self) -> dict[Key, Row]:
        """Return the columns that identify each run: scene, point, seed and values of the point."""
        values = {point.label: point.values for point in self.points}
        return {
            (scene, point, seed): {"scene": scene, "point": point, "seed": seed} | values[point]
            for scene, point, seed in self.fingerprints
        }

    def _parts(self) -> list[SweepPart]:
        """Return the runs that `completed` lacks, by scene and group, as tasks."""
        parts = []
        for scene in self.cases:
            scene_hash = content_hash(scene.scene)
            for group in self.groups:
                options = group.compile_options
                pending = [
                    (point, seed)
                    for point in (self.points[k] for k in group.members)
                    for seed in self.plan.seeds
                    if (key := (scene.name, point.label, seed)) in self.fingerprints
                    and key not in self.completed
                ]
                size = runs_at_once(options) if self.together else 1
                if self.place.processes > 1 or self.place.remote:
                    size = min(size, len(self.plan.seeds))  # One point per task.
                for first in range(0, len(pending), size):
                    runs = tuple(pending[first : first + size])
                    parts.append(
                        SweepPart(scene, scene_hash, options, runs, self.together, self.engine,
                             self.threads)
                    )  # fmt: skip
        return parts

    def _save(self, *, finished: bool) -> SweepResult:
        """Return the result so far, and write it into the folder if there is one."""
        if self.scores is not None:
            self.about["mllm"] = self.scores.ledger
        rows = [self.completed[key] for key in self.fingerprints if key in self.completed]
        return stored_result(rows, self.about, self.folder, finished=finished)

    def _open_scores(self) -> ModelScores:
        scores = ModelScores(
            shared_config(self.plan),
            recorded=self.plan.scores,
            tapes=self.plan.tapes,
            out=None if self.folder is None else self.folder.path,
            earlier={} if self.folder is None else self.folder.ledger,
        )
        for scene in self.cases:
            scores.check(scene)
        return scores

    def _fingerprints(self) -> dict[Key, str]:
        """Return the fingerprint of every run, a hash of its inputs, in the order of the table."""
        shared = {
            "versions": versions(),
            "fold": self.together,
            "engine": None if self.engine is None else self.engine.name,
        }
        config = shared_config(self.plan)
        scoring = {"provider": config.provider, "model": config.mllm.critic.model}
        if self.plan.scores is not None:
            scoring = {"recorded": str(self.plan.scores)}
        fingerprints = {}
        for scene in self.cases:
            scene_hash = content_hash(scene.scene)
            for point in self.points:
                options = option_values(point.options)
                for seed in self.plan.seeds:
                    inputs = [shared, scene.name, scene_hash, options, seed]
                    inputs += [scoring] if scored_by_model(point.options) else []
                    fingerprints[scene.name, point.label, seed] = content_hash(inputs)[:16]
        return fingerprints

    def _about(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "kind": self.kind,
            "plan": self.plan.model_dump(mode="json"),
            "scenes": [scene.name for scene in self.cases],
            "shard": list(self.shard),
            "commit": commit(),
            "points": [{"label": point.label, **point.values} for point in self.points],
            "options": {"refine": self.points[0].options.model_dump(mode="json")},
            "static": self.static,
            "versions": versions(),
            "machine": {
                "system": platform.platform(),
                "cores": os.cpu_count(),
                "processes": 1 if self.place.remote else self.place.processes,
                "devices": [f"{d.platform}: {d.device_kind}" for d in jax.devices()],
            },
            "groups": [] if self.folder is None else self.folder.groups,
        }


def _read_case(name: str) -> Iterator[Case]:
    yield case(name)


def _cases(
    plan: Plan | Ablation,
    scenes: Sequence[Case | SceneSpec],
    sources: Mapping[str, Source] | None,
    place: Place = HERE,
) -> list[Case]:
    if sources is None and not place.remote:
        # Scenes of the benchmark are composed here, which takes seconds.
        report(f"reading {len(plan.scenes)} scenes", step=f"reading {len(plan.scenes)} scenes")
        named = {loaded.name: loaded for loaded in run_tasks(_read_case, plan.scenes, place)}
        cases = [named[name] for name in plan.scenes]
    else:
        cases = [case(name, sources) for name in plan.scenes]
    cases += [scene if isinstance(scene, Case) else Case(scene.name, scene) for scene in scenes]
    if not cases:
        raise ConfigError("scenes: name at least one, as a scene.json, a run folder or KIND:NAME")
    if twice := repeated(case.name for case in cases):
        raise ConfigError(f"scenes: {', '.join(twice)} appears twice")
    return cases
