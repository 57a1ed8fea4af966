"""Refining a composed scene: the loop of Algorithm 1, its history, and the choice of the winner."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import numpy as np

from ..config import RefineOptions
from ..measure import SceneMeasure, scene_measure
from ..physics.engine import EarlyStop, Engine, open_engine
from ..physics.exact import snap_exactly
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel, compile_scene
from ..spec import SceneSpec
from .cem import CEMState, open_cem
from .rewards import Scores, score, user_terms, weights


@dataclass(frozen=True)
class Refined:
    """The outcome of a refinement."""

    scene: SceneSpec
    """The winner, snapped exactly."""
    measure: SceneMeasure
    """Of the winner."""
    before: SceneMeasure
    """Of the composed scene, snapped exactly."""
    layout: Layout
    """The winner's layout, pop axis of length 1."""
    history: dict[str, np.ndarray]
    """Every candidate, leading axes [iteration, pop]; named as in `Scores` and `Layout`."""
    engine: str
    iterations: int
    winner: tuple[int, int]
    """(iteration, candidate)."""
    finalists_tried: int
    mean_log_scale: float
    """Over optimised objects, of the winner."""
    mean_shift_m: float
    """Mean distance of optimised objects from the composed layout, in their parents' frames."""
    mean_turn_deg: float
    """Mean angle of yaw between the winner and the composed layout."""
    passed: bool
    """Whether the winner holds in the final check."""
    seconds: dict[str, float] = field(default_factory=dict)
    fallbacks: tuple[str, ...] = ()


def refine(
    scene: SceneSpec,
    options: RefineOptions | None = None,
    *,
    seed: int = 0,
    engine: Engine | None = None,
    progress: Callable[[str], None] | None = None,
) -> Refined:
    """Refine a composed scene by CEM (paper Section 3.3, Step 5).

    Stops after T iterations, or when the elites have gained less than `stop_gain` for `patience`
    iterations and a valid candidate has been seen. The winner is the best valid candidate by absolute reward that also passes an
    exact check; when none does, the best one that was tried is returned with `passed` False.

    Args:
        scene: the composed scene.
        options: of the search, the rewards, the rollouts and the check.
        seed: of the population draws.
        engine: what rolls candidates out; opened from the options by default.
        progress: called with one line an iteration.
    """
    o = options or RefineOptions()
    engine = engine or open_engine(o.rollout.engine)
    clock = {"compile": 0.0, "rollout": 0.0, "score": 0.0, "check": 0.0}
    began = time.perf_counter()
    model = compile_scene(
        scene,
        timestep=o.rollout.timestep_s,
        samples=o.rollout.samples_per_object,
        reach=max(1 / 3, 6.7 * o.cem.sigma_xy),
    )
    cem, params = open_cem(model, o.cem)
    w, terms = weights(o), user_terms(o.reward)
    state = cem.init(model, params)
    clock["compile"] = time.perf_counter() - began
    key = jax.random.key(seed)
    rule = _early_stop(o) if o.rollout.early_stop else None
    rounds: list[tuple[Layout, Poses, Scores]] = []
    stalled = 0
    for t in range(o.cem.iterations):
        layouts = cem.ask(jax.random.fold_in(key, t), state, params)
        began = time.perf_counter()
        rollout = engine.rollout(
            model,
            layouts,
            duration=o.rollout.duration_s,
            record_every=o.rollout.record_every_s,
            early_stop=rule,
        )
        jax.block_until_ready(rollout)
        clock["rollout"] += time.perf_counter() - began
        began = time.perf_counter()
        scores = jax.block_until_ready(score(model, layouts, rollout, w, terms))
        state = cem.tell(state, layouts, scores.reward, scores.absolute, params)
        rounds.append((layouts, rollout.start, scores))
        clock["score"] += time.perf_counter() - began
        if progress is not None:
            progress(_line(t, o.cem.iterations, scores, state))
        seen_valid = any(bool(np.any(s.valid)) for _, _, s in rounds)
        stalled = stalled + 1 if float(state.gain) < o.cem.stop_gain else 0
        if seen_valid and stalled >= o.cem.patience:
            break
    began = time.perf_counter()
    chosen = _choose(model, rounds, o)
    clock["check"] = time.perf_counter() - began
    return _finish(model, rounds, chosen, o, engine, clock)


def _early_stop(o: RefineOptions) -> EarlyStop:
    return EarlyStop(
        drift=o.reward.d_drift_cap * o.reward.drift_scale_m,
        tilt=float(np.radians(o.reward.d_drift_cap * o.reward.tilt_scale_deg)),
    )


def _line(t: int, most: int, scores: Scores, state: CEMState) -> str:
    absolute = np.asarray(scores.absolute)
    best = float(absolute.max())
    share = float(np.mean(np.asarray(scores.valid)))
    return (
        f"iteration {t + 1}/{most}: best {best:.3f}, elites {float(state.elite_mean):.3f}, "
        f"{share:.0%} valid"
    )


