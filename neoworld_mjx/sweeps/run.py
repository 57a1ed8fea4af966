"""Sweeps and ablations: refinements of scenes with several options and seeds, in one table."""

import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax

from ..compilations import compiled
from ..config import option_values
from ..errors import ConfigError
from ..io.files import content_hash
from ..io.names import repeated
from ..physics.engine import Engine
from ..physics.model import SceneModel
from ..physics.simulate import open_engine
from ..progress import report
from ..refinement.scene_refinement import compile_for_search
from ..refinement.search_run import SearchRun
from ..run_folder import versions
from ..spec import SceneSpec
from .cases import Case, Source, case
from .folder import CSV, FORMAT, LATEX, TABLE, SweepFolder
from .group_runs import refine_separately, search_together
from .grouping import PointGroup, grouped, reasons
from .model_scores import ModelScores, scored_by_model
from .plan import Ablation, Plan, points, read, shared_config
from .run_rows import Key, Row
from .table import comma_separated, differences, summary, text_table

NOTES = (
    "Means over scenes and seeds with 95 % intervals: Wilson's for rates, Student's t for the "
    "others. n is the number of runs. Runs on one scene are correlated, so intervals over few "
    "scenes are too narrow to generalize. The reward uses each point's own weights: if weights "
    "differ, compare the terms."
)
DIFFERENCE_NOTES = "Paired over scenes and seeds; a positive value is larger than the base."


@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep or an ablation."""

    rows: list[Row]
    """One row per scene, point and seed with the columns `run_rows.COLUMNS`, and under "history"
    the iterations with the columns `run_rows.ITERATION_COLUMNS`."""
    points: list[dict[str, Any]]
    """Summary of each point over scenes and seeds; see `table.summary`."""
    differences: list[dict[str, Any]]
    """Differences of an ablation's variants from the base; see `table.differences`."""
    table: str
    """Both summaries as Markdown."""
    about: dict[str, Any] = field(default_factory=dict)
    """Content of sweep.json."""


def sweep(
    plan: Plan | Mapping[str, Any] | Path | str,
    out: Path | str | None = None,
    *,
    cases: Sequence[Case | SceneSpec] = (),
    sources: Mapping[str, Source] | None = None,
    engine: Engine | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> SweepResult:
    """Refine scenes with every combination of some options' values and several seeds.

    Runs that differ only in traced options are one computation; see `refinement.loop.search`.

    Args:
        plan: a plan, or its YAML file or mapping.
        out: folder for results.parquet, table.md, sweep.json and others; None writes no files.
        cases: scenes in addition to those of the plan.
        sources: functions that return the scenes named KIND:NAME, by KIND.
        engine: physics engine; chosen by the options by default.
        resume: continue the sweep in `out`.
        overwrite: replace the sweep in `out`.

    Raises:
        ConfigError: the plan is invalid; raised before any run.
        SpecError: a scene does not exist.
        RunError: the folder cannot be written, or holds files that must not be replaced.
    """
    runner = _Runner(read(plan, Plan), cases, sources or {}, engine)
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
) -> SweepResult:
    """Refine scenes with base options and named variants, and estimate the differences.

    Unless the plan sets `fold`, runs are separate refinements; the first of each kind runs twice,
    so that times exclude compilation. Arguments and errors are those of `sweep`.
    """
    runner = _Runner(read(plan, Ablation), cases, sources or {}, engine)
    return runner.run(out, resume=resume, overwrite=overwrite)


