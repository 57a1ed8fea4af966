"""Placed candidates: their poses, how deep objects are in one another, and what the camera sees.

This is the dear part of what can be said of candidates before physics. It is two programs of a
scene's bucket, whatever the population and the reward are, and wherever the candidates' poses come
from: one that places layouts, and one that looks at poses.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from neoworld_kernels import pair_depth

from ..traces import kept
from .array_types import AnyArray
from .layout import Layout, Poses, rotation
from .scene_arrays import SceneArrays
from .visibility import Visible, as_parsed, unhidden, visibility

CPU_CHUNK = 16
"""Candidates that are looked at at once on CPUs, where more at once gain nothing, and a single one
costs as much as all."""
Out = TypeVar("Out")


class Placed(eqx.Module):
    """Candidates where their layouts put them."""

    poses: Poses
    depth: Float[AnyArray, "pop object object"]
    """Of `pair_depths` [m]."""
    visible: Visible
    settled: Float[AnyArray, "pop object"]
    """How far each object has come to rest from where its layout put it, in units of the bounds of
    `settled_by`; 0 where nothing settled."""


BALL_EXTENT = 0.03
"""Difference of a ball's extents, over the largest."""
UP, SIDEWAYS, DOWN = float(np.radians(15.0)), 0.25, (0.1, 0.01)
"""Bounds of settling: of the tilt [rad]; of the horizontal shift, over the object's size; of the
change of height, over its size, and beyond that [m]."""
LEAST_SIZE_M = 1e-6
"""Least size of an object [m]."""


def pair_depths(scene: SceneArrays, poses: Poses) -> Float[Array, "pop object object"]:
    """Measure the penetration depth [m] of i's surface samples in j's colliders, at [pop, i, j].

    Measured on the canonical colliders at the placed poses; zero between environment supports.
    """
    turn = rotation(poses.quat)
    pos, scale, samples = map(jnp.asarray, (poses.pos, poses.scale, scene.samples))
    depth = pair_depth(pos, turn, scale, samples, scene.colliders)
    return jnp.where(scene.pair_mask, depth, 0.0)


@eqx.filter_jit
def placed_poses(scene: SceneArrays, layouts: Layout) -> Poses:
    """Place candidates; may be vmapped."""
    return scene.place(layouts)


@eqx.filter_jit
def _look(scene: SceneArrays, poses: Poses) -> tuple[Float[Array, "pop object object"], Visible]:
    return pair_depths(scene, poses), visibility(scene, poses)


def looked_at(
    scene: SceneArrays, poses: Poses
) -> tuple[Float[AnyArray, "pop object object"], Visible]:
    """Measure depths and what the camera sees of candidates; may be vmapped."""
    return _kept_look(scene, poses)


_kept_look = kept(_look, lambda scene, poses: (poses.scale, as_parsed(scene.photo, 1)))


def placed(scene: SceneArrays, layouts: Layout) -> Placed:
    """Place candidates, and measure what does not depend on physics; may be vmapped."""
    poses = placed_poses(scene, layouts)
    return Placed(poses, *looked_at(scene, poses), jnp.zeros(layouts.yaw.shape))


@eqx.filter_jit
def guessed(scene: SceneArrays, poses: Poses) -> Placed:
    """Measure candidates as if nothing overlapped or hid anything; may be vmapped.

    It costs a hundredth of `looked_at`, and tells well enough which candidates are worth to come to
    rest before they are looked at.
    """
    count = poses.scale.shape[1]
    return Placed(
        poses,
        jnp.zeros((*poses.scale.shape, count)),
        unhidden(scene, poses),
        jnp.zeros(poses.scale.shape),
    )


def come_to_rest(scene: SceneArrays, start: Poses, end: Poses) -> Placed:
    """Measure candidates where they have come to rest; may be vmapped.

    Args:
        scene: the scene's arrays.
        start: where their layouts put them.
        end: where they rest; see `settling.settle`.
    """
    return Placed(end, *looked_at(scene, end), settled_by(scene, start, end))


