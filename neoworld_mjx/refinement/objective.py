"""Objective of Step 5: the reward of a candidate, which is a sum of terms, and its validity."""

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
from ..physics.engine import Rollout, RolloutStatus, record_steps, zero_duration_rollout
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.placed import Placed
from ..physics.scene_arrays import SceneArrays
from ..physics.visibility import as_parsed
from .rewards import (
    Drift,
    Prior,
    Term,
    TermValue,
    drift_by_object,
    measured_rollout,
    penetration,
    semantics,
    source,
    symmetric_depth,
    term_value,
    try_term,
)

EXTRA_CANDIDATES = 5
"""Number of trial candidates in excess of the number of objects.

The population axis then differs in length from the object axis, so a term that confuses them fails.
"""


def sigma_of(options: RefineOptions) -> Float[np.ndarray, " 3"]:
    """Return the initial standard deviations of x and y, yaw and log scale.

    The value for x and y is a fraction of the object's diagonal; the value for yaw is in rad.
    """
    c = options.cem
    return np.array([c.sigma_xy, np.radians(c.sigma_yaw_deg), c.sigma_log_scale], np.float32)


TERMS: dict[str, Callable[[RefineOptions], Term]] = {
    "s_sem": lambda o: Term("s_sem", semantics, o.reward.w_sem, padded=True),
    "prior": lambda o: Term("prior", Prior(sigma_of(o)), -o.reward.w_prior, padded=True),
    "d_pen": lambda o: Term(
        "d_pen",
        penetration,
        -o.reward.w_pen,
        scale=o.max_depth_m,
        cap=o.reward.d_pen_cap_m,
        padded=True,
    ),
    "d_drift": lambda o: Term(
        "d_drift",
        Drift(o.max_drift_m, np.radians(o.max_tilt_deg), o.reward.drift_free),
        -o.reward.w_drift,
        scale=1.0,
        cap=o.reward.d_drift_cap,
        padded=True,
    ),
}
"""Factories of the built-in terms, by name. Every objective has these terms."""
PHYSICAL = ("d_pen", "d_drift")
"""Terms whose values the bounds of a valid candidate limit."""
RESERVED = (
    "reward",
    "absolute",
    "merit",
    "status",
    "valid",
    "xy",
    "yaw",
    "log_scale",
    "s_sem_from",
)
RESERVED += ("object_names", "term_names", "term_weights")
"""Keys of the history, which terms cannot have as names."""


class Objective(eqx.Module):
    """Reward terms and validity bounds. Their values are traced, so they can be swept by `vmap`."""

    terms: tuple[Term, ...]
    max_depth: Float[Array, ""]
    """Penetration depth of a pair [m] at which a candidate becomes invalid."""
    distance: Float[Array, ""]
    """Stability bound of an object's translation [m]."""
    angle: Float[Array, ""]
    """Stability bound of an object's rotation [rad]."""
    by_fidelity: Bool[Array, ""]
    """If True, the merit is the fidelity, else the absolute reward; see `Scores.merit`."""
    normalisation: str = eqx.field(static=True)
    """`fixed` or `iteration`; see `contribution`."""

    @property
    def padded(self) -> bool:
        """True if every term accepts a padded scene."""
        return all(term.padded for term in self.terms)


def open_objective(
    options: RefineOptions,
    origin: Layout | None = None,
    terms: Sequence[Term] = (),
) -> Objective:
    """Build the objective from options.

    Args:
        options: weights, scales, caps and bounds, and the names of further terms.
        origin: center of the prior. If None, it is the composed scene.
        terms: terms in addition to those that the options name.

    Raises:
        ConfigError: a term cannot be found, or the name of a term is already taken.
    """

    def scalar(x: float) -> Array:
        return jax.device_put(np.float32(x))

    all_terms = [term(options) for term in TERMS.values()] + named_terms(options) + list(terms)
    names = [term.name for term in all_terms]
    for name in names:
        if names.count(name) > 1 or name in RESERVED:
            raise ConfigError(f"reward term {name}: the name is taken; give the term another name")
    if origin is not None:
        for k, term in enumerate(all_terms):
            if isinstance(term.fn, Prior):
                all_terms[k] = dataclasses.replace(term, fn=Prior(term.fn.sigma, origin))
    return Objective(
        terms=tuple(all_terms),
        max_depth=scalar(options.max_depth_m),
        distance=scalar(options.max_drift_m),
        angle=scalar(np.radians(options.max_tilt_deg)),
        by_fidelity=jax.device_put(np.bool_(options.merit == "fidelity")),
        normalisation=options.reward.normalisation,
    )


def has_builtin_terms_only(objective: Objective) -> bool:
    """Return whether the objective has only the built-in terms.

    Any other term may reward moving an object that already rests.
    """
    return all(term.name in TERMS for term in objective.terms)


