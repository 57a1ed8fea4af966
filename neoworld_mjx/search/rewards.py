"""Reward terms of Step 5 (paper Section 3.3): functions of (scene, layouts, rollout).

`d_pen`, `d_drift` and `s_sem` are compiled at the first call with given array shapes.
You can call them inside `jax.jit`, `jax.vmap` or `jax.grad`. A `Term` adds a function of your own
to the reward.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..physics.array_types import AnyArray
from ..physics.engine import Rollout
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..physics.placed import pair_depths, pair_gaps
from ..physics.scene_arrays import SceneArrays
from ..physics.visibility import visibility
from ..spec.pose import angle_between, length
from .semantic import semantic_score

FIVE_DEGREES = float(np.radians(5.0))

__all__ = ["Term", "d_drift", "d_pen", "drifts", "gaps", "s_sem", "speeds"]

TermFunction = Callable[[SceneModel, Layout, Rollout], Array]
"""Function of (scene, layouts, rollout) that JAX can trace; returns one number per candidate."""


def _scalar(x: Any) -> Array:
    # Conversion by NumPy compiles nothing.
    return x if isinstance(x, jax.Array) else jax.device_put(np.asarray(x, np.float32))


def _scalar_or_none(x: Any) -> Array | None:
    return None if x is None else _scalar(x)


class Term(eqx.Module):
    """One term of the reward R(z), which is the sum of weight * value over all terms.

    Weight and scale are traced, so they can be swept by `vmap`. The function is static, and so is
    the presence of a scale.
    """

    name: str = eqx.field(static=True)
    """Name of the term in history.npz and in the rows of a sweep."""
    fn: Any
    """A TermFunction; `try_term` reports anything else. None for a built-in term."""
    weight: Float[Array, ""] = eqx.field(converter=_scalar)
    """Positive for a reward, negative for a cost."""
    scale: Float[Array, ""] | None = eqx.field(converter=_scalar_or_none, default=None)
    """Scale of value / (value + scale), which enters the reward: 1/2 at the scale, and less than 1
    everywhere. If None, the plain value enters it."""

    def saturated(self, value: Float[AnyArray, " pop"]) -> Float[AnyArray, " pop"]:
        """Return value / (value + scale), or the plain value if the term has no scale."""
        return value if self.scale is None else value / (value + self.scale)


def total_depth(depth: Float[AnyArray, "pop object object"]) -> Float[Array, " pop"]:
    """Return D_pen [m]: the sum over pairs of the larger one of their two penetration depths."""
    return jnp.sum(jnp.triu(symmetric_depth(depth), 1), axis=(1, 2))


def symmetric_depth(
    depth: Float[AnyArray, "pop object object"],
) -> Float[Array, "pop object object"]:
    """Return the larger one of the two penetration depths of each pair of objects."""
    return jnp.maximum(depth, jnp.swapaxes(depth, 1, 2))


def prior(
    scene: SceneArrays, layouts: Layout, sigma: Layout, origin: Layout
) -> Float[Array, " pop"]:
    """Return the distance to the initial layout: mean of (z / sigma)^2 over objects and variables.

    It is about 1 for a typical sample. Without it, elites drift, and objects shrink to lower D_pen.

    Args:
        scene: the scene's arrays.
        layouts: the candidates.
        sigma: standard deviations, with a population axis of length 1.
        origin: initial layout, with a population axis of length 1.
    """
    in_sigma = lambda x, mean, std: ((x - mean) / jnp.maximum(std, 1e-6)) ** 2
    z = jax.tree.map(in_sigma, layouts, origin, sigma)
    by_object = (jnp.sum(z.xy, axis=-1) + z.yaw + z.log_scale) / 4
    total = jnp.sum(jnp.where(scene.optimised, by_object, 0.0), axis=1)
    return total / jnp.maximum(jnp.sum(scene.optimised), 1)


def drifts(
    scene: SceneArrays, rollout: Rollout
) -> tuple[Float[Array, "pop object"], Float[Array, "pop object"]]:
    """Return the largest distance [m] and angle [rad] of each object's base from its first pose."""
    distance = length(rollout.pos - rollout.start.pos[:, None], jnp)
    angle = angle_between(rollout.start.quat[:, None], rollout.quat, jnp)
    return jnp.max(distance, axis=1), jnp.max(angle, axis=1)


def drift_by_object(
    scene: SceneArrays,
    rollout: Rollout,
    distance: Float[Array, ""] | float,
    angle: Float[Array, ""] | float,
) -> Float[Array, "pop object"]:
    """Return each object's largest drift, in units of the stability bounds.

    It is the larger one of the displacement of its joints and, if its base is free, the drift of
    its base. The bound of slides is `distance` [m]; the bound of all other joints is `angle` [rad].
    """
    moved, turned = drifts(scene, rollout)
    base = jnp.where(scene.movable, jnp.maximum(moved / distance, turned / angle), 0.0)
    if not len(scene.joint_object):
        return base
    shift = jnp.max(rollout.joint_shift, axis=1) / jnp.where(scene.joint_slides, distance, angle)
    return base.at[:, scene.joint_object].max(shift)


