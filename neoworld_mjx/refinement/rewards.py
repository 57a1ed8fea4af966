"""Reward terms of Step 5 (paper Section 3.3): functions of (scene, layouts, rollout).

`d_pen`, `d_drift` and `s_sem` are compiled at the first call with given array shapes.
You can call them inside `jax.jit`, `jax.vmap` or `jax.grad`. A `Term` adds such a function,
built-in or user-defined, to the reward.
"""

import inspect
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..errors import ConfigError
from ..physics.array_types import AnyArray
from ..physics.engine import Rollout
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.placed import pair_depths, pair_gaps
from ..physics.scene_arrays import SceneArrays
from ..physics.visibility import Visible, visibility
from ..spec.pose import angle_between, length
from .semantic import semantic_score

FIVE_DEGREES = float(np.radians(5.0))

__all__ = ["Term", "TermValue", "d_drift", "d_pen", "drifts", "gaps", "s_sem", "speeds"]


class TermValue(eqx.Module):
    """Value of a term for every candidate."""

    value: Float[AnyArray, " pop"]
    """Value that is stored in the history."""
    reward_value: Float[AnyArray, " pop"]
    """Value that enters the reward. D_drift, for example, is reduced by its dead zone."""
    by_object: Float[AnyArray, "pop object"] | None = None
    """Reward value of each object, for credit assignment; None if the term has no such values."""


TermFunction = Callable[[Any, Layout, Rollout], Any]
"""Function of (scene, layouts, rollout) that JAX can trace; returns values [pop] or a TermValue.
The scene is a SceneModel, or the SceneArrays of a padded scene if `Term.padded` is True."""


def _scalar(x: Any) -> Array:
    # Conversion by NumPy compiles nothing.
    return x if isinstance(x, jax.Array) else jax.device_put(np.asarray(x, np.float32))


def _scalar_or_none(x: Any) -> Array | None:
    return None if x is None else _scalar(x)


class Term(eqx.Module):
    """One term of the reward R(z), which is the sum of weight * normalized value over all terms.

    Weight, scale and cap are traced, so they can be swept by `vmap`. The function is static, and so
    is the presence of a scale and a cap.
    """

    name: str = eqx.field(static=True)
    """Name of the term in history.npz and in the rows of a sweep."""
    fn: Any
    """A TermFunction; `try_term` reports anything else."""
    weight: Float[Array, ""] = eqx.field(converter=_scalar)
    """Positive for a reward, negative for a cost."""
    scale: Float[Array, ""] | None = eqx.field(converter=_scalar_or_none, default=None)
    """Scale of value / (value + scale) in the absolute reward. If None, it uses the plain value."""
    cap: Float[Array, ""] | None = eqx.field(converter=_scalar_or_none, default=None)
    """Cap at which the value is clipped before it is normalized. If None, it is not normalized."""
    padded: bool = eqx.field(static=True, default=False)
    """True if the function accepts a padded scene.

    If all terms accept padded scenes, scoring and sampling are compiled once for many scenes, else
    once for each scene. In the first case the function is called with a `SceneArrays` whose object
    axis is padded; `optimised`, `movable`, `photo.scored` and `pair_mask` are False for padding.
    """


class MeasuredRollout(Rollout):
    """Rollout with measures of the candidates, which several terms use."""

    depth: Float[AnyArray, "pop object object"]
    """Result of `pair_depths` at the initial poses of the rollout [m]."""
    visible: Visible
    """Visible parts of the objects in the camera image, at the initial poses of the rollout."""
    settled: Float[AnyArray, "pop object"]
    """Displacement by settling; see `Placed.settled`."""


def measured_rollout(
    rollout: Rollout,
    depth: Float[AnyArray, "pop object object"],
    visible: Visible,
    settled: Float[AnyArray, "pop object"],
) -> MeasuredRollout:
    """Combine a rollout with measures of its candidates; see `Placed`."""
    fields = {name: getattr(rollout, name) for name in Rollout.__dataclass_fields__}
    return MeasuredRollout(**fields, depth=depth, visible=visible, settled=settled)


