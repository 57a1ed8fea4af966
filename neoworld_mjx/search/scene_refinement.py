"""Refinement of a composed scene: the search of Algorithm 1, and the final check of its winner."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..config import RefineOptions
from ..engines import EngineChoice
from ..measure import SceneMeasure, scene_checks
from ..mllm import Panel, Picture
from ..physics.engine import Engine, on_cpu, open_engine
from ..physics.layout import Layout
from ..physics.model import SceneModel, is_optimised
from ..spec import SceneSpec, read_scene
from .choosing import choose_winner
from .evaluation import Round, timed
from .finishing import Finished, compile_for_search, settle_and_check
from .loop import Iteration, initial_line, search
from .optimizer import Optimizer, optimizer_factory
from .problem import open_terms
from .rewards import Term
from .scorer import ScoreSource, SemanticScorer

NOT_SAMPLED = -1
"""Status in the history of entries beyond the population of an iteration, which pad it."""


@dataclass(frozen=True, repr=False)
class Refined:
    """Winner, final checks and history of a refinement."""

    scene: SceneSpec
    """Final scene of the winner."""
    measure: SceneMeasure
    """Measures of the winner's final check."""
    before: SceneMeasure
    """Measures of the final check of the initial layout, which is the composed scene by default."""
    layout: Layout
    """Layout of the winner, with a population axis of length 1."""
    history: dict[str, np.ndarray]
    """Arrays of all candidates, with leading axes [iteration, pop].

    The keys are `reward`, `status`, `valid`, the name of each term, `xy`, `yaw` and `log_scale`,
    and `s_sem_from` (a `ScoreSource`) if a model scored candidates. The keys `object_names`,
    `term_names` and `term_weights` hold arrays without these axes.
    """
    engine: str
    winner: tuple[int, int]
    """(iteration, candidate); see `Winner.candidate`."""
    finalists_tried: int
    """Number of candidates whose final scene was checked."""
    passed: bool
    """True if the winner passes the final check."""
    kept: tuple[str, ...]
    """Names of the optimized objects that rested in the initial layout."""
    mean_log_scale: float
    """Mean log scale of the winner's optimized objects."""
    seconds: dict[str, float]
    """Seconds spent on each step, and up to the first valid candidate (`to_valid`, NaN if there is
    none)."""
    fallbacks: tuple[str, ...]
    """Descriptions of the fallbacks of this step."""
    scoring: dict[str, Any]
    """Calls, failures and cost of the semantic scorer; empty without a semantic scorer."""

    def __repr__(self) -> str:
        """Summarize the search and the final check in a few lines."""
        m, t = self.measure, self.seconds.get("search", float("nan"))
        tilt = f"{m.max_drift_m * 1e3:.2f} mm, {m.max_tilt_deg:.2f} deg"
        return (
            f"Refined({self.scene.name}: {'passed' if self.passed else 'did not pass'} the check\n"
            f"  {self.iterations} iterations, {self.rollouts} rollouts, "
            f"{t:.1f} s on {self.engine}; winner {self.winner}\n"
            f"  depth {m.max_depth_m * 1e3:.2f} mm (was {self.before.max_depth_m * 1e3:.2f} mm), "
            f"moved {tilt})"
        )

    @property
    def iterations(self) -> int:
        """Number of iterations of the search; the evaluation of the initial layout is none."""
        sampled = np.sum(self.history["status"] != NOT_SAMPLED, axis=1)
        return len(sampled) - int(len(sampled) > 0 and sampled[0] == 1)

    @property
    def rollouts(self) -> int:
        """Number of candidates that were rolled out."""
        return int(np.sum(self.history["status"] != NOT_SAMPLED))

    @property
    def scores(self) -> dict[str, float]:
        """`reward`, `valid` and the terms of the winner, by name; empty if nothing was rolled out.

        They are those of the candidate in its rollout. The final scene is settled again, with a
        smaller time step, so it is close to the candidate, but not equal to it.
        """
        if self.winner[0] < 0 or not self.rollouts:
            return {}
        names = ("reward", "valid", *map(str, self.history["term_names"]))
        return {name: float(self.history[name][self.winner]) for name in names}


