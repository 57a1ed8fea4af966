"""The objective of Step 5: the reward of its terms, and what makes a candidate valid."""

import dataclasses
import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..config import RefineOptions
from ..errors import ConfigError, choices
from ..physics.array_types import AnyArray
from ..physics.engine import Rollout, RolloutStatus, record_steps, unmoved
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..physics.placed import Placed, placed
from ..physics.scene_arrays import SceneArrays
from ..physics.visibility import Visible, as_parsed
from .rewards import (
    Drift,
    Prior,
    Term,
    TermValue,
    deeper,
    drift_by_object,
    measured_rollout,
    no_drift,
    penetration,
    semantics,
    term_value,
    try_term,
)
from .semantic import box_error

EXTRA_CANDIDATES = 5
"""Candidates beyond the number of objects on which a user's term is tried, for distinct shapes."""


def sigma_of(options: RefineOptions) -> Float[np.ndarray, " 3"]:
    """Return the initial deviations of xy (over diagonals), yaw [rad] and log scale."""
    c = options.cem
    return np.array([c.sigma_xy, np.radians(c.sigma_yaw_deg), c.sigma_log_scale], np.float32)


TERMS: dict[str, Callable[[RefineOptions], Term]] = {
    "s_sem": lambda o: Term("s_sem", semantics, o.reward.w_sem, bound="exact", padded=True),
    "prior": lambda o: Term(
        "prior", Prior(sigma_of(o)), -o.reward.w_prior, bound="exact", padded=True
    ),
    "d_pen": lambda o: Term(
        "d_pen",
        penetration,
        -o.reward.w_pen,
        scale=o.reward.pen_scale_m,
        cap=o.reward.d_pen_cap_m,
        bound="exact",
        padded=True,
    ),
    "d_drift": lambda o: Term(
        "d_drift",
        Drift(o.reward.drift_scale_m, np.radians(o.reward.tilt_scale_deg), o.reward.drift_free),
        -o.reward.w_drift,
        scale=1.0,
        cap=o.reward.d_drift_cap,
        bound=no_drift,
        padded=True,
    ),
}
"""The built-in terms. Those of ALWAYS have options of their own; another one is used when
`refine.reward.terms` names it, with the weight given there."""
ALWAYS = ("s_sem", "prior", "d_pen", "d_drift")
PHYSICAL = ("d_pen", "d_drift")
"""Terms that a valid candidate holds by its bounds."""
RESERVED = ("reward", "absolute", "status", "valid", "xy", "yaw", "log_scale", "s_sem_from")
RESERVED += ("object_names", "term_names", "term_weights")
"""Keys of the history that no term may have as its name."""


class Objective(eqx.Module):
    """What candidates are judged by; numbers are traced, so a sweep over them is one `vmap`."""

    terms: tuple[Term, ...]
    max_depth: Float[Array, ""]
    """Depth of a pair [m] from which a candidate is invalid."""
    distance: Float[Array, ""]
    """Stability bound of an object's translation [m]."""
    angle: Float[Array, ""]
    """Stability bound of its rotation [rad]."""
    normalisation: str = eqx.field(static=True)
    """`fixed` or `iteration`; see `contribution`."""

    @property
    def bounded(self) -> "Objective":
        """The same with only the terms that have a bound; all that `place` needs."""
        bounded = tuple(term for term in self.terms if term.bound is not None)
        return dataclasses.replace(self, terms=bounded)

    @property
    def padded(self) -> bool:
        """Whether every term takes a padded scene."""
        return all(term.padded for term in self.terms)

    @property
    def unbounded(self) -> tuple[str, ...]:
        """Names of the terms without a bound, which switch pruning off."""
        return tuple(term.name for term in self.terms if term.bound is None)


