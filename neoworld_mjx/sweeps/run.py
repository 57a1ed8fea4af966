"""Sweeps and ablations: refinements of scenes with several options and seeds, in one table."""

import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

from ..compilations import compiled
from ..config import RefineOptions, option_values
from ..errors import ConfigError
from ..io.files import content_hash
from ..io.names import repeated
from ..parse.photo import load_photo
from ..physics.engine import Engine
from ..physics.model import SceneModel
from ..physics.simulate import open_engine
from ..progress import report
from ..refinement.compiling import S_PHOTO, compile_for_search, reach_of, with_evidence
from ..refinement.search_run import SearchRun
from ..run_folder import versions
from ..spec import SceneSpec
from .cases import Case, Source, case
from .folder import FORMAT, SweepFolder
from .group_runs import refine_separately, runs_at_once, search_together
from .grouping import PointGroup, grouped, reasons
from .model_scores import ModelScores, scored_by_model
from .plan import Ablation, Plan, Point, points, read, shared_config
from .result import SweepResult, commit, stored_result
from .run_rows import Key, Row
from .study import check_study, run_study


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
) -> SweepResult:
    """Refine scenes with every combination of some options' values and several seeds.

    Runs that differ only in traced options are one computation; see `refinement.loop.search`.

    Args:
        plan: a plan, or its YAML file or mapping.
        out: folder for results.parquet, table.md, sweep.json and others; None writes no files.
        cases: scenes in addition to those of the plan.
        sources: functions that return the scenes named KIND:NAME, by KIND; None is `bench:NAME`,
            `crowded:N` and `photo:NAME` of the benchmark.
        engine: physics engine; chosen by the options by default.
        resume: continue the sweep in `out`.
        overwrite: replace the sweep in `out`.
        shard: (K, N) computes the K-th of N shares of the runs, each for a process or machine of
            its own; `merge` joins their folders.

    Raises:
        ConfigError: the plan is invalid; raised before any run.
        SpecError: a scene does not exist.
        RunError: the folder cannot be written, is in use, or holds files that must not be replaced.
    """
    plan = read(plan, Plan)
    if plan.study is not None:
        if shard != (1, 1):
            raise ConfigError("shard: the trials of a study depend on each other")
        check_study(plan)

        def run_point(point: Plan, scene: Case) -> SweepResult:
            return _Runner(point, [scene], {}, engine, (1, 1)).run(
                None, resume=False, overwrite=False
            )

        scenes = _cases(plan, cases, sources)
        path = None if out is None else Path(out)
        return run_study(plan, scenes, run_point, path, resume=resume, overwrite=overwrite)
    runner = _Runner(plan, cases, sources, engine, shard)
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
) -> SweepResult:
    """Refine scenes with base options and named variants, and estimate the differences.

    Unless the plan sets `fold`, runs are separate refinements; the first of each kind runs twice,
    so that times exclude compilation. Arguments and errors are those of `sweep`.
    """
    runner = _Runner(read(plan, Ablation), cases, sources, engine, shard)
    return runner.run(out, resume=resume, overwrite=overwrite)


