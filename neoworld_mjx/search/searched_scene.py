"""The compiled scene that is searched: objects that rest are fixed, so that rollouts are faster."""

import functools
import math

import numpy as np
from jaxtyping import Bool

from ..config import RefineOptions
from ..physics.model import SceneModel, compile_scene
from ..spec import SceneSpec
from .cem import PAPER
from .finishing import Finished

LEAST_REACH = 0.335
"""Reach for the default `sigma_xy`: how far from its composed position an object is still snapped,
as a fraction of its horizontal diagonal. `layout.arrange` adds 2 cm."""


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


def reach_of(options: RefineOptions) -> float:
    """Return LEAST_REACH, doubled until it fits `sigma_xy`, so that many values share a scene."""
    wider = (options.cem.sigma_xy or 0.0) / PAPER[0]
    return LEAST_REACH * 2 ** math.ceil(math.log2(max(wider, 1.0)))


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

    Fixed objects have the poses at which they settled; free objects keep their composed poses.
    """
    free = free_to_move(composed, initial.rests(o))
    objects = [
        item if is_free else end.model_copy(update={"fixed_base": not item.environment})
        for item, end, is_free in zip(composed.objects, initial.scene.objects, free, strict=True)
    ]
    return composed.model_copy(update={"objects": tuple(objects)})
