"""Reward terms of a user: import by path, and checks before and during a search."""

import importlib
import inspect
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..config import RefineOptions
from ..errors import ConfigError, choices
from ..physics.array_types import AnyArray
from ..physics.engine import RolloutStatus, record_steps, zero_duration_rollout
from ..physics.layout import Layout
from ..physics.model import SceneModel
from .rewards import Term

EXTRA_CANDIDATES = 5
"""Number of trial candidates in excess of the number of objects.

The population axis then differs in length from the object axis, so a term that confuses them fails.
"""


def named_terms(options: RefineOptions, taken: Collection[str]) -> list[Term]:
    """Return the terms of `refine.reward.terms`, given by import path.

    A term with the import path "package.module:function" gets the name of its function. If that
    name is taken, the name of the term is the whole path.

    Args:
        options: options that name terms.
        taken: names that a term cannot have.

    Raises:
        ConfigError: a path is malformed, does not name a function, or names a built-in term.
    """
    terms: list[Term] = []
    used = set(taken)
    for path, weight in options.reward.terms.items():
        if path in taken:
            raise ConfigError(
                f"refine.reward.terms: {path} is always included; its weight has a separate option"
            )
        fn = import_function("refine.reward.terms", path, {})
        function_name = path.partition(":")[2]
        terms.append(Term(path if function_name in used else function_name, fn, weight))
        used.add(terms[-1].name)
    return terms


def import_function(option: str, path: str, table: Mapping[str, Any]) -> Callable[..., Any]:
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
    form = f"write it as package.module:function{named}"
    if not (module and name):
        raise ConfigError(f"{option}: {path!r} is unknown; {form}")
    try:
        value = getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # Importing a module may raise anything.
        raise ConfigError(f"{option}: cannot import {path!r} ({error}); {form}") from None
    if not callable(value):
        raise ConfigError(f"{option}: {path!r} is not a function")
    return value


def try_terms(scene: SceneModel, terms: Iterable[Term], options: RefineOptions) -> None:
    """Call every term of a user once, before anything is simulated.

    Raises:
        ConfigError: a term is not a function, takes other arguments, raises an exception, or does
            not return one finite number per candidate. The message gives the function's location.
    """
    own = [term for term in terms if term.fn is not None]
    if not own:
        return
    layouts = Layout.zero(len(scene.names) + EXTRA_CANDIDATES, len(scene.names))
    r = options.rollout
    timestep = float(scene.static.mjm.opt.timestep)
    records = record_steps(timestep, r.duration_s, r.record_every_s)[0] if r.duration_s else 1
    motionless = zero_duration_rollout(scene, scene.place(layouts))
    motion = (motionless.pos, motionless.quat, motionless.joint_shift)
    rollout = eqx.tree_at(
        lambda s: (s.time, s.pos, s.quat, s.joint_shift),
        motionless,
        (0.1 * jnp.arange(1, records + 1), *(jnp.repeat(x, records, axis=1) for x in motion)),
    )
    for term in own:
        where = f"reward term {term.name} ({source(term.fn)})"
        if not callable(term.fn):
            raise ConfigError(f"{where} is not a function of (scene, layouts, rollout)")
        try:
            values = np.asarray(eqx.filter_jit(term.fn)(scene, layouts, rollout))
        except (Exception, SystemExit) as error:
            text = str(error).strip().split("\n")[0]
            raise ConfigError(
                f"{where} cannot be called with (scene, layouts, rollout): "
                f"{type(error).__name__}: {text}"
            ) from error
        pop = len(layouts.yaw)
        if not np.issubdtype(values.dtype, np.number) or values.shape != (pop,):
            got = f"{values.dtype} {list(values.shape)}" if values.ndim else f"a scalar ({values})"
            raise ConfigError(
                f"{where} must return one number per candidate, shape [pop], here [{pop}], "
                f"got {got}"
            )
        bad = ~np.isfinite(values)
        _refuse(term, values, bad, f"{len(bad)} candidates in which no object moves")


def refuse_not_finite(
    terms: Iterable[Term],
    values: Mapping[str, Float[AnyArray, " pop"]],
    status: Int[AnyArray, " pop"],
    iteration: str,
) -> None:
    """Reject a term of a user that is not finite for a candidate whose rollout has not failed.

    Args:
        terms: all terms.
        values: values of the terms for the candidates of an iteration, by name.
        status: status of the candidates' rollouts.
        iteration: name of the iteration in the error message.

    Raises:
        ConfigError: a term is not finite. The message names the term and the file and line of its
            function.
    """
    simulated = ~np.isin(status, (RolloutStatus.FAILED, RolloutStatus.TRUNCATED))
    for term in terms:
        if term.fn is not None:
            own = np.asarray(values[term.name])
            bad = simulated & ~np.isfinite(own)
            _refuse(term, own, bad, f"{len(bad)} candidates in {iteration}")


def _refuse(term: Term, values: np.ndarray, bad: np.ndarray, candidates: str) -> None:
    if bad.any():
        raise ConfigError(
            f"reward term {term.name} ({source(term.fn)}) is {values[bad][0]} for "
            f"{int(bad.sum())} of {candidates}: return a finite number for every candidate, for "
            "example by jnp.where"
        )


def source(fn: Any) -> str:
    """Return the location of a function as file:line, if Python knows it."""
    try:
        inner = inspect.unwrap(fn)
        inner = inner if inspect.isroutine(inner) or inspect.isclass(inner) else type(inner)
        return f"{inspect.getsourcefile(inner)}:{inspect.getsourcelines(inner)[1]}"
    except (TypeError, OSError, ValueError):
        return f"{getattr(fn, '__module__', None) or 'a built-in'}, no source file"