class _Runner:
    """A validated plan with its scenes, points and groups, and the rows computed so far."""

    def __init__(
        self,
        plan: Plan | Ablation,
        scenes: Sequence[Case | SceneSpec],
        sources: Mapping[str, Source] | None,
        engine: Engine | None,
        shard: tuple[int, int],
    ) -> None:
        number, of = self.shard = shard
        if not 1 <= number <= of:
            raise ConfigError(f"shard: K/N with K from 1 to N, such as 2/4, got {number}/{of}")
        self.plan, self.engine = plan, engine
        self.kind = "sweep" if isinstance(plan, Plan) else "ablation"
        self.points = points(plan)
        self.cases = _cases(plan, scenes, sources)
        self.by_model = any(scored_by_model(point.options) for point in self.points)
        # Responses of a model arrive at any time, so such runs cannot share a computation.
        self.fold = plan.fold and not self.by_model
        options = [point.options for point in self.points]
        self.groups = grouped(options, fold=self.fold)
        self.static = reasons(options, fold=self.fold)
        if plan.fold and self.by_model:
            self.static.append("scores by a model: every run is a separate refinement")
        # Neighbouring runs cost about the same, so every N-th one balances the shards.
        every = list(self._fingerprints().items())
        self.fingerprints = dict(every[number - 1 :: of])
        if not self.fingerprints:
            raise ConfigError(f"shard: {number}/{of} of {len(every)} runs is empty")
        self.total = len(self.fingerprints)
        self.completed: dict[Key, Row] = {}
        self.folder: SweepFolder | None = None
        self.scores: ModelScores | None = None
        self.about: dict[str, Any] = {}

    def run(self, out: Path | str | None, *, resume: bool, overwrite: bool) -> SweepResult:
        """Compute all runs that `out` does not hold yet, saving after each group."""
        number, of = self.shard
        share = f", of which shard {number}/{of} has {self.total}" if of > 1 else ""
        every = len(self.points) * len(self.plan.seeds) * len(self.cases)
        report(
            f"{self.kind}: {len(self.points)} points x {len(self.plan.seeds)} seeds x "
            f"{len(self.cases)} scenes = {every} runs{share}",
            step=f"{self.kind} of {self.total} runs",
        )
        for line in self.static:
            report(f"static: {line}")
        if out is None:
            return self._run_groups()
        with SweepFolder(Path(out), self.kind, resume=resume, overwrite=overwrite) as self.folder:
            heads = self._heads()
            completed = self.folder.completed(self.fingerprints)
            self.completed = {key: row | heads[key] for key, row in completed.items()}
            if self.completed:
                report(f"{len(self.completed)} of {self.total} runs are complete")
            return self._run_groups()

    def _run_groups(self) -> SweepResult:
        if self.by_model:
            self.scores = self._open_scores()
        self.about = self._about()
        began, before = time.perf_counter(), len(self.completed)
        for scene in self.cases:
            models: dict[tuple[float, int, float], SceneModel] = {}
            compiled_kinds: set[str] = set()
            for number, group in enumerate(self.groups, start=1):
                for timing in self._run_group(scene, group, models, compiled_kinds):
                    done = len(self.completed)
                    rate = (time.perf_counter() - began) / (done - before)
                    left = (self.total - done) * rate
                    report(
                        f"{scene.name}, group {number} of {len(self.groups)}: {timing['runs']} "
                        f"runs in {timing['seconds']:.1f} s, {timing['compile_s']:.1f} s of it "
                        f"compiling {timing['compilations']} programs; {done} of {self.total} "
                        f"runs done, about {left:.0f} s left",
                        step=f"{self.kind} of {self.total} runs, {done} done, {left:.0f} s left",
                    )
                    self._save(finished=False)
        result = self._save(finished=True)
        if self.scores is not None:
            self.scores.close()
        return result

    def _heads(self) -> dict[Key, Row]:
        """Return the columns that name each run."""
        values = {point.label: point.values for point in self.points}
        return {
            (scene, point, seed): {"scene": scene, "point": point, "seed": seed} | values[point]
            for scene, point, seed in self.fingerprints
        }

    def _run_group(
        self,
        scene: Case,
        group: PointGroup,
        models: dict[tuple[float, int, float], SceneModel],
        compiled_kinds: set[str],
    ) -> Iterator[dict[str, Any]]:
        """Compute the missing runs of a group on a scene; yield the timing of every part.

        Args:
            scene: the scene.
            group: the points.
            models: compiled models of the scene, by time step, samples and reach; updated in place.
            compiled_kinds: see `refine_separately`.
        """
        pending = [
            (point, seed)
            for point in (self.points[k] for k in group.members)
            for seed in self.plan.seeds
            if (key := (scene.name, point.label, seed)) in self.fingerprints
            and key not in self.completed
        ]
        if not pending:
            return
        options = group.compile_options
        rollout = options.rollout
        shape = (rollout.timestep_s, rollout.samples_per_object, reach_of(options))
        engine = self.engine or open_engine(rollout.engine)
        size = runs_at_once(options) if self.fold else 1
        for first in range(0, len(pending), size):
            part = pending[first : first + size]
            start, before = time.perf_counter(), compiled()
            if shape not in models:
                model = compile_for_search(scene.scene, options)
                photo = None
                if scene.photo is not None and S_PHOTO in options.reward.terms:
                    photo = load_photo(scene.photo).rgb
                models[shape] = with_evidence(model, options, photo)
            rows = self._rows(scene, options, models[shape], part, engine, compiled_kinds)
            heads = self._heads()
            for (point, seed), row in zip(part, rows, strict=True):
                key = (scene.name, point.label, seed)
                self.completed[key] = heads[key] | row | {"fingerprint": self.fingerprints[key]}
            programs, compile_s = (a - b for a, b in zip(compiled(), before, strict=True))
            timing = {
                "scene": scene.name,
                "points": list(dict.fromkeys(point.label for point, _ in part)),
                "runs": len(part),
                "seconds": time.perf_counter() - start,
                "compilations": int(programs),
                "compile_s": compile_s,
            }
            self.about["groups"].append(timing)
            yield timing

    def _rows(
        self,
        scene: Case,
        options: RefineOptions,
        model: SceneModel,
        part: Sequence[tuple[Point, int]],
        engine: Engine,
        compiled_kinds: set[str],
    ) -> list[Row]:
        runs = [
            SearchRun(
                point.options, seed, None if scene.start is None else scene.start(model, seed)
            )
            for point, seed in part
        ]
        if self.fold:
            return search_together(scene, options, model, runs, engine)
        pairs = [(point, run) for (point, _), run in zip(part, runs, strict=True)]
        try:
            return refine_separately(scene, model, pairs, engine, compiled_kinds, self.scores)
        except BaseException:
            self._save(finished=False)  # Record the costs so far.
            raise

    def _save(self, *, finished: bool) -> SweepResult:
        """Return the result so far, and write it into the folder."""
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
        """Return a hash of the inputs of every run, in the order of the table's rows."""
        shared = {
            "versions": versions(),
            "fold": self.fold,
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
                "devices": [f"{d.platform}: {d.device_kind}" for d in jax.devices()],
            },
            "groups": [] if self.folder is None else self.folder.groups,
        }


def _cases(
    plan: Plan | Ablation, scenes: Sequence[Case | SceneSpec], sources: Mapping[str, Source] | None
) -> list[Case]:
    cases = [case(name, sources) for name in plan.scenes]
    cases += [scene if isinstance(scene, Case) else Case(scene.name, scene) for scene in scenes]
    if not cases:
        raise ConfigError("scenes: name at least one, as a scene.json, a run folder or KIND:NAME")
    if twice := repeated(case.name for case in cases):
        raise ConfigError(f"scenes: {', '.join(twice)} appears twice")
    return cases