def history_of(
    rounds: Sequence[Round], terms: Sequence[Term], names: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return the arrays of `Refined.history`.

    Args:
        rounds: the iterations, which are padded to the largest population.
        terms: the reward terms.
        names: names of the objects.
    """

    def stacked(read: Callable[[Round], Any], fill: Any) -> np.ndarray:
        rows = [np.asarray(read(round_)) for round_ in rounds]
        pop = max(map(len, rows), default=0)
        last = rows[0].shape[1:] if rows else ()
        whole = np.full((len(rows), pop, *last), fill, rows[0].dtype if rows else None)
        for row, values in zip(whole, rows, strict=True):
            row[: len(values)] = values
        return whole

    history = {
        "reward": stacked(lambda r: r.scores.reward, -np.inf),
        "status": stacked(lambda r: r.scores.status, NOT_SAMPLED),
        "valid": stacked(lambda r: r.scores.valid, False),
        **{t.name: stacked(lambda r, t=t: r.scores.terms[t.name], np.nan) for t in terms},
        **{
            part: stacked(lambda r, part=part: getattr(r.layouts, part), np.nan)
            for part in ("xy", "yaw", "log_scale")
        },
        "object_names": np.array(names),
        "term_names": np.array([term.name for term in terms]),
        "term_weights": np.array([float(term.weight) for term in terms], np.float32),
    }
    if any(round_.s_sem_from is not None for round_ in rounds):
        geometric = lambda r: np.full(len(r.scores.valid), ScoreSource.GEOMETRIC, np.int8)
        sources = lambda r: geometric(r) if r.s_sem_from is None else r.s_sem_from
        history["s_sem_from"] = stacked(sources, ScoreSource.GEOMETRIC)
    return history


COMPOSED = "compose/scene.json"
"""Path of the composed scene in a run folder."""
MAX_CPU_POPULATION = 256
"""Largest population for which 16 CPU cores were as fast as the GPU of the same machine."""


def refine(
    scene: SceneSpec | SceneModel | Path | str,
    options: RefineOptions | None = None,
    *,
    seed: int = 0,
    start: Layout | None = None,
    engine: Engine | EngineChoice | None = None,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
    photo: Picture | None = None,
    panel: Panel | None = None,
    progress: Callable[[str], None] | None = None,
    on_iteration: Callable[[Iteration], bool | None] | None = None,
) -> Refined:
    """Refine a composed scene (paper Section 3.3, Step 5).

    The composed scene is settled under guidance. If the settled scene passes the final check, it is
    the result, and unless the scene was given compiled, nothing is compiled for a search or scored.
    Otherwise the search perturbs the composed scene. It ends after T iterations, or as
    soon as it has converged (see `algorithm.converged`).

    The candidates are then ranked: valid ones before all others, and both by reward. The winner is
    the first candidate in this order that passes the final check. If none of the first `finalists`
    passes, the one that is closest to passing is returned, and `Refined.passed` is False.

    Args:
        scene: the composed scene, compiled or not; or the path of a scene.json or of a run folder,
            from which the composed scene is read.
        options: options of the search, the rewards, the rollouts and the final check.
        seed: random seed of the populations.
        start: initial layout, with a population axis of length 1. If None, it is the composed
            scene.
        engine: physics engine or its name. If None, the options name the engine.
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name; see `optimizer.Optimizer`.
        photo: the photograph, for S_sem by a model.
        panel: models, of which the critic scores candidates.
        progress: called with one line per iteration.
        on_iteration: called with a summary of each iteration as soon as it is complete. The search
            ends if it returns True.

    Raises:
        ConfigError: two options contradict each other, a reward term is invalid, or the options
            require a photograph and `photo` is None.
        EngineError: the engine is not available.
        SpecError: there is no scene at the path.
        TypeError: the scene has another type.
    """
    o = options or RefineOptions()
    clock: dict[str, float] = {}
    if engine is None or isinstance(engine, str):
        engine = _open_engine(engine or o.rollout.engine, o)
    with on_cpu() if engine.name == "native" and _suits_cores(o) else contextlib.nullcontext():
        initial = None
        by_model = o.semantic.scorer == "mllm" and o.reward.w_sem > 0
        if not isinstance(scene, SceneModel):
            scene = open_scene(scene)
            own = bool(terms or o.reward.terms or optimizer or by_model)
            if start is None and o.settle.enabled and not own:
                optimizer_factory(o.optimizer)  # refuses a wrong name
                with timed(clock, "search"):
                    initial = settle_and_check(scene, o)
                if initial.passed:
                    if progress is not None:
                        progress(initial_line(initial, o))
                    return _refined_at_rest(initial, engine, o, clock)
            with timed(clock, "compile"):
                scene = compile_for_search(scene, o)
        model = scene
        scorer = SemanticScorer(model, photo, panel, o.semantic) if by_model else None
        try:
            result = search(
                model,
                o,
                engine,
                seed=seed,
                start=start,
                initial=initial,
                terms=terms,
                optimizer=optimizer,
                scorer=scorer,
                clock=clock,
                progress=progress,
                on_iteration=on_iteration,
            )
        finally:
            if scorer is not None:
                scorer.close()
        with timed(clock, "check"):
            winner = choose_winner(
                model,
                result.rounds,
                o,
                result.initial,
                start,
                result.evaluation.scene,
                accept_initial=result.accept_initial,
            )
    moves = np.asarray(model.optimised)
    logs = np.asarray(winner.layout.log_scale)[0, : len(moves)][moves]
    fallbacks = () if scorer is None else scorer.fallbacks
    if not winner.finished.passed:
        failed = [c.phrase() for c in scene_checks(winner.finished.measure, o) if not c.passed]
        fallbacks += (
            f"no candidate passed the final check in {winner.tried} tries; the closest one is "
            f"used: {'; '.join(failed)}",
        )
    return Refined(
        scene=winner.finished.scene,
        measure=winner.finished.measure,
        before=result.initial.measure,
        layout=jax.tree.map(lambda x: np.asarray(x)[:, : len(moves)], winner.layout),
        history=history_of(result.rounds, result.evaluation.problem.terms, model.names),
        engine=engine.name,
        winner=winner.candidate,
        finalists_tried=winner.tried,
        passed=winner.finished.passed,
        kept=tuple(model.names[k] for k in np.flatnonzero(result.initial.rests(o) & moves)),
        mean_log_scale=float(logs.mean()) if len(logs) else 0.0,
        seconds=clock,
        fallbacks=fallbacks,
        scoring={} if scorer is None else scorer.summary(),
    )


def _refined_at_rest(
    initial: Finished, engine: Engine, o: RefineOptions, clock: dict[str, float]
) -> Refined:
    """Return the result for a composed scene that passes: nothing is compiled for a search."""
    names = tuple(item.name for item in initial.scene.objects)
    kept = initial.rests(o) & is_optimised(initial.scene)
    return Refined(
        scene=initial.scene,
        measure=initial.measure,
        before=initial.measure,
        layout=Layout.zero(1, len(names)),
        history=history_of((), open_terms(o), names),
        engine=engine.name,
        winner=(0, 0),
        finalists_tried=0,
        passed=True,
        kept=tuple(name for name, at_rest in zip(names, kept, strict=True) if at_rest),
        mean_log_scale=0.0,
        seconds={"compile": 0.0, "check": 0.0, **clock, "to_valid": clock["search"]},
        fallbacks=(),
        scoring={},
    )


def _open_engine(name: str, o: RefineOptions) -> Engine:
    """Open an engine by its name; `auto` selects the CPU engine if the population is small."""
    return open_engine("native" if name == "auto" and _suits_cores(o) else name)


def _suits_cores(o: RefineOptions) -> bool:
    """Return whether the population is too small to benefit from an accelerator."""
    return o.cem.population <= MAX_CPU_POPULATION


def open_scene(scene: SceneSpec | Path | str) -> SceneSpec:
    """Return a scene, read from a file if it is a path.

    Raises:
        SpecError: there is no scene at the path.
        TypeError: the scene has another type.
    """
    if isinstance(scene, Path | str):
        scene = read_composed(Path(scene))
    if not isinstance(scene, SceneSpec):
        raise TypeError(
            f"refine takes a SceneSpec, a SceneModel, or the path of a scene.json or run folder, "
            f"got a {type(scene).__name__}"
        )
    return scene


def read_composed(path: Path) -> SceneSpec:
    """Read a scene.json, or the composed scene of a run folder.

    Raises:
        SpecError: there is no scene at the path.
    """
    composed = path / COMPOSED
    return read_scene(composed if composed.is_file() else path)
