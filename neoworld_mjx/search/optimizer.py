"""Protocol of the optimizers that Algorithm 1 can use, the built-in ones, and those of evosax.

evosax (Lange, arXiv:2212.04180) is installed by the extra `baselines`.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Key

from ..config import CEMOptions
from ..errors import ConfigError, EngineError, choices
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays
from .cem import draw, initial_sigma, open_cem
from .user_terms import import_function


@runtime_checkable
class Optimizer(Protocol):
    """Search distribution over layouts that is fitted to rewards.

    All methods must be pure functions that JAX can trace.
    """

    def init(self, mean: Layout) -> Any:
        """Return the initial state for a mean layout, whose population axis has length 1."""
        ...

    def ask(self, key: Key[Array, ""], state: Any, population: int) -> Layout:
        """Sample a population; `key` must not be used again."""
        ...

    def tell(
        self,
        state: Any,
        layouts: Layout,
        reward: Float[AnyArray, " pop"],
        *,
        key: Key[Array, ""],
        rests: Bool[AnyArray, "pop object"],
    ) -> Any:
        """Return the state updated with an evaluated population.

        Args:
            state: previous state.
            layouts: the evaluated candidates.
            reward: reward of the candidates; -inf for failed candidates. It is comparable between
                populations, unless `refine.reward.normalisation` is `iteration`.
            key: key with which `ask` sampled the population.
            rests: mask of the objects that rest in each candidate.
        """
        ...


class RandomSearch(eqx.Module):
    """Optimizer that samples every population from the initial Gaussian."""

    sigma: Layout
    """Standard deviations, with a population axis of length 1."""

    def init(self, mean: Layout) -> Layout:
        """Return the mean layout, which is also the state."""
        return mean

    def ask(self, key: Key[Array, ""], state: Layout, population: int) -> Layout:
        """Sample a population; `key` must not be used again."""
        return draw(key, state, self.sigma, population)

    def tell(self, state: Layout, layouts: Layout, reward: AnyArray, **_: Any) -> Layout:
        """Return the state unchanged."""
        return state


def _open_random(scene: SceneArrays, options: CEMOptions) -> RandomSearch:
    return RandomSearch(initial_sigma(scene, options))


class EvosaxOptimizer(eqx.Module):
    """A distribution-based strategy of evosax.

    It searches the free layout variables, in units of their initial standard deviations. Its state
    is the initial layout and the state of evosax.
    """

    strategy: Any = eqx.field(static=True)
    params: Any
    sigma: Layout
    """Initial standard deviations, with a population axis of length 1."""
    free: tuple[int, ...] = eqx.field(static=True)
    """Indices in a flattened layout of the variables whose standard deviation is positive."""

    def init(self, mean: Layout) -> tuple[Layout, Any]:
        """Return the initial state."""
        return mean, self.strategy.init(jax.random.key(0), jnp.zeros(len(self.free)), self.params)

    def ask(self, key: Key[Array, ""], state: tuple[Layout, Any], population: int) -> Layout:
        """Sample a population of `refine.cem.population` candidates; see `tell` for `key`."""
        free, mean = jnp.asarray(self.free), state[0]
        samples, _ = self.strategy.ask(key, state[1], self.params)
        flat = jnp.repeat(_flat(mean), population, axis=0)
        flat = flat.at[:, free].add(samples * _flat(self.sigma)[:, free])
        return jax.vmap(ravel_pytree(jax.tree.map(lambda leaf: leaf[0], mean))[1])(flat)

    def tell(
        self,
        state: tuple[Layout, Any],
        layouts: Layout,
        reward: Float[AnyArray, " pop"],
        *,
        key: Key[Array, ""],
        **_: Any,
    ) -> tuple[Layout, Any]:
        """Return the updated state.

        Failed candidates count as worse than all others. The key must be that of `ask`, which
        changes the state of evosax, too.
        """
        (mean, inner), free = state, jnp.asarray(self.free)
        unit = (_flat(layouts) - _flat(mean))[:, free] / _flat(self.sigma)[:, free]
        finite = jnp.isfinite(reward)
        worst = jnp.max(jnp.where(finite, -reward, -jnp.inf))
        loss = jnp.where(finite, -reward, jnp.where(jnp.isfinite(worst), worst + 1.0, 0.0))
        _, inner = self.strategy.ask(key, inner, self.params)
        next_key = jax.random.fold_in(key, 1)
        return mean, self.strategy.tell(next_key, unit, loss, inner, self.params)[0]


def from_evosax(
    strategy: str | type, scene: SceneArrays, options: CEMOptions, **parameters: float
) -> EvosaxOptimizer:
    """Build an optimizer from a strategy of evosax, for `refine(scene, optimizer=...)`.

    Args:
        strategy: a distribution-based strategy of evosax: a class, or its name such as "SNES".
        scene: the scene's arrays.
        options: options that give the population size and the initial standard deviations.
        parameters: parameters of the strategy by their names in evosax, such as `std_init`.

    Raises:
        ConfigError: the strategy or a parameter does not exist, or the strategy cannot search the
            scene.
        EngineError: evosax is not installed.
    """
    cls = strategy_class(strategy) if isinstance(strategy, str) else strategy
    sigma = initial_sigma(scene, options)
    free = tuple(int(k) for k in np.flatnonzero(np.asarray(_flat(sigma))[0] > 0))
    try:
        es = _build(cls, options.population, len(free))
        params = jax.tree.map(jnp.asarray, es.default_params.replace(**parameters))
        built = EvosaxOptimizer(es, params, sigma, free)
        jax.eval_shape(built.init, Layout.zero(1, scene.count))
    except (AssertionError, TypeError, ValueError) as error:
        raise ConfigError(
            f"the strategy {cls.__name__} cannot search {len(free)} variables with "
            f"refine.cem.population {options.population}: {str(error).partition(chr(10))[0]}"
        ) from None
    return built


def strategy_class(name: str) -> Any:
    """Return the class of a distribution-based strategy of evosax; errors as in `from_evosax`."""
    try:
        from evosax.algorithms import algorithms
        from evosax.algorithms.distribution_based.base import DistributionBasedAlgorithm
    except ImportError:
        raise EngineError(
            "refine.optimizer: evosax:STRATEGY needs evosax: uv sync --inexact --extra baselines"
        ) from None
    known = {k: c for k, c in algorithms.items() if issubclass(c, DistributionBasedAlgorithm)}
    if name not in known:
        raise ConfigError(f"refine.optimizer: evosax: {choices(name, known)}")
    return known[name]


@cache
def _build(cls: Any, population: int, variables: int) -> Any:
    """Return the strategy object; equal arguments give the same object, which JAX compiles once."""
    with jax.ensure_compile_time_eval():  # The cached object outlives any trace.
        return cls(population, np.zeros(variables, np.float32))


def _flat(layout: Layout) -> Float[Array, "pop variable"]:
    return jax.vmap(lambda candidate: ravel_pytree(candidate)[0])(layout)


OPTIMIZERS: dict[str, Callable[[SceneArrays, CEMOptions], Optimizer]] = {
    "cem": open_cem,
    "random": _open_random,
}
"""Factories of the built-in optimizers, by their names in `refine.optimizer`.

The arguments of a factory are the scene and the options `refine.cem`.
"""


def optimizer_factory(name: str) -> Callable[[SceneArrays, CEMOptions], Optimizer]:
    """Return the factory of an optimizer.

    Args:
        name: a key of OPTIMIZERS, evosax:STRATEGY, or the import path "package.module:function" of
            a factory.

    Raises:
        ConfigError: the optimizer does not exist.
        EngineError: evosax is needed, but not installed.
    """
    package, _, strategy = name.partition(":")
    if package == "evosax":
        return partial(from_evosax, strategy_class(strategy))
    return OPTIMIZERS.get(name) or import_function("refine.optimizer", name, OPTIMIZERS)