def symmetric_depth(
    depth: Float[AnyArray, "pop object object"],
) -> Float[Array, "pop object object"]:
    """Return the larger one of the two penetration depths of each pair of objects."""
    return jnp.maximum(depth, jnp.swapaxes(depth, 1, 2))


def _depth(scene: SceneArrays, layouts: Layout, rollout: Rollout | None) -> Array:
    """Return the pair depths of the candidates, from the rollout if it contains them."""
    if isinstance(rollout, MeasuredRollout):
        return jnp.asarray(rollout.depth)
    return pair_depths(scene, scene.place(layouts))


def _visible(scene: SceneArrays, layouts: Layout, rollout: Rollout | None) -> Visible:
    """Return the visible parts of the candidates, from the rollout if it contains them."""
    if isinstance(rollout, MeasuredRollout):
        return rollout.visible
    return visibility(scene, scene.place(layouts))


def penetration(scene: SceneArrays, layouts: Layout, rollout: Rollout | None = None) -> TermValue:
    """Compute D_pen [m], and for each object the sum over its pairs; see `d_pen`."""
    pair = symmetric_depth(_depth(scene, layouts, rollout))
    total = jnp.sum(jnp.triu(pair, 1), axis=(1, 2))
    return TermValue(total, total, jnp.sum(pair, axis=2))


def semantics(scene: SceneArrays, layouts: Layout, rollout: Rollout | None = None) -> TermValue:
    """Compute the geometric S_sem, and the score of each object; the gradient is zero.

    Visibility has no gradient, and the gradient of the other parts alone would be misleading.
    """
    layouts, rollout = lax.stop_gradient((layouts, rollout))
    visible = _visible(scene, layouts, rollout)
    scored = semantic_score(scene, _depth(scene, layouts, rollout), visible)
    return TermValue(scored.total, scored.total, scored.by_object)


class Drift(eqx.Module):
    """D_drift in units of the stability bounds, with a dead zone."""

    distance: Float[Array, ""] = eqx.field(converter=_scalar)
    """Stability bound of translation [m]."""
    angle: Float[Array, ""] = eqx.field(converter=_scalar)
    """Stability bound of rotation [rad]."""
    dead_zone: Float[Array, ""] = eqx.field(converter=_scalar, default=0.0)
    """Dead zone: drift of an object that costs nothing, in units of the bounds."""

    def __call__(self, scene: SceneArrays, layouts: Layout, rollout: Rollout) -> TermValue:
        """Compute D_drift; see `d_drift`."""
        by_object = drift_by_object(scene, rollout, self.distance, self.angle)
        by_object = jnp.maximum(by_object, _settled(rollout))
        reward_value = jnp.maximum(by_object - self.dead_zone, 0.0)
        return TermValue(jnp.sum(by_object, axis=1), jnp.sum(reward_value, axis=1), reward_value)


def _settled(rollout: Rollout) -> Any:
    return rollout.settled if isinstance(rollout, MeasuredRollout) else 0.0