def named_terms(options: RefineOptions) -> list[Term]:
    """Return the terms of `refine.reward.terms`, given by import path.

    A term with the import path "package.module:function" gets the name of its function. If that
    name is taken, the name of the term is the whole path.

    Raises:
        ConfigError: a path is malformed, does not name a function, or names a built-in term.
    """
    terms: list[Term] = []
    taken = {*TERMS, *RESERVED}
    for path, weight in options.reward.terms.items():
        if path in TERMS:
            raise ConfigError(
                f"refine.reward.terms: {path} is always included; its weight has a separate option"
            )
        fn = import_function("refine.reward.terms", path, {})
        function_name = path.partition(":")[2]
        terms.append(Term(path if function_name in taken else function_name, fn, weight))
        taken.add(terms[-1].name)
    return terms


def import_function(option: str, path: str, table: dict[str, Any]) -> Callable[..., Any]:
    """Import the function that an option names as "package.module:function".

    A name of any other form is refused before anything is imported.

    Args:
        option: path of the option, which error messages name.
        path: value of the option.
        table: built-in objects by name, which error messages suggest.

    Raises:
        ConfigError: the path is malformed, or does not name a callable.
    """
    module, _, name = path.partition(":")
    named = f", or name a built-in one: {choices(path, table)}" if table else ""
    if not (module and name):
        raise ConfigError(
            f"{option}: {path!r} is unknown; write it as package.module:function{named}"
        )
    try:
        value = getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # Importing a module may raise anything.
        raise ConfigError(
            f"{option}: cannot import {path!r} ({error}); "
            f"write it as package.module:function{named}"
        ) from None
    if not callable(value):
        raise ConfigError(f"{option}: {path!r} is not a function")
    return value


def try_terms(scene: SceneModel, objective: Objective, options: RefineOptions) -> None:
    """Call every user-defined term once, before anything is simulated.

    Raises:
        ConfigError: a term is invalid; see `rewards.try_term`.
    """
    user_terms = [term for term in objective.terms if term.name not in TERMS]
    if not user_terms:
        return
    pop = len(scene.names) + EXTRA_CANDIDATES
    layouts = Layout.zero(pop, len(scene.names))
    r = options.rollout
    timestep = float(scene.static.mjm.opt.timestep)
    records = record_steps(timestep, r.duration_s, r.record_every_s)[0] if r.duration_s else 1
    motionless = still_rollout(scene, layouts, records)
    for term in user_terms:
        try_term(term, scene, motionless, layouts)


def refuse_not_finite(
    objective: Objective, scores: "Scores", status: Int[np.ndarray, " pop"], iteration: str
) -> None:
    """Reject a user-defined term that is not finite for a candidate whose rollout has not failed.

    Args:
        objective: the objective.
        scores: scores of an iteration's candidates.
        status: status of the candidates' rollouts.
        iteration: name of the iteration in the error message.

    Raises:
        ConfigError: a term is not finite. The message names the term and the file and line of its
            function.
    """
    simulated = ~np.isin(status, (RolloutStatus.FAILED, RolloutStatus.TRUNCATED))
    for term in objective.terms:
        values = np.asarray(scores.terms[term.name])
        bad = simulated & ~np.isfinite(values)
        if term.name not in TERMS and bad.any():
            raise ConfigError(
                f"reward term {term.name} ({source(term.fn)}) is {values[bad][0]} for "
                f"{int(bad.sum())} of {len(bad)} candidates in {iteration}: return a finite "
                "number for every candidate, for example by jnp.where"
            )


def still_rollout(scene: SceneArrays, layouts: Layout, records: int) -> Rollout:
    """Return a rollout without motion or penetration, in which every object looks as parsed."""
    motionless = zero_duration_rollout(scene, scene.place(layouts))
    motion = (motionless.pos, motionless.quat, motionless.joint_shift)
    motionless = eqx.tree_at(
        lambda s: (s.time, s.pos, s.quat, s.joint_shift),
        motionless,
        (0.1 * jnp.arange(1, records + 1), *(jnp.repeat(x, records, axis=1) for x in motion)),
    )
    zero_depth = jnp.zeros((*layouts.yaw.shape, layouts.yaw.shape[1]))
    visible = as_parsed(scene.photo, len(zero_depth))
    return measured_rollout(motionless, zero_depth, visible, jnp.zeros(layouts.yaw.shape))


