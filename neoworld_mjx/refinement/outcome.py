"""The outcome of a refinement: the winner, checked exactly, and every candidate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool

from ..config import RefineOptions
from ..measure import SceneMeasure, measured, passes, scene_checks
from ..physics.exact import snap_exactly
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..physics.placed import settled_by
from ..physics.settling import at_rest, moved
from ..progress import update
from ..spec import SceneSpec, world_poses
from ..spec.pose import pose
from .objective import Objective, Scores
from .pruning import PRUNED

RESTING = ((True, 0.5), (False, 1.0), (True, 0.5))
"""What an object that has come to rest in a coarse rollout does until the exact check; see
`at_rest`."""
DROPPED = ((False, 3.0),)
"""The same of the start, where no candidate passes: it moves freely for as long as it may take."""


class Round(NamedTuple):
    """An iteration of one run."""

    layouts: Layout
    poses: Poses
    """Where the candidates were placed."""
    scores: Scores
    rests: Bool[np.ndarray, " pop"]
    """Whether the poses are those at which the candidates came to rest."""

    def of_objects(self, count: int) -> "Round":
        """Leave padded objects out of the layouts and poses."""
        own = lambda tree: jax.tree.map(lambda x: np.asarray(x)[:, :count], tree)
        s = self.scores
        scores = eqx.tree_at(
            lambda s: (s.drift, s.depth), s, (s.drift[:, :count], s.depth[:, :count])
        )
        return Round(own(self.layouts), own(self.poses), scores, self.rests)


@dataclass(frozen=True, repr=False)
class Refined:
    """The outcome of a refinement."""

    scene: SceneSpec
    """The winner, snapped exactly."""
    measure: SceneMeasure
    """Final check of the winner."""
    before: SceneMeasure
    """The same check of the composed scene, snapped exactly."""
    layout: Layout
    """The winner's layout, pop axis of length 1."""
    history: dict[str, np.ndarray]
    """Every candidate, leading axes [iteration, pop]: `reward`, `absolute`, `status`, `valid`, each
    term under its name, `xy`, `yaw`, `log_scale`; beside them `object_names`, `term_names` and
    `term_weights`."""
    engine: str
    iterations: int
    winner: tuple[int, int]
    """(iteration, candidate)."""
    finalists_tried: int
    mean_log_scale: float
    """Mean over the winner's optimised objects."""
    mean_shift_m: float
    """Mean distance of optimised objects from the composed layout, in their parents' frames."""
    mean_turn_deg: float
    """Mean angle of yaw between the winner and the composed layout."""
    passed: bool
    """True if the winner passes the final check."""
    seconds: dict[str, float] = field(default_factory=dict)
    fallbacks: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    """Objects that were sound where they stood, and stayed there."""
    scoring: dict[str, Any] = field(default_factory=dict)
    """Calls, failures and cost of the semantic scorer; empty without one."""

    def __repr__(self) -> str:
        """Summarise the search and the final check in a few lines."""
        m, t = self.measure, self.seconds.get("search", float("nan"))
        tilt = f"{m.max_drift_m * 1e3:.2f} mm, {m.max_tilt_deg:.2f} deg"
        return (
            f"Refined({self.scene.name}: {'passed' if self.passed else 'did not pass'} the check\n"
            f"  {self.iterations} iterations, {self.rollouts} rollouts, {self.pruned} pruned, "
            f"{t:.1f} s on {self.engine}; winner {self.winner}\n"
            f"  depth {m.max_depth_m * 1e3:.2f} mm (was {self.before.max_depth_m * 1e3:.2f} mm), "
            f"moved {tilt}\n"
            f"  mean shift {self.mean_shift_m * 1e3:.1f} mm, turn {self.mean_turn_deg:.1f} deg, "
            f"log scale {self.mean_log_scale:+.3f})"
        )

    @property
    def rollouts(self) -> int:
        """Number of candidates that were rolled out."""
        return int(np.sum(~np.isin(self.history["status"], (PRUNED, NOT_DRAWN))))

    @property
    def pruned(self) -> int:
        """Number of candidates that were pruned, without a rollout."""
        return int(np.sum(self.history["status"] == PRUNED))


