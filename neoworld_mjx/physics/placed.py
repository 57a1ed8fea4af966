"""Placed candidates: poses, penetration depths and visibility.

This is the expensive part of scoring before physics. For each bucket of scenes, two functions are
compiled that serve any population and reward. One places layouts, the other measures poses.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from neoworld_kernels import pair_depth, pair_gap

from ..cache import computes_on_cpu
from ..spec.pose import length
from .array_types import AnyArray
from .layout import Layout, Poses, rotation
from .model import StaticScene
from .scene_arrays import SceneArrays
from .sharding import over_devices
from .visibility import Visible, visibility

CPU_CHUNK = 16
"""Number of candidates measured at once on CPUs, where a single candidate costs as much as such a
chunk, and larger chunks are no faster."""
Out = TypeVar("Out")


class Placed(eqx.Module):
    """Placed candidates and their measures before physics."""

    poses: Poses
    depth: Float[AnyArray, "pop object object"]
    """Penetration depths [m]; see `pair_depths`."""
    visible: Visible
    settled: Float[AnyArray, "pop object"]
    """Displacement of each object by settling, from `settling_displacement`; 0 without settling."""


BALL_EXTENT = 0.03
"""Largest relative difference between the extents of a ball."""
TILT_BOUND_UPRIGHT, TILT_BOUND_LYING = float(np.radians(15.0)), float(np.radians(45.0))
"""Bounds of the change of tilt by settling [rad]. TILT_BOUND_UPRIGHT applies to objects placed
upright. TILT_BOUND_LYING applies to objects placed tilted, which lie or lean, and to objects that
roll."""
UPRIGHT_COSINE = float(np.cos(np.radians(2.0)))
ROLLING_ASPECT = 0.8
"""Least ratio between the smallest and the largest extent of an object that rolls."""
HORIZONTAL, VERTICAL = 0.25, (0.1, 0.01)
"""Bounds of the shift of an object's center by settling: HORIZONTAL * size horizontally, and
VERTICAL[0] * size + VERTICAL[1] vertically [m]."""
SMALL_M = 0.05
"""Size below which the tilt of an object is ignored, since the object may settle in another
orientation than the one in the response [m]."""
LEAST_SIZE_M = 1e-6
"""Least size of an object [m]."""


def pair_depths(scene: SceneArrays, poses: Poses) -> Float[Array, "pop object object"]:
    """Return the penetration depth [m] of i's surface samples in j's colliders, at [pop, i, j].

    Depths are measured in the canonical colliders. They are zero between environment supports.
    """
    turn = jnp.asarray(rotation(poses.quat))
    pos, scale, samples = map(jnp.asarray, (poses.pos, poses.scale, scene.samples))
    depth = pair_depth(pos, turn, scale, samples, scene.colliders)
    return jnp.where(scene.pair_mask, depth, 0.0)


def pair_gaps(scene: SceneArrays, poses: Poses) -> Float[Array, "pop object object"]:
    """Return the signed distance of each pair of objects [m], negative if they penetrate.

    The distance of objects i and j is the smaller of the distances of `neoworld_kernels.pair_gap`
    at (i, j) and (j, i). It is inf between environment supports and on the diagonal.
    """
    turn = jnp.asarray(rotation(poses.quat))
    pos, scale, samples = map(jnp.asarray, (poses.pos, poses.scale, scene.samples))
    gap = pair_gap(pos, turn, scale, samples, scene.colliders)
    gap = jnp.where(scene.pair_mask, gap, jnp.inf)
    return jnp.minimum(gap, jnp.swapaxes(gap, 1, 2))


@eqx.filter_jit
def _measure(scene: SceneArrays, poses: Poses) -> tuple[Float[Array, "pop object object"], Visible]:
    return pair_depths(scene, poses), visibility(scene, poses)


def measure_poses(
    scene: SceneArrays, poses: Poses
) -> tuple[Float[AnyArray, "pop object object"], Visible]:
    """Measure the penetration and visibility of candidates. May be vmapped."""
    return _measure(scene.arrays, poses)


def measure_settled(scene: SceneArrays, start: Poses, end: Poses) -> Placed:
    """Measure settled candidates. May be vmapped."""
    return Placed(end, *measure_poses(scene, end), settling_displacement(scene, start, end))


def settling_displacement(
    scene: SceneArrays | StaticScene, start: Poses, end: Poses, xp: Any = jnp
) -> Float[AnyArray, "pop object"]:
    """Return the displacement of objects by settling, relative to its bounds.

    An object with a value above 1 is no longer where the photograph shows it: it has toppled or
    fallen off. The tilt of balls and of objects smaller than SMALL_M is ignored.
    """
    corners = xp.asarray(scene.corners)
    box = xp.max(corners, axis=1) - xp.min(corners, axis=1)
    center = xp.mean(corners, axis=1)
    # Padded objects have size zero.
    size = xp.maximum(xp.linalg.norm(box, axis=-1) * start.scale, LEAST_SIZE_M)
    ball = xp.asarray(scene.round) & (xp.ptp(box, axis=-1) < BALL_EXTENT * xp.max(box, axis=-1))
    before, after = (_z_axes(quat, xp) for quat in (start.quat, end.quat))
    sine = length(xp.cross(before, after), xp)
    tilt = xp.arctan2(sine, xp.sum(before * after, axis=-1))
    tilt = xp.where(ball | (size < SMALL_M), 0.0, tilt)
    start_center, end_center = (
        poses.pos
        + poses.scale[..., None] * xp.sum(rotation(poses.quat, xp) * center[:, None, :], axis=-1)
        for poses in (start, end)
    )
    shift = end_center - start_center
    horizontal = length(shift[..., :2], xp) / (HORIZONTAL * size)
    vertical = xp.abs(shift[..., 2]) / (VERTICAL[0] * size + VERTICAL[1])
    rolls = xp.min(box, axis=-1) > ROLLING_ASPECT * xp.max(box, axis=-1)
    bound = xp.where(
        (before[..., 2] > UPRIGHT_COSINE) & ~rolls, TILT_BOUND_UPRIGHT, TILT_BOUND_LYING
    )
    largest = xp.maximum(tilt / bound, xp.maximum(horizontal, vertical))
    return xp.where(xp.asarray(scene.movable), largest, 0.0)


def _z_axes(quat: Any, xp: Any) -> Any:
    """Return the direction of each object's z axis."""
    w, x, y, z = xp.moveaxis(quat, -1, 0)
    return xp.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)