class Prior(eqx.Module):
    """Distance to the initial layout: mean of (z / sigma)^2 over optimized objects and variables.

    It is about 1 for a typical sample. Without it, elites drift, and objects shrink to lower D_pen.
    """

    sigma: Float[Array, " 3"] = eqx.field(converter=_scalar)
    """Standard deviations: x and y as a fraction of an object's diagonal, yaw [rad], log scale."""
    origin: Layout | None = None
    """Initial layout, with a population axis of length 1. If None, it is the composed scene."""

    def __call__(self, scene: SceneArrays, layouts: Layout, rollout: Rollout | None) -> TermValue:
        """Compute the prior."""
        safe = jnp.maximum(self.sigma, 1e-6)
        if self.origin is not None:
            layouts = jax.tree.map(jnp.subtract, layouts, self.origin)
        xy = jnp.sum((layouts.xy / (safe[0] * scene.diagonal[:, None])) ** 2, axis=-1)
        by_object = (xy + (layouts.yaw / safe[1]) ** 2 + (layouts.log_scale / safe[2]) ** 2) / 4
        by_object = jnp.where(scene.optimised, by_object, 0.0)
        total = jnp.sum(by_object, axis=1) / jnp.maximum(jnp.sum(scene.optimised), 1)
        return TermValue(total, total, by_object)


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

    It is the larger one of the drift of its joints and, if its base is free, the drift of its base.
    """
    moved, turned = drifts(scene, rollout)
    base = jnp.where(scene.movable, jnp.maximum(moved / distance, turned / angle), 0.0)
    if not len(scene.joint_object):
        return base
    return jnp.maximum(base, joint_drift(scene, rollout, distance, angle))


def joint_drift(
    scene: SceneArrays,
    rollout: Rollout,
    distance: Float[Array, ""] | float,
    angle: Float[Array, ""] | float,
) -> Float[Array, "pop object"]:
    """Return the largest displacement of a joint of each object, in units of the stability bounds.

    The bound of slides is `distance` [m]; the bound of all other joints is `angle` [rad].
    """
    largest = jnp.max(rollout.joint_shift, axis=1)
    shift = largest / jnp.where(scene.joint_slides, distance, angle)
    zero = jnp.zeros((shift.shape[0], scene.count))
    return zero.at[:, scene.joint_object].max(shift)


@eqx.filter_jit
def _compiled(fn: TermFunction, scene: SceneArrays, layouts: Layout, rollout: Any) -> Array:
    return fn(scene, layouts, rollout).value


def _call(fn: TermFunction, name: str, scene: Any, layouts: Any, rollout: Any) -> Array:
    for value, kind, hint in (
        (scene, SceneModel, "compile a scene with load_scene or compile_scene"),
        (layouts, Layout, "candidates have a leading pop axis"),
        (rollout, Rollout | None, "of neoworld_mjx.rollout"),
    ):
        if not isinstance(value, kind):
            wanted = getattr(kind, "__name__", "Rollout")
            raise TypeError(f"{name} takes a {wanted} ({hint}), got a {type(value).__name__}")
    _check_shapes(name, scene, layouts, rollout)
    return _compiled(fn, scene.arrays, layouts, rollout)


def _check_shapes(name: str, scene: SceneArrays, layouts: Layout, rollout: Any) -> None:
    """Raise a ValueError if an axis of a layout or a rollout does not fit the scene."""
    pop, count = np.shape(layouts.yaw)[0] if np.ndim(layouts.yaw) else 0, scene.count
    shapes = {"xy": (pop, count, 2), "yaw": (pop, count), "log_scale": (pop, count)}
    for part, shape in shapes.items():
        actual = np.shape(getattr(layouts, part))
        if actual != shape:
            raise ValueError(
                f"{name}: layouts.{part} has shape {list(actual)}, for {count} objects it must be "
                f"[pop, {', '.join(map(str, shape[1:]))}] with one pop for all parts"
            )
    if rollout is not None:
        moving = np.shape(rollout.pos)
        if moving[:1] + moving[2:3] != (pop, count):
            raise ValueError(
                f"{name}: rollout.pos has shape {list(moving)}, for {pop} candidates of {count} "
                f"objects it must be [{pop}, time, {count}, 3]"
            )


def d_pen(
    scene: SceneModel, layouts: Layout, rollout: Rollout | None = None
) -> Float[Array, " pop"]:
    """Compute D_pen, the sum of the penetration depths of all pairs of objects [m].

    The depth of a pair is the larger one of its two directions (see `placed.pair_depths`), at the
    placed poses; `rollout` is unused. The function is compiled; it can be jitted, vmapped, and
    differentiated with respect to the layouts.

    Raises:
        TypeError: an argument is of another type, such as a path in place of a compiled scene.
        ValueError: an axis does not fit the scene.
    """
    return _call(penetration, "d_pen", scene, layouts, rollout)


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
    respective bound. The function is compiled; it can be jitted, vmapped, and differentiated with
    respect to the poses of the rollout, but rollouts themselves give no gradients.

    Raises:
        TypeError: an argument is of another type.
        ValueError: an axis does not fit the scene.
    """
    if rollout is None:
        raise TypeError("d_drift takes a Rollout (of neoworld_mjx.rollout), got None")
    return _call(Drift(distance, angle), "d_drift", scene, layouts, rollout)


