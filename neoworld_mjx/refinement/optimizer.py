"""Optimizer protocol of Algorithm 1's loop, and the table of the built-in optimizers."""

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
from .objective import imported
from .strategies import EVOSAX, Strategy, open_strategy, strategy_class


@runtime_checkable
class Optimizer(Protocol):
    """Search distribution over layouts that is fitted to rewards.

    Methods are pure and traceable by JAX. An `equinox.Module` whose parameters are arrays can be
    mapped over the runs of a sweep.
    """

    def init(self, mean: Layout) -> Any:
        """Return the initial state for a mean layout, pop axis of length 1."""
        ...

    def ask(self, key: Key[Array, ""], state: Any, population: int) -> Layout:
        """Draw a population; `key` is consumed."""
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
            reward: ranks the candidates of this population; -inf for failed ones.
            absolute: reward that is comparable between populations.
            credit: reward of each object, -inf where it does not rest; None ranks by `reward`.
        """
        ...


class RandomSearch(eqx.Module):
    """Optimizer that draws every population from the initial Gaussian."""

    sigma: Layout
    """Standard deviations, pop axis of length 1."""

    def init(self, mean: Layout) -> Layout:
        """Return the mean layout, which is the state."""
        return mean

    def ask(self, key: Key[Array, ""], state: Layout, population: int) -> Layout:
        """Draw a population; `key` is consumed."""
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
"""Factories of the optimizers that `refine.optimizer` names, from the scene and `refine.cem`."""


def open_optimizer(
    name: str,
    scene: SceneArrays,
    options: CEMOptions,
    parameters: Mapping[str, float] | None = None,
) -> Optimizer | Strategy:
    """Build an optimizer.

    Args:
        name: of OPTIMIZERS, evosax:STRATEGY, or a factory's path "package.module:function".
        scene: the scene's arrays.
        options: options of the Gaussian.
        parameters: parameters of a strategy of evosax, by name.

    Raises:
        ConfigError: the optimizer or a parameter does not exist.
        EngineError: its package is not installed.
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
    """Return the factory of an optimizer; names and errors are those of `open_optimizer`."""
    kind, _, strategy = (
        f"{EVOSAX}:CMA_ES".partition(":") if name == "cma_es" else name.partition(":")
    )
    if strategy and kind == EVOSAX:
        strategy_class(strategy)
        return partial(open_strategy, strategy, parameters={})
    return OPTIMIZERS.get(name) or imported("refine.optimizer", name, OPTIMIZERS)
