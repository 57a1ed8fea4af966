"""Compilation of scenes for a search."""

import functools

from ..config import RefineOptions
from ..physics.model import SceneModel, compile_scene
from ..spec import SceneSpec


def compile_for_search(scene: SceneSpec, options: RefineOptions) -> SceneModel:
    """Compile a scene for a search with these options; the last four results are cached."""
    reach = max(1 / 3, 6.7 * options.cem.sigma_xy)
    r = options.rollout
    return _compiled(scene.to_json(), r.timestep_s, r.samples_per_object, reach)


@functools.lru_cache(maxsize=4)
def _compiled(scene: str, timestep: float, samples: int, reach: float) -> SceneModel:
    # JAX compiles again for another SceneModel, even if it is equal.
    spec = SceneSpec.model_validate_json(scene)
    return compile_scene(spec, timestep=timestep, samples=samples, reach=reach)
