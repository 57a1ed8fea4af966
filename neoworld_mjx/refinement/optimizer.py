"""Protocol of the optimizers that Algorithm 1 can use, and the built-in optimizers."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Array, Float, Key

from ..config import CEMOptions
from ..errors import ConfigError
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays
from .cem import draw, initial_sigma, open_cem
from .objective import import_function
from .strategies import EVOSAX, Strategy, open_strategy, strategy_class


@runtime_checkable
class Optimizer(Protocol):
    """Search distribution over layouts that is fitted to rewards.

    All methods must be pure functions that JAX can trace. If an optimizer is an `equinox.Module`
    whose parameters are arrays, a sweep can batch it over runs.
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
        absolute: Float[AnyArray, " pop"] | None = None,
        credit: Float[AnyArray, "pop object"] | None = None,
    ) -> Any:
        """Return the state updated with an evaluated population.

        Args:
            state: previous state.
            layouts: the evaluated candidates.
            reward: reward that ranks the candidates of this population; -inf for failed candidates.
            absolute: reward that is comparable between populations.
            credit: reward of each object in each candidate, -inf if the object does not rest. If
                None, use `reward` for all objects.
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


OPTIMIZERS: dict[str, Callable[[SceneArrays, CEMOptions], Optimizer | Strategy]] = {
    "cem": open_cem,
    "cma_es": partial(open_strategy, "CMA_ES", parameters={}),
    "random": _open_random,
}
"""Factories of the built-in optimizers, by their names in `refine.optimizer`.

The arguments of a factory are the scene and the options `refine.cem`.
"""


def open_optimizer(
    name: str,
    scene: SceneArrays,
    options: CEMOptions,
    parameters: Mapping[str, float] | None = None,
) -> Optimizer | Strategy:
    """Build an optimizer.

    Args:
        name: a key of OPTIMIZERS, evosax:STRATEGY, or the import path "package.module:function" of
            a factory.
        scene: the scene's arrays.
        options: population size, initial standard deviations and other options of CEM.
        parameters: parameters of an evosax strategy, by name.

    Raises:
        ConfigError: the optimizer or a parameter does not exist.
        EngineError: evosax is needed, but not installed.
    """
    if name == "cma_es" or name.startswith(f"{EVOSAX}:"):
        strategy = "CMA_ES" if name == "cma_es" else name.partition(":")[2]
        return open_strategy(strategy, scene, options, parameters or {})
    if parameters:
        raise ConfigError(
            f"refine.strategy: {', '.join(parameters)}: only evosax:STRATEGY has parameters, "
            f"not {name}"
        )
    return optimizer_factory(name)(scene, options)


def optimizer_factory(name: str) -> Callable[[SceneArrays, CEMOptions], Optimizer | Strategy]:
    """Return the factory of an optimizer; names and errors are as in `open_optimizer`."""
    kind, _, strategy = (
        f"{EVOSAX}:CMA_ES".partition(":") if name == "cma_es" else name.partition(":")
    )
    if strategy and kind == EVOSAX:
        strategy_class(strategy)
        return partial(open_strategy, strategy, parameters={})
    return OPTIMIZERS.get(name) or import_function("refine.optimizer", name, OPTIMIZERS)