class Scores(eqx.Module):
    """Term values, rewards and validity of an iteration's candidates."""

    terms: Mapping[str, Float[AnyArray, " pop"]]
    """Value of every term, by name."""
    valid: Bool[AnyArray, " pop"]
    """True if all objects rest; see `rested`."""
    status: Int[AnyArray, " pop"]
    """RolloutStatus of each candidate. It is FAILED also if a term is not finite."""
    reward: Float[AnyArray, " pop"]
    """Reward by which Algorithm 1 ranks candidates; -inf for failed candidates."""
    absolute: Float[AnyArray, " pop"]
    """Reward with fixed scales, comparable between iterations; -inf for failed candidates."""
    merit: Float[AnyArray, " pop"]
    """Value that ranks valid candidates; -inf for failed candidates.

    The option `refine.merit` selects the absolute reward or the fidelity. The fidelity is the
    absolute reward without D_pen and D_drift, whose values the validity bounds limit, minus a cost
    of the displacement by settling.
    """
    drift: Float[AnyArray, "pop object"]
    """Largest drift of each object, in units of the stability bounds.

    The drift of an object is at least its displacement by settling, in units of the bounds of
    `settling_displacement`.
    """
    depth: Float[AnyArray, "pop object"]
    """Largest penetration depth of each object [m]."""
    rested: Bool[AnyArray, "pop object"]
    """True for objects that rest: penetration and drift are below the validity bounds."""
    credit: Float[AnyArray, "pop object"] | None
    """Reward of each object, with `fixed` normalization; None if a term has no values by object."""


@eqx.filter_jit
def evaluate(
    scene: SceneArrays,
    layouts: Layout,
    candidates: Placed,
    rollout: Rollout,
    objective: Objective,
    s_sem: Float[AnyArray, " pop"] | None = None,
) -> Scores:
    """Evaluate every term for every candidate, and sum the terms to the reward.

    Args:
        scene: the scene's arrays.
        layouts: the candidates.
        candidates: poses of the candidates, settled if settling is enabled, with their measures.
        rollout: rollout of the candidates from these poses.
        objective: terms and bounds.
        s_sem: S_sem by a model, which replaces the geometric S_sem.
    """
    measured = measured_rollout(rollout, candidates.depth, candidates.visible, candidates.settled)
    values = {
        term.name: term_value(term, term.fn, scene, layouts, measured) for term in objective.terms
    }
    if s_sem is not None:
        score = jnp.asarray(s_sem, jnp.float32)
        values["s_sem"] = TermValue(score, score)
    failed = jnp.array([int(RolloutStatus.FAILED), int(RolloutStatus.TRUNCATED)])
    finite = jnp.isfinite(sum(value.value + value.reward_value for value in values.values()))
    alive = ~jnp.isin(rollout.status, failed) & finite
    drift = drift_by_object(scene, rollout, objective.distance, objective.angle)
    drift = jnp.maximum(drift, candidates.settled)
    deepest = jnp.max(symmetric_depth(candidates.depth), axis=2)

    def total(contribute: Callable[[Term, AnyArray], AnyArray]) -> Any:
        return sum(contribute(term, values[term.name].reward_value) for term in objective.terms)

    fidelity = sum(
        absolute_contribution(term, values[term.name].reward_value)
        for term in objective.terms
        if term.name not in PHYSICAL
    )
    # An object that settles away from its layout agrees less with the photograph.
    settled = jnp.sum(candidates.settled, axis=1)
    fidelity += sum(
        absolute_contribution(term, settled) for term in objective.terms if term.name == "d_drift"
    )
    absolute = total(absolute_contribution)
    reward = total(lambda t, x: contribution(t, x, alive, objective.normalisation))
    object_values = [
        contribution(term, share, alive[:, None], "fixed")
        for term in objective.terms
        if (share := values[term.name].by_object) is not None
    ]
    credit = None
    if len(object_values) == len(objective.terms):
        credit = jnp.where(alive[:, None], sum(object_values), -jnp.inf)
    rested = (drift < 1.0) & (deepest < objective.max_depth) & alive[:, None]
    return Scores(
        terms={name: value.value for name, value in values.items()},
        valid=jnp.all(rested, axis=1),
        status=jnp.where(
            finite | (rollout.status == int(RolloutStatus.TRUNCATED)),
            rollout.status,
            int(RolloutStatus.FAILED),
        ),
        reward=jnp.where(alive, reward, -jnp.inf),
        absolute=jnp.where(alive, absolute, -jnp.inf),
        merit=jnp.where(alive, jnp.where(objective.by_fidelity, fidelity, absolute), -jnp.inf),
        drift=drift,
        depth=deepest,
        rested=rested,
        credit=credit,
    )


def contribution(term: Term, value: AnyArray, alive: Array, normalisation: str) -> Array:
    """Return the contribution of a term to the reward: its weight times its normalized value.

    - `fixed` normalizes a value to min(value / cap, 1).
    - `iteration` clips the values at the cap, and then maps their range over the candidates of this
      iteration to [0, 1], as in the paper. A term that has the same value for all candidates
      contributes zero.

    A term without a cap is not normalized.

    Args:
        term: the term.
        value: values of the term; shape [pop], or [pop, object] for values of each object.
        alive: mask of the candidates that did not fail. Only these determine the range.
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
    """Return the contribution of a term to the absolute reward, comparable between iterations.

    The value is normalized to value / (value + scale), which is 1/2 at the scale and never
    saturates. A term without a scale is not normalized.
    """
    return term.weight * (value if term.scale is None else value / (value + term.scale))
