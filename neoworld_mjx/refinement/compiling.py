"""Compilation of scenes for a search."""

import functools

from ..config import RefineOptions
from ..physics.model import SceneModel, compile_scene
from ..spec import SceneSpec

LEAST_REACH, REACH_IN_SIGMAS = 0.335, 6.7
"""Smallest reach, which fits the default `sigma_xy`, and the ratio of the reach to `sigma_xy`."""


def reach_of(options: RefineOptions) -> float:
    """Return the reach: how far from its composed position an object is still snapped.

    The reach is a fraction of the object's horizontal diagonal; `layout.arrange` adds 2 cm. It is
    LEAST_REACH times a power of two, so that many values of `sigma_xy` share one compiled scene,
    independent of the other values in a sweep.
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
