"""The final scene of a layout, settled in C MuJoCo and checked; scenes compiled for a search."""

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from ..config import RefineOptions
from ..measure import (
    SETTLED_AWAY,
    SceneMeasure,
    measured,
    passes,
    rest_and_measure,
    resting,
    scene_checks,
)
from ..physics.colliders import snap_exactly
from ..physics.layout import Layout, Poses
from ..physics.model import CompiledScene, SceneModel, compile_for_simulation, compile_scene
from ..physics.native import NativeEngine
from ..physics.rest import settle
from ..spec import SceneSpec

RELEASES = 2
"""Number of times that a scene which fails its final check is settled again.

Each time, the failing objects start where a free fall takes them. A potato that settled on an
unstable side can thus roll onto a stable one.
"""


class Finished(NamedTuple):
    """Final scene of a layout, with its final check."""

    scene: SceneSpec
    measure: SceneMeasure
    passed: bool
    """True if the scene passes the final check, which includes that no object moved away."""

    def rests(self, o: RefineOptions) -> Bool[np.ndarray, " object"]:
        """Return a mask of the objects that rest; see `measure.resting`."""
        return resting(self.scene, self.measure, o)

    @property
    def moved_away(self) -> tuple[str, ...]:
        """Objects that settled farther from their placed poses than is allowed."""
        displacement = self.measure.displacement or {}
        return tuple(name for name, value in displacement.items() if value > 1.0)

    def excess_over_bounds(self, o: RefineOptions) -> float:
        """Return how far the scene is from passing; 0 if it passes.

        The result is a sum. Every failed check adds 0.1 and the excess of the measure over its
        bound, relative to the bound, but at most 10. Every object that moved away adds 1.
        """
        excesses = [
            c.value / c.threshold - 1
            for c in scene_checks(self.measure, o)
            if not c.passed and c.name != SETTLED_AWAY
        ]
        return sum(min(max(excess, 0.0) + 0.1, 10.0) for excess in excesses) + len(self.moved_away)


def finish(
    model: SceneModel,
    layouts: Layout,
    k: int,
    o: RefineOptions,
    rest: Poses | None = None,
    searched: SceneModel | None = None,
) -> Finished:
    """Return the final scene of a candidate, with its final check.

    The candidate is settled in C MuJoCo. If settling is disabled, its objects are snapped exactly
    onto their supports instead.

    Args:
        model: the compiled scene.
        layouts: the candidates, padded or not.
        k: index of the candidate.
        o: options of settling and of the check.
        rest: settled poses of the candidates, from which settling in C MuJoCo starts. If None, it
            starts from the placed poses.
        searched: the scene that was searched, in which some objects may be fixed. If None, it is
            `model`.
    """
    placed = (searched or model).apply(layouts, k, rest)
    placed = placed.model_copy(
        update={
            "objects": tuple(
                item.model_copy(update={"fixed_base": composed.fixed_base})
                for item, composed in zip(placed.objects, model.spec.objects, strict=True)
            )
        }
    )
    if not o.settle.enabled:
        scene = snap_exactly(placed)
        measure = measured(scene, o)
        return Finished(scene, measure, passes(measure, o))
    start = placed if rest is None else model.scene_at(rest, k, placed)
    return settle_and_check(placed, o, start)


def settle_and_check(
    placed: SceneSpec, o: RefineOptions, start: SceneSpec | None = None
) -> Finished:
    """Settle a placed scene in C MuJoCo, and return its final scene with its final check.

    Args:
        placed: the placed scene, which is compiled once.
        o: options of settling and of the check.
        start: the scene where its objects start to settle; by default, where they are placed.
    """
    world = compile_for_simulation(placed)
    finished = check_settled(world, placed if start is None else start, o)
    for _ in range(RELEASES):
        at_rest = finished.measure.model_copy(update={"displacement": None})
        if passes(at_rest, o) or finished.measure.diverged:
            break
        finished = check_settled(world, _release_failing(world, finished, o), o)
    return finished


def check_settled(world: CompiledScene, start: SceneSpec, o: RefineOptions) -> Finished:
    """Settle a scene, and return it with its final check.

    Args:
        world: the compiled scene, placed; displacements by settling are relative to it.
        start: the same objects where they start to settle.
        o: options of settling and of the check.
    """
    poses = settle(world, world.poses(start), NativeEngine(), o.settle, stop_early=False)
    scene = world.scene_at(poses)
    # From the scene as it is stored, so that a later check measures the same.
    _, (measure,) = rest_and_measure(
        world, world.poses(scene), o, settles=False, placed=world.poses()
    )
    return Finished(scene, measure, passes(measure, o))


def _release_failing(world: CompiledScene, finished: Finished, o: RefineOptions) -> SceneSpec:
    """Move the failing objects of a final scene to where a free fall takes them."""
    free = o.settle.model_copy(update={"rate": 0.0, "duration_s": o.check_duration_s})
    start = world.poses(finished.scene)
    ends = settle(world, start, NativeEngine(), free, stop_early=False)
    return world.scene_at(ends, 0, finished.scene, only=~finished.rests(o))


def free_to_move(
    scene: SceneSpec, rests: Bool[np.ndarray, " object"]
) -> Bool[np.ndarray, " object"]:
    """Return a mask of the objects that are free to move in a search.

    An object is free if it does not rest, or if it is supported by a free object.
    """
    free: set[str] = set()
    for item, at_rest in zip(scene.objects, rests, strict=True):  # parents come first
        if not item.static and (not at_rest or item.parent in free):
            free.add(item.name)
    return np.array([item.name in free for item in scene.objects])


def with_resting_fixed(composed: SceneSpec, initial: Finished, o: RefineOptions) -> SceneSpec:
    """Return a composed scene in which all objects that are not `free_to_move` are fixed.

    Fixed objects have the poses at which they settled; free objects keep their composed poses. The
    fewer objects move, the faster is a search.
    """
    free = free_to_move(composed, initial.rests(o))
    objects = [
        item if is_free else end.model_copy(update={"fixed_base": not item.environment})
        for item, end, is_free in zip(composed.objects, initial.scene.objects, free, strict=True)
    ]
    return composed.model_copy(update={"objects": tuple(objects)})


LEAST_REACH, REACH_IN_SIGMAS = 0.335, 6.7
"""Smallest reach, which fits the default `sigma_xy`, and the ratio of the reach to `sigma_xy`."""


def reach_of(options: RefineOptions) -> float:
    """Return the reach: how far from its composed position an object is still snapped.

    The reach is a fraction of the object's horizontal diagonal; `layout.arrange` adds 2 cm. It is
    LEAST_REACH times a power of two, so that many values of `sigma_xy` share one compiled scene.
    """
    reach = LEAST_REACH
    while reach < 0.999 * REACH_IN_SIGMAS * options.cem.sigma_xy:
        reach *= 2
    return reach


def compile_for_search(scene: SceneSpec, options: RefineOptions) -> SceneModel:
    """Compile a scene for a search with these options; the last four compiled scenes are cached."""
    r = options.rollout
    return _compiled(scene.to_json(), r.timestep_s, r.samples_per_object, reach_of(options))


@functools.lru_cache(maxsize=4)
def _compiled(scene: str, timestep: float, samples: int, reach: float) -> SceneModel:
    # JAX recompiles functions of a SceneModel, such as those of MJX, for every new SceneModel, even
    # if it equals an earlier one.
    spec = SceneSpec.model_validate_json(scene)
    return compile_scene(spec, timestep=timestep, samples=samples, reach=reach)