class _Runner:
    """A validated plan with its scenes, points and groups, and the rows computed so far."""

    def __init__(
        self,
        plan: Plan | Ablation,
        scenes: Sequence[Case | SceneSpec],
        sources: Mapping[str, Source],
        engine: Engine | None,
    ) -> None:
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
        self.fingerprints = self._fingerprints()
        self.total = len(self.fingerprints)
        self.completed: dict[Key, Row] = {}
        self.folder: SweepFolder | None = None
        self.scores: ModelScores | None = None
        self.about: dict[str, Any] = {}

    def run(self, out: Path | str | None, *, resume: bool, overwrite: bool) -> SweepResult:
        """Compute all runs that `out` does not hold yet, saving after each group."""
        report(
            f"{self.kind}: {len(self.points)} points x {len(self.plan.seeds)} seeds x "
            f"{len(self.cases)} scenes = {self.total} runs",
            step=f"{self.kind} of {self.total} runs",
        )
        for line in self.static:
            report(f"static: {line}")
        if out is not None:
            self.folder = SweepFolder(Path(out), self.kind, resume=resume, overwrite=overwrite)
            self.completed = self.folder.completed(self.fingerprints)
            if self.completed:
                report(f"{len(self.completed)} of {self.total} runs are complete")
        if self.by_model:
            self.scores = self._open_scores()
        self.about = self._about()
        began, before = time.perf_counter(), len(self.completed)
        for scene in self.cases:
            models: dict[tuple[float, int], SceneModel] = {}
            compiled_kinds: set[str] = set()
            for number, group in enumerate(self.groups, start=1):
                timing = self._run_group(scene, group, models, compiled_kinds)
                if timing is None:
                    continue
                done = len(self.completed)
                rate = (time.perf_counter() - began) / (done - before)
                left = (self.total - done) * rate
                report(
                    f"{scene.name}, group {number} of {len(self.groups)}: {timing['runs']} runs in "
                    f"{timing['seconds']:.1f} s, {timing['compile_s']:.1f} s of it compiling "
                    f"{timing['compilations']} programs; {done} of {self.total} runs done, about "
                    f"{left:.0f} s left",
                    step=f"{self.kind} of {self.total} runs, {done} done, {left:.0f} s left",
                )
                self._save(finished=False)
        result = self._save(finished=True)
        if self.scores is not None:
            self.scores.close()
        return result

    def _run_group(
        self,
        scene: Case,
        group: PointGroup,
        models: dict[tuple[float, int], SceneModel],
        compiled_kinds: set[str],
    ) -> dict[str, Any] | None:
        """Compute the missing runs of a group on a scene; return their timing, None without any.

        Args:
            scene: the scene.
            group: the points.
            models: compiled models of the scene, by time step and samples; updated in place.
            compiled_kinds: see `refine_separately`.
        """
        pending = [
            (point, seed)
            for point in (self.points[k] for k in group.members)
            for seed in self.plan.seeds
            if (scene.name, point.label, seed) not in self.completed
        ]
        if not pending:
            return None
        start, before = time.perf_counter(), compiled()
        rollout = group.compile_options.rollout
        shape = (rollout.timestep_s, rollout.samples_per_object)
        if shape not in models:
            models[shape] = compile_for_search(scene.scene, group.compile_options)
        model = models[shape]
        engine = self.engine or open_engine(rollout.engine)
        runs = [
            SearchRun(
                point.options, seed, None if scene.start is None else scene.start(model, seed)
            )
            for point, seed in pending
        ]
        if self.fold:
            rows = search_together(scene, group.compile_options, model, runs, engine)
        else:
            pairs = [(point, run) for (point, _), run in zip(pending, runs, strict=True)]
            try:
                rows = refine_separately(scene, model, pairs, engine, compiled_kinds, self.scores)
            except BaseException:
                self._save(finished=False)  # Record the costs so far.
                raise
        for (point, seed), row in zip(pending, rows, strict=True):
            key = (scene.name, point.label, seed)
            head = {"scene": scene.name, "point": point.label, "seed": seed, **point.values}
            self.completed[key] = head | row | {"fingerprint": self.fingerprints[key]}
        programs, compile_s = (a - b for a, b in zip(compiled(), before, strict=True))
        timing = {
            "scene": scene.name,
            "points": [self.points[k].label for k in group.members],
            "runs": len(runs),
            "seconds": time.perf_counter() - start,
            "compilations": int(programs),
            "compile_s": compile_s,
        }
        self.about["groups"].append(timing)
        return timing

    def _save(self, *, finished: bool) -> SweepResult:
        """Return the result so far, and write it into the folder."""
        about: dict[str, Any] = {**self.about, "finished": finished}
        for name in ("seconds", "compilations", "compile_s"):
            about[name] = sum(group.get(name, 0) for group in about["groups"])
        if self.scores is not None:
            about["mllm"] = self.scores.ledger
        rows = [self.completed[key] for key in self.fingerprints if key in self.completed]
        present = {row["point"] for row in rows}
        labels = [point.label for point in self.points if point.label in present]
        summaries = summary(rows, labels)
        compared = differences(rows, labels) if self.kind == "ablation" else []
        title = self.kind.capitalize()
        markdown = f"# {title}\n\n{text_table(NOTES, summaries).markdown()}"
        tex = text_table(f"{title}. {NOTES}", summaries).latex()
        if compared:
            table = text_table(DIFFERENCE_NOTES, compared, signed=True)
            markdown += f"\n## Differences from the base\n\n{table.markdown()}"
            tex += "\n" + table.latex()
        if self.folder is not None:
            axes = list(self.points[0].values)
            texts = {TABLE: markdown, CSV: comma_separated(summaries), LATEX: tex}
            self.folder.write(rows, axes, texts)
            self.folder.write_about(about)
            if finished:
                about["figure"] = self.folder.write_figure(rows, axes)
        return SweepResult(rows, summaries, compared, markdown, about)

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
            "sigma_xy": self.groups[0].compile_options.cem.sigma_xy,
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
    plan: Plan | Ablation, scenes: Sequence[Case | SceneSpec], sources: Mapping[str, Source]
) -> list[Case]:
    cases = [case(name, sources) for name in plan.scenes]
    cases += [scene if isinstance(scene, Case) else Case(scene.name, scene) for scene in scenes]
    if not cases:
        raise ConfigError("scenes: name at least one, as a scene.json, a run folder or KIND:NAME")
    if twice := repeated(case.name for case in cases):
        raise ConfigError(f"scenes: {', '.join(twice)} appears twice")
    return cases
