"""Layouts: the four numbers an object that CEM moves, and the poses they lead to."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import pose, quat_mul, yaw_of
from .support import NOTHING, Support, height_above, link_frame, nothing, support

Either = Any
"""JAX arrays, or NumPy arrays in double precision on the host."""


SNAPPED = 8192
"""Objects of all candidates that are snapped at once; each takes about 30 KB meanwhile."""


class Layout(eqx.Module):
    """Perturbations z = (dx, dy, dyaw, log s) of a composed scene (paper Section 3.3).

    Zero is the composed scene. Applied in the order scale, yaw, translation, in parent frames.
    """

    xy: Float[Either, "pop object 2"]
    """Offset in the parent's frame [m]."""
    yaw: Float[Either, "pop object"]
    """Offset of the yaw [rad]."""
    log_scale: Float[Either, "pop object"]
    """Log of the isotropic scale factor."""

    @classmethod
    def zero(cls, pop: int, objects: int) -> "Layout":
        """Return `pop` copies of the composed scene."""
        flat = jnp.zeros((pop, objects))
        return cls(jnp.zeros((pop, objects, 2)), flat, flat)

    def __getitem__(self, index: object) -> "Layout":
        """Take candidates along the leading axis."""
        return jax.tree.map(lambda leaf: leaf[index], self)


class Poses(eqx.Module):
    """World poses of all objects of the candidates, by `SceneModel.place`."""

    pos: Float[Either, "pop object 3"]
    """Origins [m]."""
    quat: Float[Either, "pop object 4"]
    """Rotations, tilt included, w first."""
    scale: Float[Either, "pop object"]
    """Isotropic scale factors."""
    height: Float[Either, "pop object"]
    """Snapped height above the support frame's origin [m]; the `z` of a SceneObject."""

    def __getitem__(self, index: object) -> "Poses":
        """Take candidates along the leading axis."""
        return jax.tree.map(lambda leaf: leaf[index], self)


class Arrangement(NamedTuple):
    """What the placement of objects depends on, by object; see SceneObject.

    StaticScene arrays are float64, so that engines in double precision get exact poses.
    """

    xy: Float[np.ndarray, "object 2"]
    z: Float[np.ndarray, " object"]
    yaw: Float[np.ndarray, " object"]
    tilt: Float[np.ndarray, "object 4"]
    frame_pos: Float[np.ndarray, "object 3"]
    """Origin of the object's support frame in its parent's yaw frame, at the parent's size 1."""
    frame_yaw: Float[np.ndarray, " object"]
    parent: tuple[int, ...]
    """Index of the parent; -1 for the world. Parents come before their children."""
    snapped: tuple[bool, ...]
    support: Support
    """Stacked over objects, on the device."""
    gap: float
    """Clearance left under a snapped object [m]."""


def arrange(scene: SceneSpec, *, reach: float = 1 / 3, gap: float = 1e-4) -> Arrangement:
    """Tabulate a composed scene for `place`.

    Args:
        scene: the composed scene.
        reach: how far objects may move from their composed place and still be snapped, as a
            fraction of their horizontal diagonal, plus 2 cm; a third is six default standard
            deviations.
        gap: clearance under snapped objects [m].
    """
    frames = []
    for item in scene.objects:
        parent = None if item.parent is None else scene.object(item.parent)
        frames.append(pose() if parent is None else link_frame(parent, item.parent_link))
    snapped = tuple(
        o.parent is not None and o.relation != "attached" and not o.environment
        for o in scene.objects
    )
    tables = []
    for item, snap in zip(scene.objects, snapped, strict=True):
        tables.append(support(scene, item, reach * diagonal(item) + 0.02) if snap else nothing())
    return Arrangement(
        xy=np.array([item.xy for item in scene.objects], float),
        z=np.array([item.z for item in scene.objects], float),
        yaw=np.array([item.yaw for item in scene.objects], float),
        tilt=np.array([item.base_tilt for item in scene.objects], float),
        frame_pos=np.array([frame.pos for frame in frames]),
        frame_yaw=np.array([yaw_of(frame.quat) for frame in frames]),
        parent=tuple(-1 if o.parent is None else scene.index(o.parent) for o in scene.objects),
        snapped=snapped,
        support=jax.tree.map(lambda *rows: jnp.stack(rows), *tables),
        gap=gap,
    )


