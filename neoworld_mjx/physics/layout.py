"""Layouts: the four parameters of each object that CEM optimizes, and the resulting poses."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import pose, quat_mul, yaw_of
from .array_types import AnyArray
from .support import NO_SURFACE, Support, height_above, link_frame, no_support, support

SNAPPED_AT_ONCE = 8192
"""Largest number of objects, over all candidates, that are snapped at once. Each takes 30 KB."""


CandidatesT = TypeVar("CandidatesT", bound="Candidates")


class Candidates(eqx.Module):
    """Base class of modules whose arrays have a leading axis of candidates."""

    def __getitem__(self: CandidatesT, index: object) -> CandidatesT:
        """Select candidates along the leading axis."""
        return jax.tree.map(lambda leaf: leaf[index], self)


class Layout(Candidates):
    """Perturbations z = (dx, dy, dyaw, log s) of a composed scene (paper Section 3.3).

    The zero layout is the composed scene. Perturbations are applied in the order scale, yaw,
    translation, in the frame of each object's parent.
    """

    xy: Float[AnyArray, "pop object 2"]
    """Offset in the parent's frame [m]."""
    yaw: Float[AnyArray, "pop object"]
    """Offset of the yaw [rad]."""
    log_scale: Float[AnyArray, "pop object"]
    """Log of the isotropic scale factor."""

    @classmethod
    def zero(cls, pop: int, objects: int) -> "Layout":
        """Return `pop` copies of the composed scene."""
        # On the host, where a new shape needs no compilation.
        zeros = lambda *shape: jax.device_put(np.zeros(shape, np.float32))
        return cls(zeros(pop, objects, 2), zeros(pop, objects), zeros(pop, objects))


class Variation(Candidates):
    """Physical quantities of the candidates, relative to the compiled scene.

    Joints are those of `StaticScene.joints`.
    """

    mass: Float[AnyArray, "pop object"]
    """Factors of masses and moments of inertia."""
    friction: Float[AnyArray, "pop object"]
    """Factors of the sliding friction of contacts."""
    joint_friction: Float[AnyArray, "pop joint"]
    """Factors of the dry friction of joints."""
    joint_damping: Float[AnyArray, "pop joint"]
    """Factors of the damping of joints."""
    opening: Float[AnyArray, "pop joint"]
    """Changes of the initial positions of hinges and slides at scale 1 [rad or m]."""


class Poses(Candidates):
    """World poses of all objects of the candidates, from `SceneModel.place`."""

    pos: Float[AnyArray, "pop object 3"]
    """Origins [m]."""
    quat: Float[AnyArray, "pop object 4"]
    """Rotations, including the tilt, w first."""
    scale: Float[AnyArray, "pop object"]
    """Isotropic scale factors."""
    height: Float[AnyArray, "pop object"]
    """Snapped height above the support frame's origin [m]; the `z` of a SceneObject."""
    variation: Variation | None = None
    """Other physical quantities of the candidates; None if they are those of the compiled scene."""


class Arrangement(NamedTuple):
    """Tabulated parameters of `place`; see SceneObject.

    `arrange` returns NumPy arrays in double precision, for exact poses. The arrays of `SceneArrays`
    are on the device in single precision.
    """

    xy: Float[AnyArray, "object 2"]
    z: Float[AnyArray, " object"]
    yaw: Float[AnyArray, " object"]
    tilt: Float[AnyArray, "object 4"]
    frame_pos: Float[AnyArray, "object 3"]
    """Origin of the object's support frame in the parent's yaw frame, at parent scale 1 [m]."""
    frame_yaw: Float[AnyArray, " object"]
    parent: Int[AnyArray, " object"]
    """Index of the parent; -1 for the world."""
    ancestors: Float[AnyArray, "object object"]
    """1 at [i, j] if j is i or supports i, directly or indirectly; otherwise 0."""
    snapped: Bool[AnyArray, " object"]
    support: Support
    """Stacked over objects."""
    gap: Float[AnyArray, " object"]
    """Height of a snapped object above the height at which it touches its support [m]."""


GAP_M = 1e-4
"""Clearance under snapped objects [m]."""


def arrange(scene: SceneSpec, *, reach: float = 1 / 3) -> Arrangement:
    """Tabulate a composed scene for `place`.

    Args:
        scene: the composed scene.
        reach: fraction of an object's horizontal diagonal. Objects are snapped up to this distance
            plus 2 cm from their composed positions. One third is six default standard deviations.
    """
    snapped = [
        o.parent is not None and o.relation != "attached" and not o.environment
        for o in scene.objects
    ]
    tables = []
    for item, snap in zip(scene.objects, snapped, strict=True):
        tables.append(support(scene, item, reach * diagonal(item) + 0.02) if snap else no_support())
    return frames(scene)._replace(
        snapped=np.array(snapped),
        support=jax.tree.map(lambda *rows: np.stack(rows), *tables),
        gap=np.full(len(snapped), GAP_M),
    )


def frames(scene: SceneSpec) -> Arrangement:
    """Tabulate a composed scene for `compose_poses` at given heights, without support surfaces."""
    links = [
        pose() if o.parent is None else link_frame(scene.object(o.parent), o.parent_link)
        for o in scene.objects
    ]
    parent = np.array([-1 if o.parent is None else scene.index(o.parent) for o in scene.objects])
    return Arrangement(
        xy=np.array([item.xy for item in scene.objects], float),
        z=np.array([item.z for item in scene.objects], float),
        yaw=np.array([item.yaw for item in scene.objects], float),
        tilt=np.array([item.base_tilt for item in scene.objects], float),
        frame_pos=np.array([link.pos for link in links]),
        frame_yaw=np.array([yaw_of(link.quat) for link in links]),
        parent=parent,
        ancestors=_ancestors(parent),
        snapped=np.zeros(len(parent), bool),
        support=no_support(),
        gap=np.zeros(len(parent)),
    )