@dataclass(frozen=True)
class Chosen:
    """The winner, with its final check."""

    index: tuple[int, int]
    scene: SceneSpec
    measure: SceneMeasure
    tried: int
    passed: bool
    moved_away: tuple[str, ...] = ()
    """Objects that came to rest where the photograph does not show them; see `settled_by`."""
    dropped: bool = False
    """Whether it is the start, come to rest by itself."""


def choose(
    model: SceneModel,
    rounds: list[Round],
    o: RefineOptions,
    start: Layout | None = None,
    known: tuple[SceneSpec, SceneMeasure] | None = None,
) -> Chosen:
    """Choose the best valid candidate by absolute reward that also passes the exact check.

    When none of the first `finalists` passes, the start is dropped, unless candidates never come to
    rest: it needs no luck to find what merely settling finds. If it does not pass either, the least
    bad of all is chosen.

    Args:
        model: the compiled scene.
        rounds: all iterations.
        o: options of the check.
        start: what is left where every candidate failed; None is the composed scene.
        known: a scene whose check is known.
    """
    check = lambda scene: known[1] if known and known[0] == scene else measured(scene, o)
    fallback: Chosen | None = None
    order = ranked(rounds)
    for tried, ((t, k), absolute) in enumerate(order[: o.finalists], start=1):
        if not np.isfinite(absolute):
            break
        update(done=tried, of=o.finalists, unit="final check", rate=None, left_s=None)
        scene, away = finished(model, rounds[t], k)
        measure = check(scene)
        chosen = Chosen((t, k), scene, measure, tried, passes(measure, o) and not away, away)
        if chosen.passed:
            return chosen
        if fallback is None or _badness(chosen, o) < _badness(fallback, o):
            fallback = chosen
    if o.settle != "never" and o.rollout.duration_s:
        chosen = _dropped(model, start, o, min(o.finalists, len(order)))
        if chosen.passed:
            return chosen
        if fallback is not None and _badness(chosen, o) < _badness(fallback, o):
            fallback = chosen
    if fallback is None:
        # Every candidate failed in physics: the start is all there is.
        scene = snap_exactly(model.spec if start is None else model.apply(start, 0))
        measure = check(scene)
        return Chosen((-1, -1), scene, measure, o.finalists, passes(measure, o))
    return replace(fallback, tried=min(o.finalists, len(order)))


def _dropped(model: SceneModel, start: Layout | None, o: RefineOptions, tried: int) -> Chosen:
    """Let the start come to rest without drag, and check it."""
    placed = model.spec if start is None else model.apply(start, 0)
    sizes = np.zeros(len(model.names)) if start is None else np.asarray(start.log_scale)[0]
    scene = at_rest(snap_exactly(placed), DROPPED)
    away = moved_away(model, snap_exactly(placed), scene, sizes)
    measure = measured(scene, o)
    passed = passes(measure, o) and not away
    return Chosen((-1, -1), scene, measure, tried, passed, away, dropped=True)


def finished(model: SceneModel, round_: Round, k: int) -> tuple[SceneSpec, tuple[str, ...]]:
    """Describe a candidate as the final check takes it: set down exactly, or come to rest.

    Returns:
        The scene, and the objects that came to rest beyond the bounds of `settled_by`.
    """
    scene = model.apply(round_.layouts, k, round_.poses)
    if not round_.rests[k]:
        return snap_exactly(scene), ()
    pos, quat = (np.asarray(x)[k].astype(float) for x in (round_.poses.pos, round_.poses.quat))
    movable = np.flatnonzero(np.asarray(model.movable))
    ends = {model.names[n]: pose(pos[n], quat[n] / np.linalg.norm(quat[n])) for n in movable}
    rest = at_rest(moved(scene, ends), RESTING, sleeps=True)
    return rest, moved_away(model, scene, rest, np.asarray(round_.layouts.log_scale)[k])


