"""Refinement of a composed scene: the search of Algorithm 1, and the final check of its winner."""

import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..config import RefineOptions
from ..engines import EngineChoice
from ..mllm import Panel, Picture
from ..physics.engine import Engine
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.simulate import on_cpu, open_engine
from ..spec import SceneSpec, read_scene
from .choosing import Round, Winner, choose_winner
from .compiling import compile_for_search
from .evaluation import named_scores
from .loop import CLOCKS, Iteration, SearchResult, search
from .optimizer import Optimizer
from .outcome import Refined, outcome
from .rewards import Term
from .scorer import ScoreSource, SemanticScorer

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
