"""Reward terms of Step 5 (paper Section 3.3) and how they are composed.

A term maps (scene, layouts, rollout) to one number a candidate and is traceable by JAX. Terms of a
user's own have the same shape and are named in a config by import path.
"""

import importlib
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from neoworld_kernels import pair_depth

from ..config import RefineOptions, RewardOptions
from ..errors import ConfigError
from ..physics.engine import Rollout, RolloutStatus
from ..physics.layout import Layout, Poses, rotation
from ..physics.model import SceneModel
from .semantic import semantic_score

FIVE_DEGREES = float(np.radians(5.0))

Term = Callable[[SceneModel, Layout, Rollout], Float[Array, " pop"]]

__all__ = [
    "Scores",
    "Term",
    "Weights",
    "absolute_reward",
    "compose",
    "d_drift",
    "d_pen",
    "departure",
    "depths",
    "drifts",
    "s_sem",
    "score",
    "user_terms",
    "weights",
]


def depths(scene: SceneModel, poses: Poses) -> Float[Array, "pop object object"]:
    """Sampled penetration depth [m] of i's surface samples in j's colliders, at [candidate, i, j].

    Measured on the canonical colliders at the placed poses; zero between environment supports.
    """
    found = pair_depth(poses.pos, rotation(poses.quat), poses.scale, scene.samples, scene.solids)
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
    a, b = rollout.start.quat[:, None], rollout.quat
    dot = jnp.abs(jnp.sum(a * b, axis=-1))
    # |a - b| is accurate where arccos(a.b) is not, at small angles.
    chord = jnp.minimum(jnp.linalg.norm(a - b, axis=-1), jnp.linalg.norm(a + b, axis=-1))
    angle = jnp.where(
        dot > 0.99,
        4 * jnp.arcsin(jnp.minimum(chord / 2, 1.0)),
        2 * jnp.arccos(jnp.minimum(dot, 1.0)),
    )
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
    far, turned = drifts(scene, rollout)
    each = jnp.maximum(far / distance, turned / angle)
    return jnp.sum(jnp.where(scene.movable, each, 0.0), axis=1)


def s_sem(
    scene: SceneModel, layouts: Layout, rollout: Rollout | None = None
) -> Float[Array, " pop"]:
    """S_sem in [0, 1] by the geometric scorer, of the composed pose; see `semantic`."""
    poses = scene.place(layouts)
    return semantic_score(scene, poses, depths(scene, poses))


def departure(
    scene: SceneModel, layouts: Layout, sigma: Float[Array, " 3"]
) -> Float[Array, " pop"]:
    """Mean of (z / sigma)^2 over optimised objects and their four numbers; 1 for a typical draw.

    It keeps what physics leaves open near the parse: without it elites wander, and shrinking
    everything would lower D_pen.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        sigma: deviations of xy (over each object's diagonal), yaw [rad] and log scale.
    """
    safe = jnp.maximum(sigma, 1e-6)
    xy = jnp.sum((layouts.xy / (safe[0] * scene.diagonal[:, None])) ** 2, axis=-1)
    each = (xy + (layouts.yaw / safe[1]) ** 2 + (layouts.log_scale / safe[2]) ** 2) / 4
    free = jnp.maximum(jnp.sum(scene.optimised), 1)
    return jnp.sum(jnp.where(scene.optimised, each, 0.0), axis=1) / free


class Weights(eqx.Module):
    """Weights and scales of the reward; traced, so a sweep over them is one `vmap`."""

    w_sem: Float[Array, ""]
    w_pen: Float[Array, ""]
    w_drift: Float[Array, ""]
    w_prior: Float[Array, ""]
    d_pen_cap: Float[Array, ""]
    """[m]"""
    d_drift_cap: Float[Array, ""]
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
        normalisation=r.normalisation,
    )


class Scores(eqx.Module):
    """Everything that one iteration's candidates are judged by, each of shape [pop]."""

    d_pen: Float[Array, " pop"]
    """[m]"""
    d_drift: Float[Array, " pop"]
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
    """As Algorithm 1 ranks; -inf for failed candidates."""
    absolute: Float[Array, " pop"]
    """With fixed scales, comparable between iterations; -inf for failed candidates."""


@eqx.filter_jit
def score(
    scene: SceneModel,
    layouts: Layout,
    rollout: Rollout,
    w: Weights,
    terms: tuple[Term, ...] = (),
) -> Scores:
    """Evaluate every term and compose the reward.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        rollout: their free fall.
        w: weights, normalisation and scales.
        terms: a user's own terms, in the order of `w.user`.
    """
    found = depths(scene, rollout.start)
    pair = jnp.maximum(found, jnp.swapaxes(found, 1, 2))
    pen = jnp.sum(jnp.triu(pair, 1), axis=(1, 2))
    moved = d_drift(scene, layouts, rollout, distance=w.distance, angle=w.angle)
    far, turned = drifts(scene, rollout)
    steady = jnp.all((far < w.distance) & (turned < w.angle) | ~scene.movable, axis=1)
    alive = ~jnp.isin(
        rollout.status, jnp.array([int(RolloutStatus.FAILED), int(RolloutStatus.TRUNCATED)])
    )
    prior = departure(scene, layouts, w.sigma)
    own = [jnp.asarray(term(scene, layouts, rollout), jnp.float32) for term in terms]
    user = jnp.stack(own) if own else jnp.zeros((0, pen.shape[0]))
    semantic = semantic_score(scene, rollout.start, found)
    rest = w.w_sem * semantic - w.w_prior * prior + jnp.sum(w.user[:, None] * user, axis=0)
    alive &= jnp.isfinite(pen + moved + rest)
    return Scores(
        d_pen=pen,
        d_drift=moved,
        s_sem=semantic,
        prior=prior,
        user=user,
        valid=steady & (jnp.max(pair, axis=(1, 2)) < w.max_depth) & alive,
        status=rollout.status,
        reward=compose(pen, moved, rest, alive, w),
        absolute=absolute_reward(pen, moved, rest, alive, w),
    )


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