@dataclass(frozen=True)
class _Chosen:
    index: tuple[int, int]
    scene: SceneSpec
    measure: SceneMeasure
    tried: int
    passed: bool


def passes(measure: SceneMeasure, o: RefineOptions) -> bool:
    """Whether a scene holds: no pair too deep, before or after settling, and nothing moved."""
    deep = max(measure.max_depth_m, measure.settled_depth_m) > o.max_depth_m
    return not deep and not measure.diverged and measure.s_stab is not False


def _choose(
    model: SceneModel, rounds: list[tuple[Layout, Poses, Scores]], o: RefineOptions
) -> _Chosen:
    valid = np.stack([np.asarray(s.valid) for _, _, s in rounds])
    absolute = np.stack([np.asarray(s.absolute) for _, _, s in rounds])
    order = np.lexsort((-absolute.ravel(), ~valid.ravel()))
    fallback: _Chosen | None = None
    for tried, flat in enumerate(order[: o.finalists], start=1):
        t, k = divmod(int(flat), valid.shape[1])
        if not np.isfinite(absolute[t, k]):
            break
        layouts, poses, _ = rounds[t]
        scene = snap_exactly(model.apply(layouts, k, poses))
        found = _measure(scene, o)
        chosen = _Chosen((t, k), scene, found, tried, passes(found, o))
        if chosen.passed:
            return chosen
        if fallback is None or _badness(found, o) < _badness(fallback.measure, o):
            fallback = chosen
    if fallback is None:
        # Every candidate failed in physics: the composed scene is all there is.
        scene = snap_exactly(model.spec)
        found = _measure(scene, o)
        return _Chosen((-1, -1), scene, found, o.finalists, passes(found, o))
    return _Chosen(
        fallback.index, fallback.scene, fallback.measure, min(o.finalists, order.size), False
    )


def _measure(scene: SceneSpec, o: RefineOptions) -> SceneMeasure:
    return scene_measure(
        scene,
        duration=o.check_duration_s,
        timestep=o.check_timestep_s,
        max_depth=o.max_depth_m,
        max_drift=o.max_drift_m,
        max_tilt=o.max_tilt_deg,
    )


def _badness(m: SceneMeasure, o: RefineOptions) -> float:
    return (
        max(m.max_depth_m, m.settled_depth_m) / o.max_depth_m
        + m.max_drift_m / o.max_drift_m
        + m.max_tilt_deg / o.max_tilt_deg
    )


def _finish(
    model: SceneModel,
    rounds: list[tuple[Layout, Poses, Scores]],
    chosen: _Chosen,
    o: RefineOptions,
    engine: Engine,
    clock: dict[str, float],
) -> Refined:
    t, k = chosen.index
    count = len(model.names)
    layout = rounds[t][0][k : k + 1] if t >= 0 else Layout.zero(1, count)
    moves = np.asarray(model.optimised)
    logs = np.asarray(layout.log_scale[0])[moves]
    shift = np.linalg.norm(np.asarray(layout.xy[0])[moves], axis=-1)
    turn = np.degrees(np.abs(np.asarray(layout.yaw[0])[moves]))
    fallbacks = []
    if not chosen.passed:
        fallbacks.append(
            f"no candidate passed the final check in {chosen.tried} tries; the least bad is kept"
        )
    return Refined(
        scene=chosen.scene,
        measure=chosen.measure,
        before=_measure(snap_exactly(model.spec), o),
        layout=layout,
        history=_history(model, rounds),
        engine=engine.name,
        iterations=len(rounds),
        winner=chosen.index,
        finalists_tried=chosen.tried,
        mean_log_scale=float(logs.mean()) if len(logs) else 0.0,
        mean_shift_m=float(shift.mean()) if len(shift) else 0.0,
        mean_turn_deg=float(turn.mean()) if len(turn) else 0.0,
        passed=chosen.passed,
        seconds=clock,
        fallbacks=tuple(fallbacks),
    )


def _history(
    model: SceneModel, rounds: list[tuple[Layout, Poses, Scores]]
) -> dict[str, np.ndarray]:
    layouts = [layout for layout, _, _ in rounds]
    scores = [s for _, _, s in rounds]
    names = ("reward", "absolute", "d_pen", "d_drift", "s_sem", "prior", "status", "valid")
    history = {name: np.stack([np.asarray(getattr(s, name)) for s in scores]) for name in names}
    history |= {
        name: np.stack([np.asarray(getattr(layout, name)) for layout in layouts])
        for name in ("xy", "yaw", "log_scale")
    }
    history["object_names"] = np.array(model.names)
    return history