def diagonal(item: SceneObject) -> float:
    """Return an object's horizontal bounding-box diagonal [m], as it stands."""
    low, high = bounds(item.spec, item.joint_state, item.base_tilt)
    return float(np.hypot(*(high - low)[:2]))


def place(arrangement: Arrangement, layouts: Layout) -> Poses:
    """Place every object of every candidate, heights re-snapped. Traceable and differentiable.

    A child's offset in its parent's frame grows with the parent, its size does not. Where no part
    of an object is above its support any more it keeps its composed height: it will fall.

    Args:
        arrangement: the composed scene.
        layouts: the candidates.
    """
    return compose_poses(arrangement, layouts, heights(arrangement, layouts))


def heights(arrangement: Arrangement, layouts: Layout) -> Float[Array, "pop object"]:
    """Snap: the height [m] of every object's origin above its support frame."""
    a = arrangement
    size = jnp.exp(layouts.log_scale)
    parent = np.array(a.parent)
    carrier = jnp.where(parent >= 0, size[:, np.maximum(parent, 0)], 1.0)
    xy = (jnp.asarray(a.xy, jnp.float32) + layouts.xy) * carrier[..., None]
    yaw = jnp.asarray(a.yaw, jnp.float32) + layouts.yaw
    over_objects = jax.vmap(height_above, in_axes=(0, 0, 0, 0, 0))
    touch = _map_candidates(
        lambda *candidate: over_objects(a.support, *candidate), xy, yaw, size, carrier
    )
    snapped = np.array(a.snapped) & (touch > NOTHING / 2)
    return jnp.where(snapped, touch + a.gap, jnp.asarray(a.z, jnp.float32) * carrier)


def _map_candidates(one: Callable[..., Any], *candidates: Any) -> Any:
    """Map a function over candidates [pop, object, ...], `SNAPPED` objects at once."""
    pop, objects = candidates[0].shape[:2]
    rows = max(1, SNAPPED // objects)
    if pop <= rows:
        return jax.vmap(one)(*candidates)
    return jax.lax.map(lambda row: one(*row), candidates, batch_size=rows)


def compose_poses(
    arrangement: Arrangement, layouts: Layout, height: Float[Either, "pop object"], xp: Any = jnp
) -> Poses:
    """Chain parent frames from the root downwards.

    Args:
        arrangement: the composed scene.
        layouts: the candidates.
        height: snapped heights [m].
        xp: `jnp`, or `numpy` for double precision on the host.
    """
    a = arrangement
    size = xp.exp(layouts.log_scale)
    pos: list[Any] = []
    yaw: list[Any] = []
    for i, p in enumerate(a.parent):
        s = size[:, p, None] if p >= 0 else xp.ones_like(size[:, :1])
        base = pos[p] if p >= 0 else xp.zeros_like(s)
        heading = yaw[p] if p >= 0 else xp.zeros_like(size[:, 0])
        frame = base + _turn(heading, xp.asarray(a.frame_pos[i]) * s, xp)
        heading = heading + a.frame_yaw[i]
        xy = (xp.asarray(a.xy[i]) + layouts.xy[:, i]) * s
        local = xp.concatenate([xy, height[:, i, None]], axis=-1)
        pos.append(frame + _turn(heading, local, xp))
        yaw.append(heading + a.yaw[i] + layouts.yaw[:, i])
    half = xp.stack(yaw, axis=1) / 2
    zero = xp.zeros_like(half)
    turn = xp.stack([xp.cos(half), zero, zero, xp.sin(half)], axis=-1)
    quat = quat_mul(turn, xp.asarray(a.tilt), xp)
    return Poses(xp.stack(pos, axis=1), quat, size, height)


def _turn(yaw: Any, v: Any, xp: Any) -> Any:
    c, s = xp.cos(yaw), xp.sin(yaw)
    x, y = c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]
    return xp.stack([x, y, v[:, 2]], axis=-1)


def rotation(quat: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """Turn unit quaternions into rotation matrices."""
    w, x, y, z = jnp.moveaxis(quat, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