def moved_away(
    model: SceneModel, start: SceneSpec, end: SceneSpec, log_scale: np.ndarray
) -> tuple[str, ...]:
    """Return the objects that came to rest beyond the bounds of `settled_by`.

    Args:
        model: the compiled scene.
        start: a layout of it, as placed.
        end: the same at rest.
        log_scale: of the layout, [object].
    """
    size = np.exp(log_scale)[None]
    far = settled_by(model, world_pose(start, size), world_pose(end, size), np)[0] > 1.0
    return tuple(model.names[n] for n in np.flatnonzero(far))


def world_pose(scene: SceneSpec, scale: np.ndarray) -> Poses:
    """Return where a scene's objects are, as poses of a single candidate."""
    at = list(world_poses(scene).values())
    pos, quat = (np.array([getattr(p, part) for p in at])[None] for part in ("pos", "quat"))
    return Poses(pos, quat, scale, pos[..., 2])


def ranked(rounds: list[Round]) -> list[tuple[tuple[int, int], float]]:
    """Order all candidates: valid ones first, by fidelity, then the others, by absolute reward.

    Returns:
        ((iteration, candidate), absolute reward) of each.
    """
    valid = stacked([r.scores.valid for r in rounds], False)
    absolute = stacked([r.scores.absolute for r in rounds], -np.inf)
    fidelity = stacked([r.scores.fidelity for r in rounds], -np.inf)
    pop = valid.shape[1]
    order = best_first(valid.ravel(), fidelity.ravel(), absolute.ravel())
    return [(divmod(int(k), pop), float(absolute.flat[k])) for k in order]


def best_first(valid: np.ndarray, fidelity: np.ndarray, absolute: np.ndarray) -> np.ndarray:
    """Return the indices of candidates [pop] in the order in which they are tried; see `ranked`."""
    return np.lexsort((-np.where(valid, fidelity, absolute), ~valid))


def iteration_summary(values: Mapping[str, np.ndarray], terms: Sequence[str]) -> dict[str, Any]:
    """Sum up an iteration.

    Args:
        values: `absolute`, `valid`, `status` and the reward terms of its candidates, each [pop].
        terms: names of the reward terms.

    Returns:
        "best" and "mean" of the absolute reward over the candidates that have one, the share
        "valid" of all drawn, and the terms of the best one; None where no candidate has a reward.
    """
    absolute = np.asarray(values["absolute"], float)
    finite = np.isfinite(absolute)
    drawn = max(int(np.sum(np.asarray(values["status"]) != NOT_DRAWN)), 1)
    share = {"valid": float(np.sum(values["valid"]) / drawn)}
    if not finite.any():
        return {"best": None, "mean": None, **share, **dict.fromkeys(terms)}
    k = int(np.where(finite, absolute, -np.inf).argmax())
    of_best = {name: float(values[name][k]) for name in terms}
    return {"best": float(absolute[k]), "mean": float(absolute[finite].mean()), **share, **of_best}


def _badness(chosen: Chosen, o: RefineOptions) -> float:
    checks = scene_checks(chosen.measure, o)
    return sum(check.value / check.threshold for check in checks) + len(chosen.moved_away)


