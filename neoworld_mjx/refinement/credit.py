"""Credit assignment by contact component: selection of elites per object.

With many objects, few candidates are good for all of them, and a scene-wide reward carries little
information about any one object. Each object is ranked by the terms of its contact component.
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
"""Number of standard deviations of position within which two objects may touch."""


def contact_components(
    scene: SceneArrays, options: CEMOptions
) -> Float[np.ndarray, "object object"]:
    """Return a 0/1 matrix: entry [i, j] is 1 if the terms of object i count for object j.

    With credit `object`, these are the object, its support and the objects that it supports. With
    `island`, they are its connected component, in which objects are linked by support, or if they
    are close enough that sampling may make them touch. Environment supports link nothing.
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
        center = compose_poses(arrangement, composed, arrangement.z[None], np).pos[0, :, :2]
        half = np.asarray(scene.diagonal) / 2 * (1 + 2 * REACH * options.sigma_xy)
        distance = np.linalg.norm(center[:, None] - center, axis=-1)
        linked |= (distance < half[:, None] + half) & moves[:, None] & moves
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
        credit: per-object reward.
        reward: scene-wide reward.
        components: result of `contact_components`.
        by_object: if False, every object gets the scene-wide reward.
    """
    finite = jnp.all(jnp.isfinite(credit), axis=1, keepdims=True)
    summed = jnp.where(finite, jnp.where(finite, credit, 0.0) @ components, -jnp.inf)
    return jnp.where(by_object, summed, reward[:, None])
