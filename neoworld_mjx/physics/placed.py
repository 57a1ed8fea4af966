"""Placed candidates: their poses, how deep objects are in one another, and what the camera sees.

This is the dear part of what can be said of candidates before physics. It is one program of a
scene's bucket, whatever the population and the reward are.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from neoworld_kernels import pair_depth

from .layout import Layout, Poses, rotation
from .scene_arrays import SceneArrays
from .support import Either
from .visibility import Visible, visibility

CHUNK = 64
"""Candidates that are looked at at once on CPUs, where more at once gain nothing."""


class Placed(eqx.Module):
    """Candidates where their layouts put them."""

    poses: Poses
    depth: Float[Either, "pop object object"]
    """Of `pair_depths` [m]."""
    visible: Visible


def pair_depths(scene: SceneArrays, poses: Poses) -> Float[Array, "pop object object"]:
    """Measure the penetration depth [m] of i's surface samples in j's colliders, at [pop, i, j].

    Measured on the canonical colliders at the placed poses; zero between environment supports.
    """
    turn = rotation(poses.quat)
    depth = pair_depth(poses.pos, turn, poses.scale, scene.samples, scene.colliders)
    return jnp.where(scene.pair_mask, depth, 0.0)


@eqx.filter_jit
def placed(scene: SceneArrays, layouts: Layout) -> Placed:
    """Place candidates, and measure what does not depend on physics; may be vmapped."""
    poses = scene.place(layouts)
    return Placed(poses, pair_depths(scene, poses), visibility(scene, poses))


def placed_in_chunks(scene: SceneArrays, layouts: Layout, number: int | None = None) -> Placed:
    """Do what `placed` does in chunks of CHUNK, so that one program serves all populations.

    Args:
        scene: the scene's arrays.
        layouts: the candidates.
        number: so many of them are looked at, the first for the rest; all by default.

    Returns:
        Arrays on the host.
    """
    pop = layouts.yaw.shape[0]
    used = pop if number is None else number
    parts: list[Placed] = []
    for first in range(0, used, CHUNK):
        # The last chunk is filled up with its first candidate.
        rows = np.arange(first, first + CHUNK)
        rows = np.where(rows < used, rows, first)
        parts.append(placed(scene, jax.tree.map(lambda x, rows=rows: np.asarray(x)[rows], layouts)))
    rows = np.where(np.arange(pop) < used, np.arange(pop), 0)
    return jax.tree.map(lambda *x: np.concatenate(x)[rows], *jax.device_get(parts))
