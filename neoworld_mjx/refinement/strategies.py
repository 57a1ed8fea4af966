"""The strategies of evosax (Lange, arXiv:2212.04180) as optimizers of Algorithm 1.

`refine.optimizer: evosax:SNES` selects the strategy SNES; `refine.strategy` sets its parameters.
evosax is installed by the extra `baselines`.
"""

import functools
import inspect
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from ..config import CEMOptions
from ..errors import ConfigError, EngineError, choices
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays
from .cem import initial_sigma

EVOSAX = "evosax"
LEARNING_RATE = "learning_rate"
"""Parameter of strategies that use a gradient optimizer: the learning rate of Adam."""
RESTART = "restart_spread"
"""Parameter of distribution-based strategies.

A strategy restarts from the initial layout if the absolute rewards of a population differ by less
than this value.
"""


class StrategyState(NamedTuple):
    """State of a strategy."""

    mean: Layout
    """Initial layout, with a population axis of length 1."""
    inner: Any
    """State of evosax."""
    started: Bool[Array, ""]
    """True after the first population, which initializes a population-based strategy."""


class Strategy(eqx.Module):
    """An evosax strategy over the free layout variables, in units of their standard deviations."""

    name: str = eqx.field(static=True)
    """Name of the strategy in evosax."""
    population: int = eqx.field(static=True)
    sigma: Layout
    """Initial standard deviations, with a population axis of length 1."""
    params: Any
    """Parameters of evosax."""
    free: tuple[int, ...] = eqx.field(static=True)
    """Indices in a flattened layout of the variables whose standard deviation is positive."""
    learning_rate: float | None = eqx.field(static=True, default=None)
    """See LEARNING_RATE; None if the strategy does not use it or uses its default."""
    restart_spread: float | None = eqx.field(static=True, default=None)
    """See RESTART. If None, the strategy does not restart."""

    def init(self, mean: Layout) -> StrategyState:
        """Return the initial state."""
        es, key = self._es(), jax.random.key(0)
        origin = jnp.zeros(len(self.free))
        if _is_population_based(es):
            population = jnp.zeros((self.population, len(self.free)))
            inner = es.init(key, population, jnp.full(self.population, jnp.inf), self.params)
        else:
            inner = es.init(key, origin, self.params)
        return StrategyState(mean, inner, jnp.asarray(False))

    def ask(self, key: Key[Array, ""], state: StrategyState, population: int) -> Layout:
        """Sample a population.

        Use `key` again only for `tell_with_key`.

        Raises:
            ConfigError: `population` differs from `refine.cem.population`.
        """
        if population != self.population:
            raise ConfigError(
                f"evosax:{self.name} was built for a population of {self.population} "
                f"(refine.cem.population), asked for {population}"
            )
        es = self._es()
        samples, _ = es.ask(key, state.inner, self.params)
        if _is_population_based(es):
            first = jax.random.normal(key, samples.shape)
            samples = jnp.where(state.started, samples, first)
        center, free = _flatten(state.mean), jnp.asarray(self.free)
        offset = samples * _flatten(self.sigma)[:, free]
        flat = jnp.repeat(center, population, axis=0).at[:, free].add(offset)
        return _unflatten(flat, state.mean)

    def tell_with_key(
        self,
        key: Key[Array, ""],
        state: StrategyState,
        layouts: Layout,
        reward: Float[AnyArray, " pop"],
    ) -> StrategyState:
        """Return the state updated with the absolute rewards, which never saturate.

        Args:
            key: the key with which `ask` sampled the population. It is needed again because `ask`
                of evosax also changes the state.
            state: previous state.
            layouts: the evaluated candidates.
            reward: absolute rewards of the candidates. Failed candidates count as worse than all
                others.
        """
        es, free = self._es(), jnp.asarray(self.free)
        unit = (_flatten(layouts) - _flatten(state.mean))[:, free] / _flatten(self.sigma)[:, free]
        finite = jnp.isfinite(reward)
        worst = jnp.max(jnp.where(finite, -reward, -jnp.inf))
        loss = jnp.where(finite, -reward, jnp.where(jnp.isfinite(worst), worst + 1.0, 0.0))
        _, asked_state = es.ask(key, state.inner, self.params)
        tell_key = jax.random.fold_in(key, 1)
        updated, _ = es.tell(tell_key, unit, loss, asked_state, self.params)
        if _is_population_based(es):
            first = es.init(tell_key, unit, loss, self.params)
            pick = lambda new, old: jnp.where(state.started, new, old)
            updated = jax.tree.map(pick, updated, first)
        elif self.restart_spread is not None:
            updated = self._restart_if_flat(tell_key, unit, loss, updated, self.restart_spread)
        return StrategyState(state.mean, updated, jnp.asarray(True))

    def _restart_if_flat(
        self, key: Key[Array, ""], unit: Any, loss: Any, state: Any, spread: float
    ) -> Any:
        """Return the state of evosax, reinitialized if the losses differ by less than `spread`."""
        from evosax.core import restart

        limit = restart.RestartParams(min_fitness_spread=spread)
        control = restart.SimpleRestart((restart.spread_cond,), limit)
        count = control.init()
        restarted, _ = control.restart(key, self._es(), state, self.params, count)
        stuck = control.should_restart(unit, loss, state, self.params, count)
        return jax.tree.map(lambda new, old: jnp.where(stuck, new, old), restarted, state)

    def _es(self) -> Any:
        return _build(self.name, self.population, len(self.free), self.learning_rate)


