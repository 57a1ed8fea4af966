"""Optimizer protocol of Algorithm 1's loop, and the table of the built-in optimizers."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Array, Float, Key

from ..config import CEMOptions
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays
from .cem import draw, initial_sigma, open_cem
from .cma_es import open_cma_es
from .objective import imported


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


OPTIMIZERS: dict[str, Callable[[SceneArrays, CEMOptions], Optimizer]] = {
    "cem": open_cem,
    "cma_es": open_cma_es,
    "random": _open_random,
}
"""Factories of the optimizers that `refine.optimizer` names, from the scene and `refine.cem`."""


def open_optimizer(name: str, scene: SceneArrays, options: CEMOptions) -> Optimizer:
    """Build an optimizer by name, or by a factory's import path "package.module:function".

    Raises:
        ConfigError: the optimizer does not exist.
        EngineError: its package is not installed.
    """
    build = OPTIMIZERS.get(name) or imported("refine.optimizer", name, OPTIMIZERS)
    return build(scene, options)