def open_objective(
    options: RefineOptions,
    origin: Layout | None = None,
    terms: Sequence[Term] = (),
    share: Float[AnyArray, " object"] | None = None,
) -> Objective:
    """Build the objective from options.

    Args:
        options: weights, scales, caps and bounds, and the names of further terms.
        origin: initial layout that the prior counts from; None is the composed scene.
        terms: further terms, besides those that the options name.
        share: of the prior's deviations of yaw and log scale, by object; None is 1.

    Raises:
        ConfigError: a term cannot be found, or two have the same name.
    """
    f = lambda x: jax.device_put(np.float32(x))
    every = [TERMS[name](options) for name in ALWAYS] + named_terms(options) + list(terms)
    names = [term.name for term in every]
    for name in names:
        if names.count(name) > 1 or name in RESERVED:
            raise ConfigError(f"reward term {name}: the name is taken; give the term another one")
    if origin is not None:
        every = [
            dataclasses.replace(t, fn=Prior(t.fn.sigma, origin, share))
            if isinstance(t.fn, Prior)
            else t
            for t in every
        ]
    return Objective(
        terms=tuple(every),
        max_depth=f(options.max_depth_m),
        distance=f(options.reward.drift_scale_m),
        angle=f(np.radians(options.reward.tilt_scale_deg)),
        normalisation=options.reward.normalisation,
    )


def has_builtin_terms_only(objective: Objective) -> bool:
    """Tell whether all terms speak of the photograph and of physics.

    A user's own may want what stands soundly to move.
    """
    return all(term.name in ALWAYS for term in objective.terms)


def named_terms(options: RefineOptions) -> list[Term]:
    """Find the terms of `refine.reward.terms`: built-in ones by name, others by import path.

    A term of an import path "package.module:function" is called by its function's name, or by the
    whole path where that name is taken.

    Raises:
        ConfigError: a name is unknown, or a path has no such form or names no function.
    """
    terms: list[Term] = []
    taken = {*TERMS, *RESERVED}
    for path, weight in options.reward.terms.items():
        if path in ALWAYS:
            raise ConfigError(
                f"refine.reward.terms: {path} is always there; weigh it by its option"
            )
        if path in TERMS:
            terms.append(eqx.tree_at(lambda t: t.weight, TERMS[path](options), jnp.float32(weight)))
            continue
        fn = imported(
            "refine.reward.terms", path, {n: t for n, t in TERMS.items() if n not in ALWAYS}
        )
        own = path.partition(":")[2]
        terms.append(Term(path if own in taken else own, fn, weight))
        taken.add(terms[-1].name)
    return terms


def imported(option: str, path: str, table: dict[str, Any]) -> Callable[..., Any]:
    """Import what an option names as "package.module:function".

    Args:
        option: its path, for messages.
        path: its value.
        table: names that need no import.

    Raises:
        ConfigError: the path has no such form, or nothing callable is there.
    """
    module, _, name = path.partition(":")
    try:
        value = getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # A module may do anything while it is imported.
        named = f", or name a built-in one: {choices(path, table)}" if table else ""
        raise ConfigError(
            f"{option}: cannot import {path!r} ({error}); "
            f"write it as package.module:function{named}"
        ) from None
    if not callable(value):
        raise ConfigError(f"{option}: {path!r} is not a function")
    return value


def try_terms(scene: SceneModel, objective: Objective, options: RefineOptions) -> None:
    """Try every term that is not built in, once, before anything is simulated.

    Raises:
        ConfigError: see `rewards.try_term`.
    """
    own = [term for term in objective.terms if term.name not in TERMS]
    if not own:
        return
    pop = len(scene.names) + EXTRA_CANDIDATES
    layouts = Layout.zero(pop, len(scene.names))
    r = options.rollout
    timestep = float(scene.static.mjm.opt.timestep)
    records = record_steps(timestep, r.duration_s, r.record_every_s)[0] if r.duration_s else 1
    still = still_rollout(scene, layouts, records)
    for term in own:
        try_term(term, scene, still, layouts)


