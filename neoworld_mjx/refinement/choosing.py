"""Choice of the winner: the best valid candidate that passes the exact check."""

from dataclasses import dataclass, replace

import numpy as np

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
from .feasibility import failing
from .rounds import Round, ranked

COARSE_REST_PHASES = ((True, 0.5), (False, 1.0), (True, 0.5))
"""Phases, as in `at_rest`, of a candidate settled by a coarse rollout before the exact check."""
INITIAL_REST_PHASES = ((False, 3.0),)
"""Phases of the initial layout, settled if no candidate passes: free motion."""
ALIKE_M = 1e-3
"""Mean distance [m] up to which objects are at positions that failed an earlier check."""


@dataclass(frozen=True)
class Chosen:
    """The winner, with its final check."""

    index: tuple[int, int]
    scene: SceneSpec
    measure: SceneMeasure
    tried: int
    passed: bool
    moved_away: tuple[str, ...] = ()
    """Objects that settled farther than the bounds of `settled_by`."""
    initial_settled: bool = False
    """True if the winner is the settled initial layout."""


def choose(
    model: SceneModel,
    rounds: list[Round],
    o: RefineOptions,
    start: Layout | None = None,
    known: tuple[SceneSpec, SceneMeasure] | None = None,
) -> Chosen:
    """Choose the best valid candidate by absolute reward that also passes the exact check.

    The check lasts longer than a rollout. While other valid candidates are left, those that place
    an object where it has already failed the check are skipped.

    If none of the first `finalists` passes, the initial layout is settled and checked, unless
    settling is disabled. If it does not pass either, the candidate closest to passing is chosen.

    Args:
        model: the compiled scene.
        rounds: all iterations.
        o: options of the check.
        start: initial layout; None is the composed scene.
        known: a scene and its check, which is not repeated.
    """

    def check(scene: SceneSpec) -> SceneMeasure:
        return known[1] if known and known[0] == scene else measured(scene, o)

    fallback: Chosen | None = None
    remaining = [entry for entry, absolute in ranked(rounds) if np.isfinite(absolute)]
    tries = min(o.finalists, len(remaining))
    positions = _positions(model, rounds, remaining)
    failures: list[tuple[np.ndarray, np.ndarray]] = []
    for tried in range(1, tries + 1):
        t, k = remaining.pop(_untried(remaining, rounds, positions, failures))
        update(done=tried, of=tries, unit="final check", rate=None, left_s=None)
        scene, far_objects = finished(model, rounds[t], k)
        measure = check(scene)
        chosen = Chosen(
            (t, k), scene, measure, tried, passes(measure, o) and not far_objects, far_objects
        )
        if chosen.passed:
            return chosen
        if fallback is None or _badness(chosen, o) < _badness(fallback, o):
            fallback = chosen
        faulty = failing(model.names, measure, o) | np.isin(model.names, far_objects)
        failures.append((faulty, positions[t, k]))
    if o.settle != "never" and o.rollout.duration_s:
        chosen = _settled_initial(model, start, o, tries)
        if chosen.passed:
            return chosen
        if fallback is not None and _badness(chosen, o) < _badness(fallback, o):
            fallback = chosen
    if fallback is None:
        # The rollout of every candidate failed: fall back to the initial layout.
        scene = snap_exactly(model.spec if start is None else model.apply(start, 0))
        measure = check(scene)
        return Chosen((-1, -1), scene, measure, o.finalists, passes(measure, o))
    return replace(fallback, tried=tries)


def _positions(
    model: SceneModel, rounds: list[Round], entries: list[tuple[int, int]]
) -> dict[tuple[int, int], np.ndarray]:
    """Return the positions of each candidate's objects relative to their supports [object, 3]."""
    supported = [k for k, item in enumerate(model.spec.objects) if item.parent]
    supports = [model.names.index(model.spec.objects[k].parent or "") for k in supported]
    positions = {}
    for t, k in entries:
        pos = np.array(rounds[t].poses.pos[k])
        pos[supported] -= pos[supports]
        positions[t, k] = pos
    return positions


def _untried(
    remaining: list[tuple[int, int]],
    rounds: list[Round],
    positions: dict[tuple[int, int], np.ndarray],
    failures: list[tuple[np.ndarray, np.ndarray]],
) -> int:
    """Return the index of the first valid candidate without an object where it fell, or else 0."""
    for n, (t, k) in enumerate(remaining):
        if not rounds[t].scores.valid[k]:
            break
        distances = [
            np.linalg.norm((positions[t, k] - failed_positions)[failed_objects], axis=1)
            for failed_objects, failed_positions in failures
        ]
        if all(not len(d) or d.mean() > ALIKE_M for d in distances):
            return n
    return 0


def _settled_initial(
    model: SceneModel, start: Layout | None, o: RefineOptions, tried: int
) -> Chosen:
    """Settle the initial layout without drag, and check it."""
    placed = model.spec if start is None else model.apply(start, 0)
    sizes = np.zeros(len(model.names)) if start is None else np.asarray(start.log_scale)[0]
    scene = at_rest(snap_exactly(placed), INITIAL_REST_PHASES)
    far_objects = moved_away(model, snap_exactly(placed), scene, sizes)
    measure = measured(scene, o)
    passed = passes(measure, o) and not far_objects
    return Chosen((-1, -1), scene, measure, tried, passed, far_objects, initial_settled=True)


def finished(model: SceneModel, round_: Round, k: int) -> tuple[SceneSpec, tuple[str, ...]]:
    """Return a candidate's scene for the final check: snapped exactly, or settled.

    Returns:
        The scene, and the objects that settled farther than the bounds of `settled_by`.
    """
    scene = model.apply(round_.layouts, k, round_.poses)
    if not round_.rests[k]:
        return snap_exactly(scene), ()
    pos, quat = (np.asarray(x)[k].astype(float) for x in (round_.poses.pos, round_.poses.quat))
    movable = np.flatnonzero(np.asarray(model.movable))
    ends = {model.names[n]: pose(pos[n], quat[n] / np.linalg.norm(quat[n])) for n in movable}
    rest = at_rest(moved(scene, ends), COARSE_REST_PHASES, sleeps=True)
    return rest, moved_away(model, scene, rest, np.asarray(round_.layouts.log_scale)[k])


def moved_away(
    model: SceneModel, start: SceneSpec, end: SceneSpec, log_scale: np.ndarray
) -> tuple[str, ...]:
    """Return the objects that settled farther than the bounds of `settled_by`.

    Args:
        model: the compiled scene.
        start: the placed scene.
        end: the settled scene.
        log_scale: log scales of the layout [object].
    """
    size = np.exp(log_scale)[None]
    settled_far = settled_by(model, world_pose(start, size), world_pose(end, size), np)[0] > 1.0
    return tuple(model.names[n] for n in np.flatnonzero(settled_far))


def world_pose(scene: SceneSpec, scale: np.ndarray) -> Poses:
    """Return the poses of a scene's objects, as those of a single candidate."""
    poses = list(world_poses(scene).values())
    pos, quat = (np.array([getattr(p, part) for p in poses])[None] for part in ("pos", "quat"))
    return Poses(pos, quat, scale, pos[..., 2])


def _badness(chosen: Chosen, o: RefineOptions) -> float:
    checks = scene_checks(chosen.measure, o)
    return sum(check.value / check.threshold for check in checks) + len(chosen.moved_away)
