"""Final scenes: layouts settled and checked in C MuJoCo, and the best layout that passes.

All of them are candidates of one compiled scene, the composed one.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..config import RefineOptions
from ..measure import SceneMeasure, passes, rest_and_measure, resting
from ..physics.colliders import snap_exactly
from ..physics.layout import Layout
from ..physics.model import CompiledScene, SceneModel, compile_for_simulation
from ..physics.native import NativeEngine
from ..physics.photo_view import photo_deviations
from ..physics.rest import settle
from ..progress import update
from ..spec import SceneObject, SceneSpec, bounds, support_frame, world_poses
from ..spec.pose import yaw_of
from .evaluation import Round

RELEASES = 2
"""Number of times that a scene which fails its final check is settled again.

Each time, the failing objects start where a free fall takes them. A potato that settled on an
unstable side can thus roll onto a stable one.
"""
MAX_DEVIATIONS = 4.0
"""Largest horizontal distance of an object from its place in the estimate, in standard deviations:
see `deviations_from`. Right results of the benchmark are up to 3.9 away, wrong ones 5.2 and more
(docs/decisions.md)."""
INITIAL = (-1, -1)
"""`Winner.candidate` of the initial layout."""


class Finished(NamedTuple):
    """Final scene of a layout, with its final check."""

    scene: SceneSpec
    measure: SceneMeasure
    passed: bool
    """True if the scene passes the final check, which includes that no object moved away."""

    def rests(self, o: RefineOptions) -> Bool[np.ndarray, " object"]:
        """Return a mask of the objects that rest; see `measure.resting`."""
        return resting(self.scene, self.measure, o)


class Winner(NamedTuple):
    """Winner of a search, with its final scene and final check."""

    candidate: tuple[int, int]
    """(iteration, candidate), or INITIAL."""
    layout: Layout
    """Layout of the winner, with a population axis of length 1."""
    finished: Finished
    tried: int
    """Number of candidates whose final scene was checked."""
    rejected: Finished | None = None
    """Final scene of the best candidate, if no candidate passed."""


def settle_and_check(
    world: CompiledScene, placed: SceneSpec, o: RefineOptions, start: SceneSpec | None = None
) -> Finished:
    """Settle a placed scene in C MuJoCo, and return its final scene with its final check.

    If settling is disabled, the objects are snapped exactly onto their supports instead.

    Args:
        world: the compiled scene, of which `placed` is a candidate.
        placed: the placed scene.
        o: options of settling and of the check.
        start: the scene where its objects start to settle; by default, where they are placed.
    """
    if not o.settle.enabled:
        scene = snap_exactly(placed)
        _, (measure,) = rest_and_measure(world, world.poses(scene), o, settles=False)
        measure = measure.model_copy(update={"displacement": None})
        return Finished(scene, measure, passes(measure, o))
    finished = check_settled(world, placed, o, start)
    for _ in range(RELEASES):
        at_rest = finished.measure.model_copy(update={"displacement": None})
        if passes(at_rest, o) or finished.measure.diverged:
            break
        finished = check_settled(world, placed, o, _release_failing(world, finished, o))
    return finished


def check_settled(
    world: CompiledScene, placed: SceneSpec, o: RefineOptions, start: SceneSpec | None = None
) -> Finished:
    """Settle a placed scene once, and return it with its final check; see `settle_and_check`.

    Displacements by settling are relative to `placed`. An object that is farther from the composed
    scene than its estimate allows is displaced, too: a search finds places where objects rest, but
    not all of them are where the photograph, or a depth image, shows the objects.
    """
    begin = world.poses(placed if start is None else start)
    poses = settle(world, begin, NativeEngine(), o.settle, stop_early=False)
    scene = world.scene_at(poses, 0, placed)
    # From the scene as it is stored, so that a later check measures the same.
    _, (measure,) = rest_and_measure(
        world, world.poses(scene), o, settles=False, placed=world.poses(placed)
    )
    moved = dict(measure.displacement or {})
    for name, away in deviations_from(world.spec, scene, o.max_drift_m).items():
        moved[name] = max(moved[name], away / MAX_DEVIATIONS)
    measure = measure.model_copy(update={"displacement": moved})
    return Finished(scene, measure, passes(measure, o))


def deviations_from(estimate: SceneSpec, scene: SceneSpec, least_m: float) -> dict[str, float]:
    """Return the horizontal distances of movable objects from their estimated places.

    They are in standard deviations (Mahalanobis distances) by `physics.photo_view`, and concern the
    objects that were aligned with the photograph.

    Args:
        estimate: the composed scene.
        scene: a scene with the same objects.
        least_m: a further standard deviation in both directions [m], by which objects move in
            physics: where they touch, they push each other as far as their shapes are wrong.
    """
    axes, _ = photo_deviations(estimate)
    poses, found = world_poses(estimate), {}
    places, ends = (_middles(each) for each in (estimate, scene))
    for k, item in enumerate(estimate.objects):
        if item.uncertainty is None or item.static or item.parent is None:
            continue
        frame = support_frame(estimate.object(item.parent), poses[item.parent], item.parent_link)
        c, s = math.cos(yaw_of(frame.quat)), math.sin(yaw_of(frame.quat))
        shift = np.array([[c, s], [-s, c]]) @ (ends[item.name] - places[item.name])
        covariance = axes[k] @ axes[k].T + least_m**2 * np.eye(2)
        found[item.name] = math.sqrt(shift @ np.linalg.solve(covariance, shift))
    return found


def _middles(scene: SceneSpec) -> dict[str, Float[np.ndarray, " 2"]]:
    """Return the horizontal position of each object's center [m]."""
    poses, found = world_poses(scene), {}
    for item in scene.objects:
        low, high = bounds(item.spec, item.joint_state)
        found[item.name] = poses[item.name].apply(np.add(low, high)[None] / 2)[0, :2]
    return found


