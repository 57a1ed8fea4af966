"""Refinement of a composed scene: the search of Algorithm 1, and the final check of its winner."""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..config import RefineOptions
from ..engines import EngineChoice
from ..measure import SceneMeasure, scene_checks
from ..mllm import Panel, Picture
from ..physics.engine import Engine, on_cpu, open_engine
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..quantities import count
from ..spec import SceneSpec, read_scene
from .choosing import NOT_SAMPLED, Round, Winner, choose_winner, stack_padded
from .evaluation import named_scores
from .finishing import compile_for_search
from .loop import CLOCKS, Iteration, SearchResult, TimeToValid, search
from .objective import Objective
from .optimizer import Optimizer
from .rewards import Term
from .scorer import ScoreSource, SemanticScorer


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

    The keys are `reward`, `absolute`, `merit`, `status`, `valid`, the name of each term, `xy`,
    `yaw` and `log_scale`, and `s_sem_from` (a `ScoreSource`) if a model scored candidates. The
    keys `object_names`, `term_names` and `term_weights` hold arrays without these axes.
    """
    engine: str
    iterations: int
    """Number of iterations of the search; the evaluation of the initial layout is none."""
    winner: tuple[int, int]
    """(iteration, candidate); see `Winner.index`."""
    finalists_tried: int
    """Number of candidates whose final scene was checked."""
    mean_log_scale: float
    """Mean log scale of the winner's optimized objects."""
    mean_shift_m: float
    """Mean distance of optimized objects from the composed layout, in the parents' frames [m]."""
    mean_turn_deg: float
    """Mean absolute yaw of optimized objects relative to the composed layout [deg]."""
    passed: bool
    """True if the winner passes the final check."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Seconds spent on each step."""
    fallbacks: tuple[str, ...] = ()
    """Descriptions of the fallbacks of this and of earlier steps."""
    kept: tuple[str, ...] = ()
    """Names of the optimized objects that rested in the initial layout."""
    scoring: dict[str, Any] = field(default_factory=dict)
    """Calls, failures and cost of the semantic scorer; empty without a semantic scorer."""
    delivered: dict[str, float] = field(default_factory=dict)
    """`absolute`, `merit` and the terms of `scene`; `history` contains those of the candidate."""
    first_valid: TimeToValid | None = None
    """When the search found its first valid candidate; None if no candidate was valid."""

    def __repr__(self) -> str:
        """Summarize the search and the final check in a few lines."""
        m, t = self.measure, self.seconds.get("search", float("nan"))
        tilt = f"{m.max_drift_m * 1e3:.2f} mm, {m.max_tilt_deg:.2f} deg"
        return (
            f"Refined({self.scene.name}: {'passed' if self.passed else 'did not pass'} the check\n"
            f"  {self.iterations} iterations, {self.rollouts} rollouts, "
            f"{t:.1f} s on {self.engine}; winner {self.winner}\n"
            f"  depth {m.max_depth_m * 1e3:.2f} mm (was {self.before.max_depth_m * 1e3:.2f} mm), "
            f"moved {tilt}\n"
            f"  mean shift {self.mean_shift_m * 1e3:.1f} mm, turn {self.mean_turn_deg:.1f} deg, "
            f"log scale {self.mean_log_scale:+.3f})"
        )

    @property
    def rollouts(self) -> int:
        """Number of candidates that were rolled out."""
        return int(np.sum(self.history["status"] != NOT_SAMPLED))


