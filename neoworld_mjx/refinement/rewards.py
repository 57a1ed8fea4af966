"""Reward terms of Step 5 (paper Section 3.3) and how they are composed.

A term maps (scene, layouts, rollout) to one number a candidate and is traceable by JAX. Terms of a
user's own have the same shape and are named in a config by import path.
"""

import importlib
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from neoworld_kernels import pair_depth

from ..config import RefineOptions, RewardOptions
from ..errors import ConfigError
from ..physics.engine import Rollout, RolloutStatus
from ..physics.layout import Layout, Poses, rotation
from ..physics.model import SceneModel
from ..spec.pose import angle_between
from .semantic import Semantic, semantic_score

FIVE_DEGREES = float(np.radians(5.0))

Term = Callable[[SceneModel, Layout, Rollout], Float[Array, " pop"]]

__all__ = [
    "Placed",
    "Scores",
    "Term",
    "Weights",
    "absolute_reward",
    "bound",
    "compose",
    "d_drift",
    "d_pen",
    "departure",
    "depths",
    "drifts",
    "placed",
    "s_sem",
    "score",
    "user_terms",
    "weights",
]


def depths(scene: SceneModel, poses: Poses) -> Float[Array, "pop object object"]:
    """Sampled penetration depth [m] of i's surface samples in j's colliders, at [candidate, i, j].

    Measured on the canonical colliders at the placed poses; zero between environment supports.

    Args:
        scene: the compiled scene.
        poses: where the candidates' objects are placed.
    """
    turn = rotation(poses.quat)
    found = pair_depth(poses.pos, turn, poses.scale, scene.samples, scene.colliders)
    return jnp.where(scene.pair_mask, found, 0.0)


def d_pen(
    scene: SceneModel, layouts: Layout, rollout: Rollout | None = None
) -> Float[Array, " pop"]:
    """D_pen: the sum over object pairs of their penetration depth [m]; differentiable.

    A pair's depth is the deeper of its two directions. `rollout` is not used: the composed pose is
    measured, before physics moves anything.
    """
    found = depths(scene, scene.place(layouts))
    pair = jnp.maximum(found, jnp.swapaxes(found, 1, 2))
    return jnp.sum(jnp.triu(pair, 1), axis=(1, 2))


def drifts(
    scene: SceneModel, rollout: Rollout
) -> tuple[Float[Array, "pop object"], Float[Array, "pop object"]]:
    """Largest distance [m] and angle [rad] of each object from its layout pose, over all records."""
    far = jnp.linalg.norm(rollout.pos - rollout.start.pos[:, None], axis=-1)
    angle = angle_between(rollout.start.quat[:, None], rollout.quat, jnp)
    return jnp.max(far, axis=1), jnp.max(angle, axis=1)


def d_drift(
    scene: SceneModel,
    layouts: Layout,
    rollout: Rollout,
    *,
    distance: Float[Array, ""] | float = 0.01,
    angle: Float[Array, ""] | float = FIVE_DEGREES,
) -> Float[Array, " pop"]:
    """D_drift: the sum over objects of their largest drift, in units of the stability bounds.

    An object counts the larger of its translation over `distance` [m] and its rotation over
    `angle` [rad], so 1 is an object just at the bound.
    """
    return jnp.sum(_drift_each(scene, rollout, distance, angle), axis=1)


def _drift_each(
    scene: SceneModel,
    rollout: Rollout,
    distance: Float[Array, ""] | float,
    angle: Float[Array, ""] | float,
) -> Float[Array, "pop object"]:
    far, turned = drifts(scene, rollout)
    return jnp.where(scene.movable, jnp.maximum(far / distance, turned / angle), 0.0)


def s_sem(
    scene: SceneModel, layouts: Layout, rollout: Rollout | None = None
) -> Float[Array, " pop"]:
    """S_sem in [0, 1] by the geometric scorer, of the composed pose; see `semantic`."""
    poses = scene.place(layouts)
    return semantic_score(scene, poses, depths(scene, poses)).total


def departure(
    scene: SceneModel,
    layouts: Layout,
    sigma: Float[Array, " 3"],
    origin: Layout | None = None,
) -> Float[Array, "pop object"]:
    """Mean of (z / sigma)^2 over an optimised object's four numbers; 1 for a typical draw.

    It keeps what physics leaves open near the parse: without it elites wander, and shrinking
    everything would lower D_pen.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        sigma: deviations of xy (over each object's diagonal), yaw [rad] and log scale.
        origin: what departures are counted from, pop axis of length 1; None is the composed scene.
    """
    safe = jnp.maximum(sigma, 1e-6)
    if origin is not None:
        layouts = jax.tree.map(jnp.subtract, layouts, origin)
    xy = jnp.sum((layouts.xy / (safe[0] * scene.diagonal[:, None])) ** 2, axis=-1)
    each = (xy + (layouts.yaw / safe[1]) ** 2 + (layouts.log_scale / safe[2]) ** 2) / 4
    return jnp.where(scene.optimised, each, 0.0)


