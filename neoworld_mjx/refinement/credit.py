"""Credit assignment by contact component: whose rewards choose an object's elites.

With many objects hardly any candidate is good everywhere, and elites of the whole scene say little
of any one object. An object's own terms say more; those of what it touches belong to them.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..config import CEMOptions
from ..physics.array_types import AnyArray
from ..physics.layout import Layout, compose_poses
from ..physics.scene_arrays import SceneArrays

REACH = 3.0
"""Standard deviations of position within which two objects may come to touch."""


def contact_components(
    scene: SceneArrays, options: CEMOptions
) -> Float[np.ndarray, "object object"]:
    """Return which objects' terms count for which, as 0 and 1.

    `object`: itself, its support and what it supports. `island`: all objects connected to it by
    support, or by being so near that noise may make them touch. Environment supports connect
    nothing.
    """
    moves = np.asarray(scene.optimised)
    arrangement = jax.tree.map(np.asarray, scene.arrangement)
    parent = arrangement.parent
    linked = np.eye(scene.count, dtype=bool)
    child = np.flatnonzero(parent >= 0)
    linked[child, parent[child]] = moves[child] & moves[parent[child]]
    linked |= linked.T
    if options.credit == "island":
        composed = jax.tree.map(np.asarray, Layout.zero(1, scene.count))
        at = compose_poses(arrangement, composed, arrangement.z[None], np).pos[0, :, :2]
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
    credit: Float[AnyArray, "pop object"],
    reward: Float[AnyArray, " pop"],
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