def still_rollout(scene: SceneArrays, layouts: Layout, records: int) -> Rollout:
    """Return a rollout in which nothing moves, with what terms share: all is as in the photo."""
    still = unmoved(scene, scene.place(layouts))
    over_time = lambda x: jnp.repeat(x, records, axis=1)
    still = eqx.tree_at(
        lambda s: (s.time, s.pos, s.quat, s.joint_shift),
        still,
        (
            0.1 * jnp.arange(1, records + 1),
            over_time(still.pos),
            over_time(still.quat),
            over_time(still.joint_shift),
        ),
    )
    none = jnp.zeros((*layouts.yaw.shape, layouts.yaw.shape[1]))
    seen = as_parsed(scene.photo, len(none))
    return measured_rollout(still, none, seen, jnp.zeros(layouts.yaw.shape))


class Placement(eqx.Module):
    """Candidates where their layouts put them, and what is known of them before physics."""

    poses: Poses
    depth: Float[AnyArray, "pop object object"]
    """Of `pair_depths` [m]."""
    visible: Visible
    """What the camera sees."""
    values: dict[str, TermValue]
    """Of the terms that do not depend on physics."""
    bound: Float[AnyArray, " pop"]
    """Upper bound of the reward under `fixed` normalisation; -inf where it is not finite."""
    box_error: Float[AnyArray, "pop object"]
    """How far each object's box is off the photograph's, in units of the noise; see `semantic`."""
    settled: Float[AnyArray, "pop object"]
    """Of `Placed`."""


class Scores(eqx.Module):
    """What an iteration's candidates are judged by."""

    terms: Mapping[str, Float[AnyArray, " pop"]]
    """Every term's value by name; NaN for terms of candidates that were not rolled out."""
    valid: Bool[AnyArray, " pop"]
    """No pair deeper than max_depth, no object past the stability bounds."""
    status: Int[AnyArray, " pop"]
    """RolloutStatus; FAILED also where a term is not finite."""
    reward: Float[AnyArray, " pop"]
    """As Algorithm 1 ranks; -inf for failed and pruned candidates."""
    absolute: Float[AnyArray, " pop"]
    """With fixed scales, comparable between iterations; -inf for failed and pruned candidates."""
    fidelity: Float[AnyArray, " pop"]
    """The absolute reward without D_pen and D_drift, which a valid candidate holds by its bounds,
    but less for how far it has settled; -inf for failed and pruned candidates."""
    drift: Float[AnyArray, "pop object"]
    """Each object's largest drift in units of the stability bounds; NaN where pruned."""
    depth: Float[AnyArray, "pop object"]
    """Each object's deepest pair [m]; NaN where pruned."""
    credit: Float[AnyArray, "pop object"] | None
    """The reward by objects, with fixed normalisation; None where a term has no such share."""


@eqx.filter_jit
def place(
    scene: SceneArrays, layouts: Layout, objective: Objective, known: Placed | None = None
) -> Placement:
    """Place candidates, and evaluate terms that need no physics and the bounds of the others.

    Args:
        scene: the scene's arrays.
        layouts: the candidates.
        objective: terms and bounds.
        known: the candidates as `placed` has placed them, where it has.
    """
    at = placed(scene, layouts) if known is None else known
    still = measured_rollout(unmoved(scene, at.poses), at.depth, at.visible, at.settled)
    values, bounds = {}, {}
    for term in objective.terms:
        if term.bound == "exact":
            values[term.name] = term_value(term, term.fn, scene, layouts, still)
        elif term.bound is not None:
            bounds[term.name] = term_value(term, term.bound, scene, layouts, still)
    every = jnp.ones(layouts.yaw.shape[0], bool)
    upper = sum(
        contribution(term, (values | bounds)[term.name].charged, every, "fixed")
        for term in objective.terms
        if term.bound is not None
    )
    upper = jnp.where(jnp.isfinite(upper), upper, -jnp.inf)
    error = box_error(scene, at.visible.outlines)
    return Placement(at.poses, at.depth, at.visible, values, upper, error, at.settled)