def outcome(
    model: SceneModel,
    result: SearchResult,
    rounds: list[Round],
    winner: Winner,
    *,
    engine: str,
    clock: dict[str, float],
    delivered: dict[str, float],
    scorer: SemanticScorer | None = None,
) -> Refined:
    """Assemble the outcome of a refinement.

    Args:
        model: the compiled scene.
        result: the search.
        rounds: iterations of the search, including the scores that arrived late.
        winner: the winner.
        engine: name of the physics engine.
        clock: seconds spent on each step.
        delivered: scores of the final scene; see `Evaluation.score_final`.
        scorer: source of S_sem by a model.
    """
    o = result.evaluation.options
    moves = np.asarray(model.optimised)
    number = len(model.names)
    layout: Layout = jax.tree.map(lambda x: np.asarray(x)[:, :number], winner.layout)
    logs = layout.log_scale[0][moves]
    shift = np.linalg.norm(layout.xy[0][moves], axis=-1)
    turn = np.degrees(np.abs(layout.yaw[0][moves]))
    fallbacks = () if scorer is None else scorer.fallbacks
    if result.stuck:
        fallbacks += (
            f"the search ended after {count(result.iterations_done, 'iteration')}: in no candidate "
            f"did {', '.join(result.stuck)} rest where the photograph shows it",
        )
    if not winner.passed:
        failed = [c.phrase() for c in scene_checks(winner.measure, o) if not c.passed]
        fallbacks += (
            f"no candidate passed the final check in {winner.tried} tries; the closest one is "
            f"used: {'; '.join(failed)}",
        )
    history = _history(model, rounds, result.problem.objective)
    if scorer is not None:
        history["s_sem_from"] = stack_padded(result.score_sources, 0)
    rests = result.initial.rests(o)
    return Refined(
        scene=winner.scene,
        measure=winner.measure,
        before=winner.before,
        layout=layout,
        history=history,
        engine=engine,
        iterations=result.iterations_done,
        winner=winner.index,
        finalists_tried=winner.tried,
        mean_log_scale=float(logs.mean()) if len(logs) else 0.0,
        mean_shift_m=float(shift.mean()) if len(shift) else 0.0,
        mean_turn_deg=float(turn.mean()) if len(turn) else 0.0,
        passed=winner.passed,
        seconds=clock,
        fallbacks=fallbacks,
        kept=tuple(model.names[k] for k in np.flatnonzero(rests & moves)),
        scoring={} if scorer is None else scorer.summary(),
        delivered=delivered,
        first_valid=result.first_valid,
    )


def _history(model: SceneModel, rounds: list[Round], objective: Objective) -> dict[str, np.ndarray]:
    fill = {
        "reward": -np.inf,
        "absolute": -np.inf,
        "merit": -np.inf,
        "status": NOT_SAMPLED,
        "valid": False,
    }
    history = {
        name: stack_padded([getattr(r.scores, name) for r in rounds], empty)
        for name, empty in fill.items()
    }
    history |= {
        term.name: stack_padded([r.scores.terms[term.name] for r in rounds], np.nan)
        for term in objective.terms
    }
    history |= {
        name: stack_padded([getattr(r.layouts, name) for r in rounds], np.nan)
        for name in ("xy", "yaw", "log_scale")
    }
    history["object_names"] = np.array(model.names)
    history["term_names"] = np.array([term.name for term in objective.terms])
    history["term_weights"] = np.array([float(term.weight) for term in objective.terms], np.float32)
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
    the result. Otherwise the search perturbs the composed scene. It ends after T iterations, or as
    soon as it has converged (see `algorithm.converged`).

    The candidates are then ranked. Valid candidates come first and are ranked by merit (see
    `Scores.merit`); all others are ranked by absolute reward. The winner is the first candidate in
    this order that passes the final check. If none of the first `finalists` passes, the one that is
    closest to passing is returned, and `Refined.passed` is False.

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
    clock: dict[str, float] = dict.fromkeys(("compile", *CLOCKS, "check"), 0.0)
    if engine is None or isinstance(engine, str):
        engine = _open_engine(engine or o.rollout.engine, o)
    with on_cpu() if engine.name == "native" and _suits_cores(o) else contextlib.nullcontext():
        began = time.perf_counter()
        model = open_scene(scene, o)
        clock["compile"] = time.perf_counter() - began
        scorer = None
        if o.semantic.scorer == "mllm" and o.reward.w_sem > 0:
            scorer = SemanticScorer(model, photo, panel, o.semantic)
        try:
            result = search(
                model,
                o,
                engine,
                seed=seed,
                start=start,
                terms=terms,
                optimizer=optimizer,
                scorer=scorer,
                clock=clock,
                progress=progress,
                on_iteration=on_iteration,
            )
            rounds = result.rounds
            if scorer is not None:
                scorer.collect(len(rounds))
                rounds = [
                    _with_late_scores(scorer, t, round_, sources, o.reward.w_sem)
                    for t, (round_, sources) in enumerate(
                        zip(rounds, result.score_sources, strict=True)
                    )
                ]
        finally:
            if scorer is not None:
                scorer.close()
        began = time.perf_counter()
        winner = choose_winner(
            model,
            rounds,
            o,
            result.initial,
            start,
            result.evaluation.scene,
            accept_initial=result.accept_initial,
        )
        by_model = None
        if scorer is not None and winner.index[0] >= 0:
            t, k = winner.index
            by_model = float(np.asarray(rounds[t].scores.terms["s_sem"])[k])
        delivered = _delivered_scores(result, winner, by_model)
        clock["check"] = time.perf_counter() - began
        return outcome(
            model,
            result,
            rounds,
            winner,
            engine=engine.name,
            clock=clock | {"to_valid": result.first_valid_s},
            delivered=delivered,
            scorer=scorer,
        )


