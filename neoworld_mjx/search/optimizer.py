"""Protocol of the optimizers that Algorithm 1 can use, and the built-in ones."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Array, Bool, Float, Key

from ..config import CEMOptions
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
        name: a key of OPTIMIZERS, or the import path "package.module:function" of a factory.

    Raises:
        ConfigError: the optimizer does not exist.
    """
    return OPTIMIZERS.get(name) or import_function("refine.optimizer", name, OPTIMIZERS)
