"""Quantities for reward terms of one's own: clearances of objects and their speeds."""

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

    Surface samples are compared with convex pieces. Beside the edge of a polytope the distance is
    at most the true one. It is inf between environment supports and on the diagonal. Traceable and
    differentiable.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        rollout: their rollout, at whose start they are measured; None measures them as placed.
    """
    return pair_gaps(scene, scene.place(layouts) if rollout is None else rollout.start)


def speeds(
    rollout: Rollout,
) -> tuple[Float[Array, "pop time object"], Float[Array, "pop time object"]]:
    """Return the mean speed [m/s] and rate of rotation [rad/s] of each object between two records.

    The first interval begins at the start of the rollout. Engines record poses alone, every
    `refine.rollout.record_every_s`, and a rollout that stopped early repeats its last pose: for
    peaks, record often and set `refine.rollout.early_stop: false`. Traceable.
    """
    start: Any = rollout.start
    pos = jnp.concatenate([start.pos[:, None], rollout.pos], axis=1)
    quat = jnp.concatenate([start.quat[:, None], rollout.quat], axis=1)
    time = jnp.diff(jnp.concatenate([jnp.zeros(1), rollout.time]))[:, None]
    moved = length(jnp.diff(pos, axis=1), jnp)
    return moved / time, angle_between(quat[:, :-1], quat[:, 1:], jnp) / time
