"""The winner of a search: the best candidate that also passes the exact check."""

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
"""What an object that has come to rest in a coarse rollout does until the exact check; see
`at_rest`."""
INITIAL_REST_PHASES = ((False, 3.0),)
"""The same of the start, where no candidate passes: it moves freely for as long as it may take."""
ALIKE_M = 1e-3
"""Mean distance up to which objects that failed a check are again where they failed."""


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

    A check goes on for longer than a rollout: what it finds falling is not tried where it fell
    before, while valid candidates have it elsewhere.

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
    left = [entry for entry, absolute in ranked(rounds) if np.isfinite(absolute)]
    most = min(o.finalists, len(left))
    places = _places(model, rounds, left)
    fell: list[tuple[np.ndarray, np.ndarray]] = []
    for tried in range(1, most + 1):
        t, k = left.pop(_untried(left, rounds, places, fell))
        update(done=tried, of=most, unit="final check", rate=None, left_s=None)
        scene, away = finished(model, rounds[t], k)
        measure = check(scene)
        chosen = Chosen((t, k), scene, measure, tried, passes(measure, o) and not away, away)
        if chosen.passed:
            return chosen
        if fallback is None or _badness(chosen, o) < _badness(fallback, o):
            fallback = chosen
        faulty = failing(model.names, measure, o) | np.isin(model.names, away)
        fell.append((faulty, places[t, k]))
    if o.settle != "never" and o.rollout.duration_s:
        chosen = _settled_initial(model, start, o, most)
        if chosen.passed:
            return chosen
        if fallback is not None and _badness(chosen, o) < _badness(fallback, o):
            fallback = chosen
    if fallback is None:
        # Every candidate failed in physics: the start is all there is.
        scene = snap_exactly(model.spec if start is None else model.apply(start, 0))
        measure = check(scene)
        return Chosen((-1, -1), scene, measure, o.finalists, passes(measure, o))
    return replace(fallback, tried=most)


def _places(
    model: SceneModel, rounds: list[Round], entries: list[tuple[int, int]]
) -> dict[tuple[int, int], np.ndarray]:
    """Return where each candidate's objects are from what carries them [object, 3]."""
    carried = [k for k, item in enumerate(model.spec.objects) if item.parent]
    carriers = [model.names.index(model.spec.objects[k].parent or "") for k in carried]
    places = {}
    for t, k in entries:
        pos = np.array(rounds[t].poses.pos[k])
        pos[carried] -= pos[carriers]
        places[t, k] = pos
    return places


def _untried(
    left: list[tuple[int, int]],
    rounds: list[Round],
    places: dict[tuple[int, int], np.ndarray],
    fell: list[tuple[np.ndarray, np.ndarray]],
) -> int:
    """Return the first valid candidate in which nothing is where it fell; else the first of all."""
    for n, (t, k) in enumerate(left):
        if not rounds[t].scores.valid[k]:
            break
        off = [np.linalg.norm((places[t, k] - was)[who], axis=1) for who, was in fell]
        if all(not len(d) or d.mean() > ALIKE_M for d in off):
            return n
    return 0


def _settled_initial(
    model: SceneModel, start: Layout | None, o: RefineOptions, tried: int
) -> Chosen:
    """Let the start come to rest without drag, and check it."""
    placed = model.spec if start is None else model.apply(start, 0)
    sizes = np.zeros(len(model.names)) if start is None else np.asarray(start.log_scale)[0]
    scene = at_rest(snap_exactly(placed), INITIAL_REST_PHASES)
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
    rest = at_rest(moved(scene, ends), COARSE_REST_PHASES, sleeps=True)
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


def _badness(chosen: Chosen, o: RefineOptions) -> float:
    checks = scene_checks(chosen.measure, o)
    return sum(check.value / check.threshold for check in checks) + len(chosen.moved_away)