class Weights(eqx.Module):
    """Weights and scales of the reward; traced, so a sweep over them is one `vmap`."""

    w_sem: Float[Array, ""]
    w_pen: Float[Array, ""]
    w_drift: Float[Array, ""]
    w_prior: Float[Array, ""]
    d_pen_cap: Float[Array, ""]
    """[m]"""
    d_drift_cap: Float[Array, ""]
    drift_free: Float[Array, ""]
    """Drift of an object that costs nothing, in units of the stability bounds."""
    pen_scale: Float[Array, ""]
    """[m]"""
    distance: Float[Array, ""]
    """Stability bound [m]."""
    angle: Float[Array, ""]
    """Stability bound [rad]."""
    max_depth: Float[Array, ""]
    """Depth [m] from which a candidate is invalid."""
    sigma: Float[Array, " 3"]
    """Initial deviations of xy (over the diagonal), yaw [rad] and log scale."""
    user: Float[Array, " term"]
    origin: Layout | None
    """What the prior counts from, pop axis of length 1; None is the composed scene."""
    normalisation: str = eqx.field(static=True)


def weights(options: RefineOptions) -> Weights:
    """Collect what the reward needs from a configuration."""
    r = options.reward
    f = lambda x: jnp.asarray(x, jnp.float32)
    return Weights(
        w_sem=f(r.w_sem),
        w_pen=f(r.w_pen),
        w_drift=f(r.w_drift),
        w_prior=f(r.w_prior),
        d_pen_cap=f(r.d_pen_cap_m),
        d_drift_cap=f(r.d_drift_cap),
        drift_free=f(r.drift_free),
        pen_scale=f(r.pen_scale_m),
        distance=f(r.drift_scale_m),
        angle=f(np.radians(r.tilt_scale_deg)),
        max_depth=f(options.max_depth_m),
        sigma=f(
            [
                options.cem.sigma_xy,
                np.radians(options.cem.sigma_yaw_deg),
                options.cem.sigma_log_scale,
            ]
        ),
        user=f(list(r.terms.values())).reshape(-1),
        origin=None,
        normalisation=r.normalisation,
    )


class Placed(eqx.Module):
    """What candidates are judged by before anything moves."""

    start: Poses
    d_pen: Float[Array, " pop"]
    """[m]"""
    deepest: Float[Array, " pop"]
    """Depth of the deepest pair [m]."""
    s_sem: Float[Array, " pop"]
    prior: Float[Array, " pop"]
    pen_each: Float[Array, "pop object"]
    """Sum of the depths of an object's pairs [m]."""
    sem_each: Float[Array, "pop object"]
    prior_each: Float[Array, "pop object"]


class Scores(eqx.Module):
    """Everything that one iteration's candidates are judged by, each of shape [pop]."""

    d_pen: Float[Array, " pop"]
    """[m]"""
    d_drift: Float[Array, " pop"]
    """NaN for candidates that were pruned, that is not rolled out."""
    s_sem: Float[Array, " pop"]
    """In [0, 1]."""
    prior: Float[Array, " pop"]
    """How far the layout is from the composed one; see `departure`."""
    user: Float[Array, "term pop"]
    """A user's own terms."""
    valid: Bool[Array, " pop"]
    """No sampled pair deeper than max_depth_m, no object past the stability bounds."""
    status: Float[Array, " pop"]
    reward: Float[Array, " pop"]
    """As Algorithm 1 ranks; -inf for failed and pruned candidates."""
    absolute: Float[Array, " pop"]
    """With fixed scales, comparable between iterations; -inf for failed and pruned candidates."""
    credit: Float[Array, "pop object"]
    """The reward by objects, with fixed normalisation; see `shares`."""


@eqx.filter_jit
def placed(scene: SceneModel, layouts: Layout, w: Weights) -> Placed:
    """Evaluate what needs no physics: D_pen, S_sem and the prior.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        w: weights and scales.
    """
    start = scene.place(layouts)
    found = depths(scene, start)
    pair = jnp.maximum(found, jnp.swapaxes(found, 1, 2))
    semantic: Semantic = semantic_score(scene, start, found)
    prior = departure(scene, layouts, w.sigma, w.origin)
    free = jnp.maximum(jnp.sum(scene.optimised), 1)
    return Placed(
        start=start,
        d_pen=jnp.sum(jnp.triu(pair, 1), axis=(1, 2)),
        deepest=jnp.max(pair, axis=(1, 2)),
        s_sem=semantic.total,
        prior=jnp.sum(prior, axis=1) / free,
        pen_each=jnp.sum(pair, axis=2),
        sem_each=semantic.each,
        prior_each=prior,
    )