def place_in_chunks(scene: SceneArrays, layouts: Layout) -> Poses:
    """Place candidates in chunks of CPU_CHUNK, so that all populations share a compiled function.

    Accelerators place all candidates at once, sharded over the devices.

    Returns:
        Poses, on the host.
    """
    return _in_chunks(SceneArrays.place, scene, layouts)


def measure_in_chunks(scene: SceneArrays, start: Poses, end: Poses) -> Placed:
    """Compute `measure_settled` in chunks; see `place_in_chunks`."""
    settled = settling_displacement(scene, start, end, np).astype(np.float32)
    return Placed(end, *_in_chunks(measure_poses, scene, end), settled)


def _in_chunks(
    measure: Callable[[SceneArrays, Any], Out],
    scene: SceneArrays,
    candidates: Any,
) -> Out:
    if not computes_on_cpu():
        return jax.device_get(measure(scene, over_devices(candidates)))
    pop = jax.tree.leaves(candidates)[0].shape[0]
    parts: list[Out] = []
    for first in range(0, pop, CPU_CHUNK):
        # The last chunk is padded with copies of its first candidate.
        rows = np.arange(first, first + CPU_CHUNK)
        rows = np.where(rows < pop, rows, first)
        chunk = jax.tree.map(lambda x, rows=rows: np.asarray(x)[rows], candidates)
        parts.append(measure(scene, chunk))
    return jax.tree.map(lambda *x: np.concatenate(x)[:pop], *jax.device_get(parts))