def outcome(
    model: SceneModel,
    rounds: list[Round],
    chosen: Chosen,
    o: RefineOptions,
    *,
    objective: Objective,
    layout: Layout,
    before: SceneMeasure,
    engine: str,
    clock: dict[str, float],
    semantic: np.ndarray | None = None,
    scoring: dict[str, Any] | None = None,
    fallbacks: tuple[str, ...] = (),
    kept: tuple[str, ...] = (),
) -> Refined:
    """Assemble the outcome of a refinement.

    Args:
        model: the compiled scene.
        rounds: all iterations.
        chosen: the winner.
        o: options of the check.
        objective: of the search.
        layout: the winner's, pop axis of length 1.
        before: check of the layout at which the search started.
        engine: name of the physics engine.
        clock: seconds spent, by step.
        semantic: source of each candidate's S_sem [iteration, pop], as in `scorer.Mark`.
        scoring: summary of the semantic scorer.
        fallbacks: sentences on what earlier steps replaced or left out.
        kept: objects that the search left where they stood.
    """
    moves = np.asarray(model.optimised)
    logs = np.asarray(layout.log_scale[0])[moves]
    shift = np.linalg.norm(np.asarray(layout.xy[0])[moves], axis=-1)
    turn = np.degrees(np.abs(np.asarray(layout.yaw[0])[moves]))
    t, k = chosen.index
    if o.settle == "needed" and t >= 0 and rounds[t].rests[k]:
        fallbacks += (
            "nothing was valid where layouts put it, so candidates came to rest before they were "
            "judged",
        )
    if chosen.dropped:
        fallbacks += (
            f"no candidate passed the final check in {chosen.tried} tries; the scene that the "
            "search started at came to rest by itself",
        )
    if not chosen.passed:
        failed = [c.phrase() for c in scene_checks(chosen.measure, o) if not c.passed]
        failed += [f"{name} came to rest elsewhere" for name in chosen.moved_away]
        fallbacks += (
            f"no candidate passed the final check in {chosen.tried} tries; the least bad is kept: "
            f"{'; '.join(failed)}",
        )
    if o.cem.prune and objective.unbounded:
        names = ", ".join(objective.unbounded)
        fallbacks += (f"every candidate was rolled out, as the reward term {names} has no bound",)
    history = _history(model, rounds, objective)
    if semantic is not None:
        history["s_sem_from"] = semantic
    return Refined(
        scene=chosen.scene,
        measure=chosen.measure,
        before=before,
        layout=layout,
        history=history,
        engine=engine,
        iterations=len(rounds),
        winner=chosen.index,
        finalists_tried=chosen.tried,
        mean_log_scale=float(logs.mean()) if len(logs) else 0.0,
        mean_shift_m=float(shift.mean()) if len(shift) else 0.0,
        mean_turn_deg=float(turn.mean()) if len(turn) else 0.0,
        passed=chosen.passed,
        seconds=clock,
        fallbacks=fallbacks,
        kept=kept,
        scoring=scoring or {},
    )


NOT_DRAWN = -1
"""Status, in the history, of entries beyond the population of an iteration."""


def stacked(rows: list[Any], fill: Any) -> np.ndarray:
    """Stack iterations; fill shorter ones up to the largest population."""
    full = np.asarray(max(rows, key=len))
    stacked = np.full((len(rows), *full.shape), fill, full.dtype)
    for t, row in enumerate(rows):
        stacked[t, : len(row)] = row
    return stacked


def _history(model: SceneModel, rounds: list[Round], objective: Objective) -> dict[str, np.ndarray]:
    fill = {"reward": -np.inf, "absolute": -np.inf, "status": NOT_DRAWN, "valid": False}
    history = {
        name: stacked([getattr(r.scores, name) for r in rounds], empty)
        for name, empty in fill.items()
    }
    history |= {
        term.name: stacked([r.scores.terms[term.name] for r in rounds], np.nan)
        for term in objective.terms
    }
    history |= {
        name: stacked([getattr(r.layouts, name) for r in rounds], np.nan)
        for name in ("xy", "yaw", "log_scale")
    }
    history["object_names"] = np.array(model.names)
    history["term_names"] = np.array([term.name for term in objective.terms])
    history["term_weights"] = np.array([float(term.weight) for term in objective.terms], np.float32)
    return history