def _poses(scene: SceneArrays, layouts: Layout, rollout: Rollout | None) -> Poses:
    return scene.place(layouts) if rollout is None else rollout.start


@eqx.filter_jit
def _d_pen(scene: SceneArrays, layouts: Layout, rollout: Rollout | None) -> Array:
    return total_depth(pair_depths(scene, _poses(scene, layouts, rollout)))


@eqx.filter_jit
def _d_drift(scene: SceneArrays, rollout: Rollout, distance: Any, angle: Any) -> Array:
    return jnp.sum(drift_by_object(scene, rollout, distance, angle), axis=1)


@eqx.filter_jit
def _s_sem(scene: SceneArrays, layouts: Layout, rollout: Rollout | None) -> Array:
    # Visibility has no gradient, and that of the other parts alone would be misleading.
    poses = lax.stop_gradient(_poses(scene, layouts, rollout))
    return semantic_score(scene, pair_depths(scene, poses), visibility(scene, poses))


def d_pen(
    scene: SceneModel, layouts: Layout, rollout: Rollout | None = None
) -> Float[Array, " pop"]:
    """Compute D_pen, the sum of the penetration depths of all pairs of objects [m].

    The depth of a pair is the larger one of its two directions (see `placed.pair_depths`), at the
    start of the rollout, or at the placed poses if `rollout` is None. The function is compiled; it
    can be jitted, vmapped, and, without a rollout, differentiated with respect to the layouts.

    Raises:
        TypeError: an argument is of another type, such as a path in place of a compiled scene.
        ValueError: an axis does not fit the scene.
    """
    _check("d_pen", scene, layouts, rollout)
    return _d_pen(scene.arrays, layouts, rollout)


def d_drift(
    scene: SceneModel,
    layouts: Layout,
    rollout: Rollout,
    *,
    distance: Float[Array, ""] | float = 0.01,
    angle: Float[Array, ""] | float = FIVE_DEGREES,
) -> Float[Array, " pop"]:
    """Compute D_drift, the sum over objects of the largest drift, in units of the stability bounds.

    The drift of an object is the largest of three ratios: its translation divided by `distance`
    [m], its rotation divided by `angle` [rad], and the displacement of a joint divided by the
    respective bound. The term of the search also counts the displacement by settling. The function
    is compiled; it can be jitted, vmapped, and differentiated with respect to the poses of the
    rollout, but rollouts themselves give no gradients.

    Raises:
        TypeError: an argument is of another type.
        ValueError: an axis does not fit the scene.
    """
    if rollout is None:
        raise TypeError("d_drift takes a Rollout (of neoworld_mjx.rollout), got None")
    _check("d_drift", scene, layouts, rollout)
    return _d_drift(scene.arrays, rollout, distance, angle)


def s_sem(
    scene: SceneModel, layouts: Layout, rollout: Rollout | None = None
) -> Float[Array, " pop"]:
    """Compute the geometric S_sem in [0, 1]; see `semantic`.

    The poses are those of `d_pen`. The function is compiled; it can be jitted and vmapped. Its
    gradient is 0.

    Raises:
        TypeError: an argument is of another type.
        ValueError: an axis does not fit the scene.
    """
    _check("s_sem", scene, layouts, rollout)
    return _s_sem(scene.arrays, layouts, rollout)


def _check(name: str, scene: Any, layouts: Any, rollout: Any) -> None:
    """Raise a TypeError or a ValueError if the arguments of a reward do not fit each other."""
    for value, kind, hint in (
        (scene, SceneModel, "compile a scene with load_scene or compile_scene"),
        (layouts, Layout, "candidates have a leading pop axis"),
        (rollout, Rollout | None, "of neoworld_mjx.rollout"),
    ):
        if not isinstance(value, kind):
            wanted = getattr(kind, "__name__", "Rollout")
            raise TypeError(f"{name} takes a {wanted} ({hint}), got a {type(value).__name__}")
    pop, count = np.shape(layouts.yaw)[0] if np.ndim(layouts.yaw) else 0, scene.count
    shapes = {"xy": (pop, count, 2), "yaw": (pop, count), "log_scale": (pop, count)}
    actual = {f"layouts.{part}": np.shape(getattr(layouts, part)) for part in shapes}
    expected = {f"layouts.{part}": shape for part, shape in shapes.items()}
    if rollout is not None:
        actual["rollout.pos"] = np.shape(rollout.pos)
        expected["rollout.pos"] = (pop, *actual["rollout.pos"][1:2], count, 3)
    for part, shape in expected.items():
        if actual[part] != shape:
            raise ValueError(
                f"{name}: {part} has shape {list(actual[part])}, for {pop} candidates of {count} "
                f"objects it must be {list(shape)}"
            )


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