@functools.cache
def _build(name: str, population: int, variables: int, learning_rate: float | None) -> Any:
    """Return the strategy object of evosax.

    Equal arguments give the same object, because `init` stores constants in some of these objects.
    """
    extra = {}
    if learning_rate is not None:
        import optax

        extra["optimizer"] = optax.adam(learning_rate)
    with jax.ensure_compile_time_eval():  # The cached object outlives any trace.
        return _strategies()[name](population, np.zeros(variables, np.float32), **extra)


def _is_population_based(es: Any) -> bool:
    return "fitness" in inspect.signature(es.init).parameters


def _strategies() -> dict[str, Any]:
    """Return the strategies of evosax, by name.

    Raises:
        EngineError: evosax is not installed.
    """
    try:
        from evosax.algorithms import algorithms
    except ImportError:
        raise EngineError(
            "refine.optimizer: cma_es and evosax:STRATEGY need evosax: "
            "uv sync --inexact --extra baselines"
        ) from None
    return dict(algorithms)


def strategy_class(name: str) -> Any:
    """Return the class of an evosax strategy.

    Raises:
        ConfigError: there is no strategy of this name.
        EngineError: evosax is not installed.
    """
    strategies = _strategies()
    if name not in strategies:
        raise ConfigError(f"refine.optimizer: evosax: {choices(name, strategies)}")
    return strategies[name]


def open_strategy(
    name: str, scene: SceneArrays, options: CEMOptions, parameters: Mapping[str, float]
) -> Strategy:
    """Build an evosax strategy for a scene.

    Args:
        name: name of the strategy in evosax, such as SNES.
        scene: the scene's arrays.
        options: options that give the population size and the initial standard deviations.
        parameters: values by name: parameters of evosax, LEARNING_RATE, or RESTART.

    Raises:
        ConfigError: the strategy or a parameter does not exist, or the strategy cannot search the
            scene.
        EngineError: evosax is not installed.
    """
    strategy = strategy_class(name)
    sigma = initial_sigma(scene, options)
    free = tuple(int(k) for k in np.flatnonzero(np.asarray(_flatten(sigma))[0] > 0))
    values = dict(parameters)
    rate = values.pop(LEARNING_RATE, None)
    has_rate = "optimizer" in inspect.signature(strategy).parameters
    if rate is not None and not has_rate:
        raise ConfigError(f"refine.strategy: {name} takes no {LEARNING_RATE}")
    spread = values.pop(RESTART, None)
    built = Strategy(name, options.population, sigma, None, free, rate, spread)
    try:
        if spread is not None and _is_population_based(built._es()):
            raise ConfigError(
                f"refine.strategy: {name} takes no {RESTART}: it keeps a population, and evosax "
                "can only restart distribution-based strategies"
            )
        params = built._es().default_params
        fields = list(params.__dataclass_fields__)
        for key in values:
            if key not in fields:
                raise ConfigError(
                    f"refine.strategy: {name}: "
                    f"{choices(key, [*fields, RESTART, *([LEARNING_RATE] if has_rate else [])])}"
                )
        params = params.replace(**{key: jnp.asarray(value) for key, value in values.items()})
        params = jax.tree.map(jnp.asarray, params)
        built = eqx.tree_at(lambda s: s.params, built, params, is_leaf=lambda x: x is None)
        jax.eval_shape(built.init, Layout.zero(1, scene.count))
    except ConfigError:
        raise
    except (AssertionError, TypeError, ValueError) as error:
        first = str(error).split("\n", 1)[0]
        raise ConfigError(
            f"refine.optimizer: evosax:{name} cannot search {len(free)} variables with "
            f"refine.cem.population {options.population}: {first}"
        ) from None
    return built


def _flatten(layout: Layout) -> Float[Array, "pop number"]:
    pop = layout.yaw.shape[0]
    return jnp.concatenate([leaf.reshape(pop, -1) for leaf in jax.tree.leaves(layout)], axis=1)


def _unflatten(flat: Float[Array, "pop number"], like: Layout) -> Layout:
    count = like.yaw.shape[1]
    xy, yaw, log_scale = flat[:, : 2 * count], flat[:, 2 * count : 3 * count], flat[:, 3 * count :]
    return Layout(xy.reshape(len(flat), count, 2), yaw, log_scale)
