"""Quantities for user-defined reward terms: distances between objects, and speeds of objects."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..physics.engine import Rollout
from ..physics.layout import Layout
from ..physics.placed import pair_gaps
from ..physics.scene_arrays import SceneArrays
from ..spec.pose import angle_between, length


def gaps(
    scene: SceneArrays, layouts: Layout, rollout: Rollout | None = None
) -> Float[Array, "pop object object"]:
    """Return the signed distance [m] of each pair of objects, negative where they penetrate.

    The distance is measured from surface samples of one object to the convex pieces of the other.
    Outside an edge of a convex polytope, it is at most the true distance. It is inf between
    environment supports and on the diagonal. This function can be jitted and differentiated.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        rollout: rollout of the candidates. Distances are measured at its start, or at the placed
            poses if it is None.
    """
    return pair_gaps(scene, scene.place(layouts) if rollout is None else rollout.start)


def speeds(
    rollout: Rollout,
) -> tuple[Float[Array, "pop time object"], Float[Array, "pop time object"]]:
    """Return each object's mean speed [m/s] and angular speed [rad/s] between successive records.

    The first interval begins at the start of the rollout. Engines record only poses, every
    `refine.rollout.record_every_s`, and a rollout that stopped early repeats its last pose. To
    measure peak speeds, record often and set `refine.rollout.early_stop: false`. This function can
    be jitted.
    """
    start: Any = rollout.start
    pos = jnp.concatenate([start.pos[:, None], rollout.pos], axis=1)
    quat = jnp.concatenate([start.quat[:, None], rollout.quat], axis=1)
    time = jnp.diff(jnp.concatenate([jnp.zeros(1), rollout.time]))[:, None]
    moved = length(jnp.diff(pos, axis=1), jnp)
    return moved / time, angle_between(quat[:, :-1], quat[:, 1:], jnp) / time
