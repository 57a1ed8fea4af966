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
from ..physics.model import CompiledScene, SceneModel, compile_for_simulation, is_optimised
from ..spec import SceneSpec, read_scene
from .evaluation import Round, open_evaluation, timed
from .finishing import INITIAL, Finished, Winner, choose_winner, hold_failing, settle_and_check
from .loop import Iteration, search
from .optimizer import Optimizer, optimizer_factory
from .problem import open_terms
from .rewards import Term
from .scorer import SemanticScorer
from .searched_scene import compile_for_search, with_resting_fixed
from .user_terms import try_terms


@dataclass(frozen=True, repr=False)
class Refined:
    """Winner, final checks and history of a refinement."""

    scene: SceneSpec
    """Final scene of the winner."""
    measure: SceneMeasure
    """Measures of the winner's final check."""
    before: SceneMeasure
    """Measures of the final check of the initial layout, which is the composed scene."""
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
    """(iteration, candidate), both counted from 0; (-1, -1) for the initial layout."""
    finalists_tried: int
    """Number of candidates whose final scene was checked."""
    passed: bool
    """True if the winner passes the final check."""
    kept: tuple[str, ...]
    """Names of the optimized objects that rested in the initial layout."""
    seconds: dict[str, float]
    """Seconds spent on each step, and up to the first valid candidate (`to_valid`, NaN if there is
    none)."""
    fallbacks: tuple[str, ...]
    """Descriptions of the fallbacks of this step."""
    scoring: dict[str, Any]
    """Calls, failures and cost of the semantic scorer; empty without a semantic scorer."""
    world: CompiledScene
    """The composed scene, compiled for the final checks; the final scene is a candidate of it."""

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
        """Number of iterations of the search."""
        return len(self.history["status"])

    @property
    def rollouts(self) -> int:
        """Number of candidates that were rolled out."""
        return self.history["status"].size

    @property
    def mean_log_scale(self) -> float:
        """Mean log scale of the winner's optimized objects."""
        logs = np.asarray(self.layout.log_scale)[0, is_optimised(self.scene)]
        return float(logs.mean()) if len(logs) else 0.0

    @property
    def scores(self) -> dict[str, float]:
        """`reward`, `valid` and the terms of the winner, by name; empty for the initial layout.

        They are those of the candidate in its rollout. The final scene is settled again, with a
        smaller time step, so it is close to the candidate, but not equal to it.
        """
        if self.winner == INITIAL:
            return {}
        names = ("reward", "valid", *map(str, self.history["term_names"]))
        return {name: float(self.history[name][self.winner]) for name in names}