def s_sem(
    scene: SceneModel, layouts: Layout, rollout: Rollout | None = None
) -> Float[Array, " pop"]:
    """Compute the geometric S_sem in [0, 1] at the placed poses; see `semantic`.

    `rollout` is unused. The function is compiled; it can be jitted and vmapped. Its gradient is 0.

    Raises:
        TypeError: an argument is of another type.
        ValueError: an axis does not fit the scene.
    """
    return _call(semantics, "s_sem", scene, layouts, rollout)


def term_value(term: Term, fn: TermFunction, *args: Any) -> TermValue:
    """Call the function of a term, and wrap a plain array into a TermValue."""
    value = fn(*args)
    if isinstance(value, TermValue):
        return value
    value = jnp.asarray(value, jnp.float32)
    return TermValue(value, value)


def try_term(term: Term, scene: SceneModel, rollout: Rollout, layouts: Layout) -> None:
    """Call a term once on a few candidates in which no object moves, before the search.

    Args:
        term: a user-defined term.
        scene: the compiled scene.
        rollout: rollout of the candidates.
        layouts: the candidates.

    Raises:
        ConfigError: the term is not a function, takes other arguments, raises an exception, or does
            not return one finite number per candidate. The message gives the function's location.
    """
    pop = layouts.yaw.shape[0]
    where = f"reward term {term.name} ({source(term.fn)})"
    if not callable(term.fn):
        raise ConfigError(f"{where} is not a function of (scene, layouts, rollout)")
    try:
        shape = eqx.filter_eval_shape(term.fn, scene, layouts, rollout)
        if isinstance(shape, TermValue):
            shape = shape.value
        got = getattr(shape, "shape", None)
        if got is None or not jnp.issubdtype(shape.dtype, jnp.number):
            raise ConfigError(
                f"{where} must return an array of shape [pop], one number per candidate, "
                f"got {_type_text(shape)}"
            )
        if got != (pop,):
            raise ConfigError(
                f"{where} must return shape [pop], here [{pop}] for {pop} candidates, got "
                f"{list(got) if got else 'a scalar'}"
            )
        values = np.asarray(
            eqx.filter_jit(term_value)(term, term.fn, scene, layouts, rollout).value
        )
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:
        text = str(error).strip().split("\n")[0]
        raise ConfigError(
            f"{where} cannot be called with (scene, layouts, rollout): "
            f"{type(error).__name__}: {text}"
        ) from error
    if not np.isfinite(values).all():
        raise ConfigError(
            f"{where} returned {values[~np.isfinite(values)][0]} for "
            f"{int((~np.isfinite(values)).sum())} of {pop} candidates in which no object moves"
        )


def _type_text(value: Any) -> str:
    if hasattr(value, "dtype"):
        return f"dtype {value.dtype}"
    return "None" if value is None else f"a {type(value).__name__}"


def source(fn: Any) -> str:
    """Return the location of a function as file:line, if Python knows it."""
    try:
        inner = inspect.unwrap(fn)
        inner = inner if inspect.isroutine(inner) or inspect.isclass(inner) else type(inner)
        return f"{inspect.getsourcefile(inner)}:{inspect.getsourcelines(inner)[1]}"
    except (TypeError, OSError, ValueError):
        return f"{getattr(fn, '__module__', None) or 'a built-in'}, no source file"


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