def _ancestors(parent: Int[np.ndarray, " object"]) -> Float[np.ndarray, "object object"]:
    ancestors = np.eye(len(parent))
    for i, p in enumerate(parent):  # parents come before their children
        if p >= 0:
            ancestors[i] += ancestors[p]
    return ancestors


def diagonal(item: SceneObject) -> float:
    """Return an object's horizontal bounding-box diagonal [m], at its tilt and joint state."""
    low, high = bounds(item.spec, item.joint_state, item.base_tilt)
    return float(np.hypot(*(high - low)[:2]))


def place(arrangement: Arrangement, layouts: Layout) -> Poses:
    """Place every object of every candidate at its snapped height. Traceable and differentiable.

    A child's offset in its parent's frame scales with the parent, but the child's size does not. An
    object that has no part above its support keeps its composed height, and falls when simulated.
    """
    return compose_poses(arrangement, layouts, heights(arrangement, layouts))


def heights(arrangement: Arrangement, layouts: Layout) -> Float[Array, "pop object"]:
    """Return the snapped height [m] of every object's origin above its support frame."""
    a = arrangement
    size = jnp.exp(layouts.log_scale)
    parent_size = _parent_values(a, size, 1.0, jnp)
    xy = (jnp.asarray(a.xy, jnp.float32) + layouts.xy) * parent_size[..., None]
    yaw = jnp.asarray(a.yaw, jnp.float32) + layouts.yaw
    tables = jax.tree.map(jnp.asarray, a.support)
    over_objects = jax.vmap(height_above, in_axes=(0, 0, 0, 0, 0))
    contact_height = _map_candidates(
        lambda *candidate: over_objects(tables, *candidate), xy, yaw, size, parent_size
    )
    snapped = jnp.asarray(a.snapped) & (contact_height > NO_SURFACE / 2)
    composed = jnp.asarray(a.z, jnp.float32) * parent_size
    return jnp.where(snapped, contact_height + jnp.asarray(a.gap, jnp.float32), composed)


def _map_candidates(one: Callable[..., Any], *candidates: Any) -> Any:
    """Map a function over candidates [pop, object, ...], SNAPPED_AT_ONCE objects at a time."""
    pop, objects = candidates[0].shape[:2]
    parts = -(-pop * objects // SNAPPED_AT_ONCE)
    if parts <= 1:
        return jax.vmap(one)(*candidates)
    # Equal parts, since a remainder would be compiled separately.
    return jax.lax.map(lambda row: one(*row), candidates, batch_size=-(-pop // parts))


def compose_poses(
    arrangement: Arrangement, layouts: Layout, height: Float[AnyArray, "pop object"], xp: Any = jnp
) -> Poses:
    """Compose poses along the chain of support frames."""
    a = arrangement if xp is np else _to_single_precision(arrangement)
    size = xp.exp(layouts.log_scale)
    parent_size = _parent_values(a, size, 1.0, xp)[..., None]
    heading = _sum_over_ancestors(a, a.frame_yaw + a.yaw + layouts.yaw, xp)
    parent_heading = _parent_values(a, heading, 0.0, xp)
    local = xp.concatenate([(a.xy + layouts.xy) * parent_size, height[..., None]], axis=-1)
    step = _rotate_about_z(parent_heading, a.frame_pos * parent_size, xp) + _rotate_about_z(
        parent_heading + a.frame_yaw, local, xp
    )
    half = heading / 2
    zero = xp.zeros_like(half)
    turn = xp.stack([xp.cos(half), zero, zero, xp.sin(half)], axis=-1)
    quat = quat_mul(turn, a.tilt, xp)
    return Poses(_sum_over_ancestors(a, step, xp), quat, size, height)


def _to_single_precision(arrangement: Arrangement) -> Arrangement:
    tree = arrangement._replace(support=None)
    single = lambda x: jnp.asarray(x, jnp.float32) if np.issubdtype(x.dtype, np.floating) else x
    return jax.tree.map(single, tree)._replace(support=arrangement.support)


def _parent_values(a: Arrangement, values: Any, world: float, xp: Any) -> Any:
    """Return the value of each object's parent, or `world` if there is no parent, [pop, object]."""
    return xp.where(a.parent >= 0, values[:, xp.maximum(a.parent, 0)], world)


def _sum_over_ancestors(a: Arrangement, values: Any, xp: Any) -> Any:
    """Sum values [pop, object, ...] over each object and its ancestors."""
    if xp is np:
        return np.einsum("ij,pj...->pi...", a.ancestors, values)
    return jnp.einsum("ij,pj...->pi...", a.ancestors, values, precision="highest")


def _rotate_about_z(yaw: Any, v: Any, xp: Any) -> Any:
    c, s = xp.cos(yaw), xp.sin(yaw)
    x, y = c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]
    return xp.stack([x, y, xp.broadcast_to(v[..., 2], x.shape)], axis=-1)


def rotation(quat: Float[AnyArray, "*batch 4"], xp: Any = jnp) -> Float[AnyArray, "*batch 3 3"]:
    """Convert unit quaternions to rotation matrices."""
    w, x, y, z = (quat[..., k] for k in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)
