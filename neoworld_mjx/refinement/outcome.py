"""Outcome of a refinement: the winner with its final check, and all candidates."""

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from ..measure import SceneMeasure, scene_checks
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..spec import SceneSpec
from .choosing import NOT_SAMPLED, Round, Winner, stack_padded
from .loop import SearchResult, TimeToValid
from .objective import Objective
from .scorer import SemanticScorer


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
    count = len(model.names)
    layout: Layout = jax.tree.map(lambda x: np.asarray(x)[:, :count], winner.layout)
    logs = layout.log_scale[0][moves]
    shift = np.linalg.norm(layout.xy[0][moves], axis=-1)
    turn = np.degrees(np.abs(layout.yaw[0][moves]))
    fallbacks = () if scorer is None else scorer.fallbacks
    if result.stuck:
        fallbacks += (
            f"the search ended after {len(rounds)} iterations: in no candidate did "
            f"{', '.join(result.stuck)} rest where the photograph shows it",
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
        iterations=len(rounds),
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