def _release_failing(world: CompiledScene, finished: Finished, o: RefineOptions) -> SceneSpec:
    """Move the failing objects of a final scene to where a free fall takes them."""
    free = o.settle.model_copy(update={"rate": 0.0, "duration_s": o.check_duration_s})
    start = world.poses(finished.scene)
    ends = settle(world, start, NativeEngine(), free, stop_early=False)
    return world.scene_at(ends, 0, finished.scene, only=~finished.rests(o))


def rank_candidates(rounds: list[Round]) -> list[tuple[int, int]]:
    """Return (iteration, candidate) of the candidates with a finite reward, best first.

    Valid candidates come before all others; among them, and among the others, the reward decides.
    """
    ranked = [
        (not round_.scores.valid[k], -float(round_.scores.reward[k]), t, k)
        for t, round_ in enumerate(rounds)
        for k in np.flatnonzero(np.isfinite(round_.scores.reward)).tolist()
    ]
    return [(t, k) for _, _, t, k in sorted(ranked)]


def choose_winner(
    world: CompiledScene,
    searched: SceneModel,
    rounds: list[Round],
    o: RefineOptions,
    initial: Finished,
) -> Winner:
    """Choose the first candidate in the order of `rank_candidates` that passes the final check.

    By default, the final check uses a smaller time step than a rollout and simulates longer. If
    none of the first `finalists` candidates passes, the initial layout wins; without settling, the
    first candidate, as in Algorithm 1.

    Args:
        world: the compiled scene, in which all objects are free.
        searched: the scene that was searched, in which some objects may be fixed.
        rounds: all iterations.
        o: options of the check.
        initial: the final scene of the initial layout.
    """
    ranked = rank_candidates(rounds)
    tries = min(o.finalists, len(ranked))
    unmoved = Winner(INITIAL, Layout.zero(1, len(world.names)), initial, tries)
    best, rejected = unmoved if o.settle.enabled or not ranked else None, None
    for tried, (t, k) in enumerate(ranked[:tries], 1):
        update(done=tried, of=tries, unit="final check", rate=None, left_s=None)
        finished = finish(world, searched, rounds[t], k, o)
        winner = Winner((t, k), rounds[t].layouts[k : k + 1], finished, tried)
        if finished.passed:
            return winner
        best, rejected = best or winner, rejected or finished
    assert best is not None
    return best._replace(tried=tries, rejected=rejected)


def hold_failing(composed: SceneSpec, finished: Finished, o: RefineOptions) -> Finished:
    """Hold the objects that do not rest where the photograph shows them, and settle the others.

    An object that lacks its support, because the response does not have it, would otherwise lie
    somewhere on the ground, and its neighbors with it. Of an object that fails and others that it
    carries, it alone is held at first, since they may rest on it then. An object is held together
    with the movable objects that support it.

    Args:
        composed: the placed scene.
        finished: its final scene, which does not pass the final check.
        o: options of settling and of the check.

    Returns:
        The final scene, which does not pass either if objects are held: `SceneObject.held`.
    """
    supports = {item.name: supports_of(composed, item) for item in composed.objects}
    held = set[str]()
    while True:
        rests = zip(finished.scene.objects, finished.rests(o), strict=True)
        failing = {item.name for item, at_rest in rests if not (at_rest or item.static)}
        if not failing:
            return finished
        first = {name for name in failing if not failing & supports[name]} or failing
        held |= first.union(*(supports[name] for name in first))
        objects = tuple(
            item.model_copy(update={"held": item.name in held and not item.static})
            for item in composed.objects
        )
        scene = composed.model_copy(update={"objects": objects})
        finished = settle_and_check(compile_for_simulation(scene), scene, o)


def supports_of(scene: SceneSpec, item: SceneObject) -> set[str]:
    """Return the names of the objects on which an object stands, directly or through others."""
    names = set[str]()
    while item.parent is not None:
        names.add(item.parent)
        item = scene.object(item.parent)
    return names


def finish(
    world: CompiledScene, searched: SceneModel, round_: Round, k: int, o: RefineOptions
) -> Finished:
    """Return the final scene of a candidate, with all its objects free, and its final check."""
    placed = searched.apply(round_.layouts, k, round_.poses)
    objects = [
        item.model_copy(update={"fixed_base": composed.fixed_base})
        for item, composed in zip(placed.objects, world.spec.objects, strict=True)
    ]
    placed = placed.model_copy(update={"objects": tuple(objects)})
    return settle_and_check(world, placed, o, world.scene_at(round_.poses, k, placed))