@eqx.filter_jit
def evaluate(
    scene: SceneArrays,
    layouts: Layout,
    placement: Placement,
    rollout: Rollout,
    objective: Objective,
) -> Scores:
    """Evaluate every term of every candidate, and compose the reward.

    Args:
        scene: the scene's arrays.
        layouts: the candidates.
        placement: of `place`.
        rollout: their free fall.
        objective: terms and bounds.
    """
    measured = measured_rollout(rollout, placement.depth, placement.visible, placement.settled)
    values = {
        term.name: placement.values[term.name]
        if term.bound == "exact"
        else term_value(term, term.fn, scene, layouts, measured)
        for term in objective.terms
    }
    failed = jnp.array([int(RolloutStatus.FAILED), int(RolloutStatus.TRUNCATED)])
    alive = ~jnp.isin(rollout.status, failed)
    finite = jnp.isfinite(sum(value.value + value.charged for value in values.values()))
    alive &= finite
    drift = drift_by_object(scene, rollout, objective.distance, objective.angle)
    drift = jnp.maximum(drift, placement.settled)
    deepest = jnp.max(deeper(placement.depth), axis=2)
    total = lambda part: sum(part(term, values[term.name].charged) for term in objective.terms)
    fidelity = sum(
        absolute_contribution(term, values[term.name].charged)
        for term in objective.terms
        if term.name not in PHYSICAL
    )
    # Where they came to rest otherwise than the photograph shows them, candidates are less like it.
    settled = jnp.sum(placement.settled, axis=1)
    fidelity += sum(
        absolute_contribution(term, settled) for term in objective.terms if term.name == "d_drift"
    )
    reward = total(lambda t, x: contribution(t, x, alive, objective.normalisation))
    shares = [
        contribution(term, share, alive[:, None], "fixed")
        for term in objective.terms
        if (share := values[term.name].by_object) is not None
    ]
    credit = None
    if len(shares) == len(objective.terms):
        credit = jnp.where(alive[:, None], sum(shares), -jnp.inf)
    return Scores(
        terms={name: value.value for name, value in values.items()},
        valid=jnp.all((drift < 1.0) & (deepest < objective.max_depth), axis=1) & alive,
        status=jnp.where(
            finite | (rollout.status == int(RolloutStatus.TRUNCATED)),
            rollout.status,
            int(RolloutStatus.FAILED),
        ),
        reward=jnp.where(alive, reward, -jnp.inf),
        absolute=jnp.where(alive, total(absolute_contribution), -jnp.inf),
        fidelity=jnp.where(alive, fidelity, -jnp.inf),
        drift=drift,
        depth=deepest,
        credit=credit,
    )


def contribution(term: Term, value: AnyArray, alive: Array, normalisation: str) -> Array:
    """Return what a term adds to the reward: its weight times its normalised value.

    `fixed` is min(value / cap, 1). `iteration` maps the term's range over this iteration's
    candidates to [0, 1], after clipping at the cap (as the paper does; a term with the same value
    for all candidates counts zero). A term without a cap counts as it is.

    Args:
        term: the term.
        value: of the candidates [pop], or by objects [pop, object].
        alive: candidates that did not fail; only these set the range.
        normalisation: `fixed` or `iteration`.
    """
    if term.cap is None:
        return term.weight * value
    clipped = jnp.minimum(jnp.where(alive, value, term.cap), term.cap)
    if normalisation == "fixed":
        return term.weight * (clipped / term.cap)
    low = jnp.min(jnp.where(alive, clipped, term.cap))
    spread = jnp.max(jnp.where(alive, clipped, 0.0)) - low
    unit = jnp.where(spread > 1e-12, (clipped - low) / jnp.maximum(spread, 1e-12), 0.0)
    return term.weight * unit


def absolute_contribution(term: Term, value: Float[AnyArray, " pop"]) -> Float[AnyArray, " pop"]:
    """Return what a term adds to the absolute reward, which compares iterations.

    value / (value + scale) never saturates: half the weight is lost at the scale. A term without a
    scale counts as it is.
    """
    return term.weight * (value if term.scale is None else value / (value + term.scale))
