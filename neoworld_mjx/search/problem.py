"""What a search maximizes and how it samples, as one pytree that is built from options."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from ..config import RefineOptions
from ..errors import ConfigError
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays, on_device
from .cem import initial_sigma
from .optimizer import Optimizer, optimizer_factory
from .rewards import Term
from .user_terms import named_terms

TERMS: dict[str, Callable[[RefineOptions], Term]] = {
    "s_sem": lambda o: Term("s_sem", None, o.reward.w_sem),
    "prior": lambda o: Term("prior", None, -o.reward.w_prior),
    "d_pen": lambda o: Term("d_pen", None, -o.reward.w_pen, o.reward.d_pen_scale_m),
    "d_drift": lambda o: Term("d_drift", None, -o.reward.w_drift, o.reward.d_drift_scale),
}
"""Factories of the built-in terms, by name. Every problem has these terms, whose values
`algorithm.evaluate` computes."""
RESERVED = ("reward", "status", "valid", "xy", "yaw", "log_scale", "s_sem_from")
RESERVED += ("object_names", "term_names", "term_weights")
"""Keys of the history, which terms cannot have as names."""


class Problem(eqx.Module):
    """Constants of a run; its arrays are traced, so problems can be batched.

    The scene is not part of a problem, but a separate argument of `evaluate`. Many runs can
    therefore share the arrays of one scene.
    """

    terms: tuple[Term, ...]
    """Terms of the reward R(z), whose weighted sum it is."""
    optimizer: Optimizer
    origin: Layout
    """Initial layout, with a population axis of length 1."""
    sigma: Layout
    """Initial standard deviations, the units of the prior, with a population axis of length 1."""
    max_depth: Float[Array, ""]
    """Penetration depth of a pair [m] at which a candidate becomes invalid."""
    distance: Float[Array, ""]
    """Stability bound of an object's translation [m]."""
    angle: Float[Array, ""]
    """Stability bound of an object's rotation [rad]."""
    stop_by_best: Bool[Array, ""]
    """Quantity that is tested for convergence: if True, the reward of the best valid candidate; if
    False, the mean reward of the elites."""
    stop_gain: Float[Array, ""]
    """Gain of this quantity below which a run has converged; 0 runs all iterations."""
    elite_ratio: float = eqx.field(static=True)
    """Fraction of the candidates that are elites."""
    by_iteration: bool = eqx.field(static=True)
    """If True, elites are selected by `algorithm.normalized_reward`."""


def open_terms(options: RefineOptions, terms: Sequence[Term] = ()) -> tuple[Term, ...]:
    """Return the built-in terms, those that the options name, and further ones.

    Raises:
        ConfigError: a term cannot be found, or the name of a term is already taken.
    """
    built_in = [term(options) for term in TERMS.values()]
    every = (*built_in, *named_terms(options, (*TERMS, *RESERVED)), *terms)
    names = [term.name for term in every]
    for name in names:
        if names.count(name) > 1 or name in RESERVED:
            raise ConfigError(f"reward term {name}: the name is taken; give the term another name")
    return every


def open_problem(
    scene: SceneArrays,
    options: RefineOptions,
    origin: Layout | None = None,
    *,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
) -> Problem:
    """Build the problem of a run from options.

    Args:
        scene: the scene's arrays.
        options: options of the search and the rewards.
        origin: initial layout, with a population axis of length 1. If None, the search starts at
            the composed scene.
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name.

    Raises:
        ConfigError: an option names something that does not exist, or the name of a term is taken.
    """
    o, c = options, options.cem
    scalars = {
        "max_depth": np.float32(o.max_depth_m),
        "distance": np.float32(o.max_drift_m),
        "angle": np.float32(np.radians(o.max_tilt_deg)),
        "stop_by_best": np.bool_(c.stop_by == "best"),
        "stop_gain": np.float32(c.stop_gain),
    }
    return Problem(
        terms=open_terms(o, terms),
        optimizer=optimizer or optimizer_factory(o.optimizer)(scene, c),
        origin=Layout.zero(1, scene.count) if origin is None else origin,
        sigma=initial_sigma(scene, c),
        **on_device(scalars),
        elite_ratio=c.elite_ratio,
        by_iteration=o.reward.normalisation == "iteration",
    )


def stack(rows: Sequence[Any]) -> Any:
    """Stack the arrays of pytrees, such as problems or states, on a new leading axis.

    Leaves that are not arrays, such as the functions of terms, are taken from the first tree.
    Arrays are stacked on the host, so each stacked array is transferred to the device once.

    Raises:
        ValueError: the trees differ in structure, for example because a static option differs.
    """
    structure = jax.tree.structure(rows[0])
    if any(jax.tree.structure(row) != structure for row in rows[1:]):
        raise ValueError("stack: the trees differ in structure, for example in a static option")
    arrays, rest = zip(*(eqx.partition(row, eqx.is_array) for row in rows), strict=True)
    return eqx.combine(jax.tree.map(lambda *x: np.stack(x), *arrays), rest[0])
