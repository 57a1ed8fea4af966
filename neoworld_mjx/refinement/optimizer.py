"""Optimizers of Algorithm 1's loop: the protocol, and the table of those that options name."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Array, Float, Key

from ..config import CEMOptions
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays
from .cem import CEM, draw, initial_sigma, open_cem
from .cma_es import open_cma_es
from .objective import imported


@runtime_checkable
@runtime_checkable
class Optimizer(Protocol):
    """Proposes layouts and learns from their rewards.

    Methods are pure and traceable by JAX. An `equinox.Module` whose numbers are arrays can be
    mapped over the runs of a sweep.
    """

    def init(self, mean: Layout) -> Any:
        """Return the state in which a search starts at a layout, pop axis of length 1."""
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
        """Return the state after a population was evaluated.

        Not called for a first iteration of fewer candidates (`refine.cem.first`).

        Args:
            state: before.
            layouts: the candidates, as they were evaluated.
            reward: what ranks them within this population; -inf for failed and pruned ones.
            absolute: the reward that can be compared between populations.
            credit: the reward by objects, while elites are chosen by object; else None.
        """
        ...


class RandomSearch(eqx.Module):
    """Draws every population from the initial Gaussian about the start."""

    sigma: Layout
    """Standard deviations, pop axis of length 1."""

    def init(self, mean: Layout) -> Layout:
        """Start at a layout; the state is where the search starts."""
        return mean

    def ask(self, key: Key[Array, ""], state: Layout, population: int) -> Layout:
        """Draw a population; `key` is consumed."""
        return draw(key, state, self.sigma, population)

    def tell(self, state: Layout, layouts: Layout, reward: AnyArray, **_: Any) -> Layout:
        """Learn nothing."""
        return state


def _open_random(scene: SceneArrays, options: CEMOptions) -> RandomSearch:
    return RandomSearch(initial_sigma(scene, options))


OPTIMIZERS: dict[str, Callable[[SceneArrays, CEMOptions], Optimizer]] = {
    "cem": open_cem,
    "cma_es": open_cma_es,
    "random": _open_random,
}
"""What builds each optimizer that `refine.optimizer` names, from the scene and `refine.cem`."""


def with_sigma(optimizer: Optimizer, sigma: Layout) -> Optimizer:
    """Give CEM and random search other initial deviations; other optimizers keep their own."""
    if isinstance(optimizer, CEM):
        return eqx.tree_at(lambda c: c.params.sigma, optimizer, sigma)
    if isinstance(optimizer, RandomSearch):
        return RandomSearch(sigma)
    return optimizer


def open_optimizer(name: str, scene: SceneArrays, options: CEMOptions) -> Optimizer:
    """Build an optimizer by name, or from what an import path "package.module:function" names.

    Raises:
        ConfigError: there is no such optimizer.
        EngineError: its package is not installed.
    """
    build = OPTIMIZERS.get(name) or imported("refine.optimizer", name, OPTIMIZERS)
    return build(scene, options)