@eqx.filter_jit
def score(
    scene: SceneModel,
    layouts: Layout,
    rollout: Rollout,
    w: Weights,
    terms: tuple[Term, ...] = (),
    before: Placed | None = None,
) -> Scores:
    """Evaluate every term and compose the reward.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        rollout: their free fall.
        w: weights, normalisation and scales.
        terms: a user's own terms, in the order of `w.user`.
        before: of `placed`, where it is known already.
    """
    b = placed(scene, layouts, w) if before is None else before
    drift_each = _drift_each(scene, rollout, w.distance, w.angle)
    moved = jnp.sum(drift_each, axis=1)
    charged_each = jnp.maximum(drift_each - w.drift_free, 0.0)
    charged = jnp.sum(charged_each, axis=1)
    alive = ~jnp.isin(
        rollout.status, jnp.array([int(RolloutStatus.FAILED), int(RolloutStatus.TRUNCATED)])
    )
    own = [jnp.asarray(term(scene, layouts, rollout), jnp.float32) for term in terms]
    user = jnp.stack(own) if own else jnp.zeros((0, b.d_pen.shape[0]))
    rest = w.w_sem * b.s_sem - w.w_prior * b.prior + jnp.sum(w.user[:, None] * user, axis=0)
    alive &= jnp.isfinite(b.d_pen + moved + rest)
    credit = (
        w.w_sem * b.sem_each
        - w.w_prior * b.prior_each
        - w.w_pen * jnp.minimum(b.pen_each / w.d_pen_cap, 1.0)
        - w.w_drift * jnp.minimum(charged_each / w.d_drift_cap, 1.0)
    )
    return Scores(
        d_pen=b.d_pen,
        d_drift=moved,
        s_sem=b.s_sem,
        prior=b.prior,
        user=user,
        valid=jnp.all(drift_each < 1.0, axis=1) & (b.deepest < w.max_depth) & alive,
        status=rollout.status,
        reward=compose(b.d_pen, charged, rest, alive, w),
        absolute=absolute_reward(b.d_pen, charged, rest, alive, w),
        credit=jnp.where(alive[:, None], credit, -jnp.inf),
    )


def bound(before: Placed, w: Weights) -> Float[Array, " pop"]:
    """Upper bound of the reward under `fixed` normalisation, before anything moves.

    The reward of a candidate that does not drift at all; a user's own terms are not bounded.
    """
    rest = w.w_sem * before.s_sem - w.w_prior * before.prior
    upper = rest - w.w_pen * jnp.minimum(before.d_pen, w.d_pen_cap) / w.d_pen_cap
    return jnp.where(jnp.isfinite(upper), upper, -jnp.inf)


def compose(
    pen: Float[Array, " pop"],
    moved: Float[Array, " pop"],
    rest: Float[Array, " pop"],
    alive: Bool[Array, " pop"],
    w: Weights,
) -> Float[Array, " pop"]:
    """R(z) = w_sem S_sem - w_pen D_pen - w_drift D_drift with normalised physical terms.

    `iteration` maps each term's range over this iteration's candidates to [0, 1], after clipping at
    the cap (the paper's; a term that all share counts zero). `fixed` is min(D / cap, 1).

    Args:
        pen: D_pen [m].
        moved: D_drift.
        rest: the terms that are not normalised, already weighted.
        alive: candidates that did not fail; only these set the ranges.
        w: weights and caps.

    Returns:
        Rewards, -inf where not alive.
    """

    def unit(d: Float[Array, " pop"], cap: Float[Array, ""]) -> Float[Array, " pop"]:
        clipped = jnp.minimum(jnp.where(alive, d, cap), cap)
        if w.normalisation == "fixed":
            return clipped / cap
        low = jnp.min(jnp.where(alive, clipped, cap))
        high = jnp.max(jnp.where(alive, clipped, 0.0))
        spread = high - low
        return jnp.where(spread > 1e-12, (clipped - low) / jnp.maximum(spread, 1e-12), 0.0)

    physical = w.w_pen * unit(pen, w.d_pen_cap) + w.w_drift * unit(moved, w.d_drift_cap)
    return jnp.where(alive, rest - physical, -jnp.inf)


def absolute_reward(
    pen: Float[Array, " pop"],
    moved: Float[Array, " pop"],
    rest: Float[Array, " pop"],
    alive: Bool[Array, " pop"],
    w: Weights,
) -> Float[Array, " pop"]:
    """Reward with fixed scales, for keep-best, stopping, plots and baselines.

    D / (D + scale) with the scales 1 mm and the stability bounds: half the weight is lost at the
    scale, and it never saturates, so any two iterations can be compared.
    """
    physical = w.w_pen * pen / (pen + w.pen_scale) + w.w_drift * moved / (moved + 1.0)
    return jnp.where(alive, rest - physical, -jnp.inf)


def user_terms(options: RewardOptions) -> tuple[Term, ...]:
    """Import a user's own terms, named "package.module:function" in a config.

    Raises:
        ConfigError: a path has no such form, or nothing callable is there.
    """
    found = []
    for path in options.terms:
        module, _, name = path.partition(":")
        try:
            term = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise ConfigError(
                f"refine.reward.terms: cannot import {path!r} ({error}); "
                "write it as package.module:function"
            ) from None
        if not callable(term):
            raise ConfigError(f"refine.reward.terms: {path!r} is not a function")
        found.append(term)
    return tuple(found)