def _open_engine(name: str, o: RefineOptions) -> Engine:
    """Open an engine by its name; `auto` selects the CPU engine if the population is small."""
    return open_engine("native" if name == "auto" and _suits_cores(o) else name)


def _suits_cores(o: RefineOptions) -> bool:
    """Return whether the population is too small to benefit from an accelerator."""
    return o.cem.population <= MAX_CPU_POPULATION


def open_scene(scene: SceneSpec | SceneModel | Path | str, options: RefineOptions) -> SceneModel:
    """Read and compile a scene for a refinement; return a compiled scene unchanged.

    Raises:
        SpecError: there is no scene at the path.
        TypeError: the scene has another type.
    """
    if isinstance(scene, SceneModel):
        return scene
    if isinstance(scene, Path | str):
        scene = read_composed(Path(scene))
    if not isinstance(scene, SceneSpec):
        raise TypeError(
            f"refine takes a SceneSpec, a SceneModel, or the path of a scene.json or run folder, "
            f"got a {type(scene).__name__}"
        )
    return compile_for_search(scene, options)


def read_composed(path: Path) -> SceneSpec:
    """Read a scene.json, or the composed scene of a run folder.

    Raises:
        SpecError: there is no scene at the path.
    """
    composed = path / COMPOSED
    return read_scene(composed if composed.is_file() else path)


def _delivered_scores(
    result: SearchResult, winner: Winner, by_model: float | None
) -> dict[str, float]:
    """Return `absolute`, `merit` and the terms of the winner's final scene, by name."""
    settles = result.evaluation.options.settle.enabled
    if winner.index == (0, 0) and winner.passed and settles and by_model is None:
        # The search has already scored the initial layout at its settled poses.
        return named_scores(result.rounds[0].scores)
    return result.evaluation.score_final(winner.scene, winner.layout, by_model)


def _with_late_scores(
    scorer: SemanticScorer, t: int, round_: Round, score_sources: np.ndarray, weight: float
) -> Round:
    """Add the scores of an iteration that arrived after its elites had been selected."""
    s_sem = np.asarray(round_.scores.terms["s_sem"])
    change = np.zeros(len(score_sources), np.float32)
    for k in range(len(score_sources)):
        late = scorer.known((t, k))
        if late is not None:
            change[k] = late - float(s_sem[k])
            score_sources[k] = ScoreSource.SCORED
    scores = eqx.tree_at(
        lambda s: (s.terms["s_sem"], s.reward, s.absolute, s.merit),
        round_.scores,
        (
            jnp.asarray(s_sem + change),
            round_.scores.reward + weight * change,
            round_.scores.absolute + weight * change,
            round_.scores.merit + weight * change,
        ),
    )
    return round_._replace(scores=scores)