def settled_by(
    scene: SceneArrays, start: Poses, end: Poses, xp: Any = jnp
) -> Float[AnyArray, "pop object"]:
    """Return how far objects have settled, in units of UP, SIDEWAYS and DOWN; 1 is at a bound.

    Beyond it an object lies where the photograph does not show it: it has toppled or fallen off. A
    ball has no tilt.

    Args:
        scene: the scene's arrays.
        start: where the candidates' objects were placed.
        end: where they rest.
        xp: `numpy` on the host.
    """
    corners = xp.asarray(scene.corners)
    box = xp.max(corners, axis=1) - xp.min(corners, axis=1)
    # What is padded has no size.
    size = xp.maximum(xp.linalg.norm(box, axis=-1) * start.scale, LEAST_SIZE_M)
    ball = xp.asarray(scene.round) & (xp.ptp(box, axis=-1) < BALL_EXTENT * xp.max(box, axis=-1))
    up, now = (_own_up(quat, xp) for quat in (start.quat, end.quat))
    leans = xp.arctan2(xp.linalg.norm(xp.cross(up, now), axis=-1), xp.sum(up * now, axis=-1))
    tilt = xp.where(ball, 0.0, leans)
    way = end.pos - start.pos
    sideways = xp.linalg.norm(way[..., :2], axis=-1) / (SIDEWAYS * size)
    upright = xp.abs(way[..., 2]) / (DOWN[0] * size + DOWN[1])
    most = xp.maximum(tilt / UP, xp.maximum(sideways, upright))
    return xp.where(xp.asarray(scene.movable), most, 0.0)


def _own_up(quat: Any, xp: Any) -> Any:
    """Return where each object's z axis points."""
    w, x, y, z = xp.moveaxis(quat, -1, 0)
    return xp.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)


def poses_in_chunks(scene: SceneArrays, layouts: Layout, number: int | None = None) -> Poses:
    """Place candidates in chunks; see `placed_in_chunks`."""
    return _in_chunks(placed_poses, scene, layouts, number)


def placed_in_chunks(scene: SceneArrays, layouts: Layout, number: int | None = None) -> Placed:
    """Do what `placed` does in chunks of CPU_CHUNK, so that one program serves all populations.

    Args:
        scene: the scene's arrays.
        layouts: the candidates.
        number: so many of them are looked at, the first for the rest; all by default.

    Returns:
        Arrays on the host.
    """
    poses = poses_in_chunks(scene, layouts, number)
    still = np.zeros(poses.scale.shape, np.float32)
    return Placed(poses, *_in_chunks(looked_at, scene, poses, number), still)


def guessed_in_chunks(scene: SceneArrays, layouts: Layout, number: int) -> Placed:
    """Place candidates and do what `guessed` does in chunks; see `placed_in_chunks`."""
    return _in_chunks(guessed, scene, poses_in_chunks(scene, layouts, number), number)


def at_rest_in_chunks(scene: SceneArrays, start: Poses, end: Poses) -> Placed:
    """Do what `come_to_rest` does in chunks; see `placed_in_chunks`."""
    settled = settled_by(scene, start, end, np).astype(np.float32)
    return Placed(end, *_in_chunks(looked_at, scene, end, None), settled)


def _in_chunks(
    look: Callable[[SceneArrays, Any], Out], scene: SceneArrays, of: Any, number: int | None
) -> Out:
    pop = jax.tree.leaves(of)[0].shape[0]
    used = pop if number is None else number
    parts: list[Out] = []
    for first in range(0, used, CPU_CHUNK):
        # The last chunk is filled up with its first candidate.
        rows = np.arange(first, first + CPU_CHUNK)
        rows = np.where(rows < used, rows, first)
        parts.append(look(scene, jax.tree.map(lambda x, rows=rows: np.asarray(x)[rows], of)))
    rows = np.where(np.arange(pop) < used, np.arange(pop), 0)
    return jax.tree.map(lambda *x: np.concatenate(x)[rows], *jax.device_get(parts))
