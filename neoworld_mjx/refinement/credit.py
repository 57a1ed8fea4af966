"""Credit assignment by contact component: whose rewards choose an object's elites.

With many objects hardly any candidate is good everywhere, and elites of the whole scene say little
of any one object. An object's own terms say more; those of what it touches belong to them.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..config import CEMOptions
from ..physics.model import SceneModel
from ..spec import world_poses

REACH = 3.0
"""Standard deviations of position within which two objects may come to touch."""


def contact_components(
    scene: SceneModel, options: CEMOptions
) -> Float[np.ndarray, "object object"]:
    """Return which objects' terms count for which, as 0 and 1.

    `object`: itself, its support and what it supports. `island`: all objects connected to it by
    support, or by being so near that noise may make them touch. Environment supports connect
    nothing.
    """
    spec = scene.spec
    count = len(spec.objects)
    moves = np.asarray(scene.optimised)
    linked = np.eye(count, dtype=bool)
    for k, item in enumerate(spec.objects):
        if item.parent is not None:
            p = spec.index(item.parent)
            linked[k, p] = linked[p, k] = moves[k] and moves[p]
    if options.credit == "island":
        poses = world_poses(spec)
        at = np.array([poses[item.name].pos[:2] for item in spec.objects])
        half = np.asarray(scene.diagonal) / 2 * (1 + 2 * REACH * options.sigma_xy)
        apart = np.linalg.norm(at[:, None] - at, axis=-1)
        linked |= (apart < half[:, None] + half) & moves[:, None] & moves
        while True:
            wider = linked.astype(int) @ linked.astype(int) > 0
            if (wider == linked).all():
                break
            linked = wider
    return linked.astype(np.float32)


def assigned_credit(
    credit: Float[Array, "pop object"],
    reward: Float[Array, " pop"],
    components: Float[Array, "object object"],
    by_object: bool | Bool[Array, ""] = True,
) -> Float[Array, "pop object"]:
    """Sum each object's credit over its component; -inf for failed and pruned candidates.

    Args:
        credit: the reward by objects.
        reward: of the whole scene.
        components: of `contact_components`.
        by_object: False gives every object the reward of the scene, and so the scene's elites.
    """
    fine = jnp.all(jnp.isfinite(credit), axis=1, keepdims=True)
    own = jnp.where(fine, jnp.where(fine, credit, 0.0) @ components, -jnp.inf)
    return jnp.where(by_object, own, reward[:, None])