def history_of(
    rounds: Sequence[Round], terms: Sequence[Term], names: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return the arrays of `Refined.history`, given iterations, reward terms and object names."""

    def stacked(read: Callable[[Round], Any], *empty: int) -> np.ndarray:
        rows = [np.asarray(read(round_)) for round_ in rounds]
        return np.stack(rows) if rows else np.zeros((0, 0, *empty))

    history = {
        "reward": stacked(lambda r: r.scores.reward),
        "status": stacked(lambda r: r.scores.status),
        "valid": stacked(lambda r: r.scores.valid),
        **{t.name: stacked(lambda r, t=t: r.scores.terms[t.name]) for t in terms},
        "xy": stacked(lambda r: r.layouts.xy, len(names), 2),
        "yaw": stacked(lambda r: r.layouts.yaw, len(names)),
        "log_scale": stacked(lambda r: r.layouts.log_scale, len(names)),
        "object_names": np.array(names),
        "term_names": np.array([term.name for term in terms]),
        "term_weights": np.array([float(term.weight) for term in terms], np.float32),
    }
    if any(round_.s_sem_from is not None for round_ in rounds):
        history["s_sem_from"] = stacked(lambda r: r.s_sem_from)
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
    the result, and nothing is compiled for a search or scored, unless there are terms of a user,
    scores by a model or an optimizer that is passed. Otherwise the search perturbs the composed
    scene. It ends after T iterations, or as soon as it has converged (see `algorithm.converged`).

    Objects that rest are fixed where they settled, unless an object that carries them moves. With
    terms of a user, scores by a model or an optimizer that is passed, every object moves.

    The candidates are then ranked: valid ones before all others, and both by reward. The winner is
    the first candidate in this order that passes the final check. If none of the first `finalists`
    passes, the objects that do not rest where the photograph shows them are held there
    (`finishing.hold_failing`), and `Refined.passed` is False.

    Args:
        scene: the composed scene, compiled or not; or the path of a scene.json or of a run folder,
            from which the composed scene is read.
        options: options of the search, the rewards, the rollouts and the final check.
        seed: random seed of the populations.
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
    clock: dict[str, float] = {"compile": 0.0, "check": 0.0}
    if engine is None or isinstance(engine, str):
        engine = _open_engine(engine or o.rollout.engine, o)
    spec = scene.spec if isinstance(scene, SceneModel) else open_scene(scene)
    every = open_terms(o, terms)
    optimizer_factory(o.optimizer)  # refuses a wrong name
    by_model = o.semantic.scorer == "mllm" and o.reward.w_sem > 0
    own = by_model or optimizer is not None or any(term.fn is not None for term in every)
    rounds: list[Round] = []
    with on_cpu() if engine.name == "native" and _suits_cores(o) else contextlib.nullcontext():
        model = scene if isinstance(scene, SceneModel) else None
        if own:
            with timed(clock, "compile"):
                model = model or compile_for_search(spec, o)
            try_terms(model, every, o)
        with timed(clock, "search"):
            world = compile_for_simulation(spec)
            initial = settle_and_check(world, spec, o)
        if progress is not None:
            progress(initial_line(initial, o))
        winner, scorer = Winner(INITIAL, Layout.zero(1, len(world.names)), initial, 0), None
        clock["to_valid"] = settled_s = clock["search"]
        if own or not initial.passed or not o.settle.enabled:
            resting = initial.rests(o) & (o.cem.hold_resting and not own and not initial.passed)
            with timed(clock, "compile"):
                if resting.any():
                    model = compile_for_search(with_resting_fixed(spec, initial, o), o)
                model = model or compile_for_search(spec, o)
            scorer = SemanticScorer(model, photo, panel, o.semantic) if by_model else None
            try:
                with timed(clock, "search"):
                    evaluation = open_evaluation(
                        model,
                        o,
                        engine,
                        resting=resting,
                        terms=terms,
                        optimizer=optimizer,
                        clock=clock,
                    )
                    rounds = search(
                        evaluation,
                        seed=seed,
                        scorer=scorer,
                        progress=progress,
                        on_iteration=on_iteration,
                    )
            finally:
                if scorer is not None:
                    scorer.close()
            clock["to_valid"] += settled_s
            with timed(clock, "check"):
                winner = choose_winner(world, model, rounds, o, initial)
    if not winner.finished.passed and o.settle.enabled:
        with timed(clock, "check"):
            finished = hold_failing(spec, winner.finished, o)
            winner = winner._replace(finished=finished)
    fallbacks = () if scorer is None else scorer.fallbacks
    if not winner.finished.passed:
        failed = _failures(winner.finished, o)
        if winner.rejected is not None and o.settle.enabled:
            failed += f" (the best candidate: {_failures(winner.rejected, o)})"
        fallbacks += (f"no candidate passed the final check in {winner.tried} tries: {failed}",)
    kept = np.flatnonzero(initial.rests(o) & is_optimised(spec))
    return Refined(
        scene=winner.finished.scene,
        measure=winner.finished.measure,
        before=initial.measure,
        layout=jax.tree.map(np.asarray, winner.layout),
        history=history_of(rounds, every, world.names),
        engine=engine.name,
        winner=winner.candidate,
        finalists_tried=winner.tried,
        passed=winner.finished.passed,
        kept=tuple(world.names[k] for k in kept),
        seconds=clock,
        fallbacks=fallbacks,
        scoring={} if scorer is None else scorer.summary(),
        world=world,
    )


def _failures(finished: Finished, o: RefineOptions) -> str:
    """Return the failed checks of a final scene in one line."""
    return "; ".join(c.phrase() for c in scene_checks(finished.measure, o) if not c.passed)


def initial_line(initial: Finished, o: RefineOptions) -> str:
    """Return how many objects rest in the settled initial layout, and which do not."""
    moving, objects = is_optimised(initial.scene), initial.scene.objects
    failing = [objects[k].name for k in np.flatnonzero(moving & ~initial.rests(o))]
    if not failing:
        return f"all {int(moving.sum())} objects rest where they were placed"
    return f"{len(failing)} of {int(moving.sum())} objects do not rest: {', '.join(failing)}"


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
