"""CMA-ES (Hansen, arXiv:1604.00772) for Algorithm 1's loop, by evosax (extra `baselines`)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from ..config import CEMOptions
from ..errors import EngineError
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays
from .cem import initial_sigma

WORST = 1e3
"""Loss of a failed candidate; rewards are within a few units of zero."""


class CMAES(eqx.Module):
    """CMA-ES over the free numbers of a layout, in units of their initial deviations.

    The covariance matrix is full; that of CEM is diagonal.
    """

    sigma: Layout
    """Initial standard deviations, pop axis of length 1."""
    free: tuple[int, ...] = eqx.field(static=True)
    """Indices of the free numbers in a flattened layout."""

    def init(self, mean: Layout) -> tuple[Layout, Any]:
        """Return the state: the mean layout and evosax's state."""
        es = self._es(2)
        zero = jnp.zeros(len(self.free))
        return mean, es.init(jax.random.key(0), zero, es.default_params)

    def ask(self, key: Key[Array, ""], state: tuple[Layout, Any], population: int) -> Layout:
        """Draw a population; `key` is consumed."""
        mean, inner = state
        es = self._es(population)
        drawn, _ = es.ask(key, inner, es.default_params)
        center, sigma = _flat(mean), _flat(self.sigma)
        free = jnp.asarray(self.free)
        offset = drawn * sigma[:, free]
        flat = jnp.repeat(center, population, axis=0).at[:, free].add(offset)
        return _unflat(flat, mean)

    def tell(
        self,
        state: tuple[Layout, Any],
        layouts: Layout,
        reward: Float[AnyArray, " pop"],
        *,
        absolute: Float[AnyArray, " pop"] | None = None,
        credit: Float[AnyArray, "pop object"] | None = None,
    ) -> tuple[Layout, Any]:
        """Update mean, step size and covariance from the absolute rewards, which never saturate."""
        del credit
        mean, inner = state
        es = self._es(len(reward))
        free = jnp.asarray(self.free)
        unit = (_flat(layouts) - _flat(mean))[:, free] / _flat(self.sigma)[:, free]
        reward = reward if absolute is None else absolute
        loss = jnp.where(jnp.isfinite(reward), -reward, WORST)
        # evosax's `ask` also decomposes the covariance, which `tell` needs.
        key = jax.random.key(0)
        _, inner = es.ask(key, inner, es.default_params)
        inner, _ = es.tell(key, unit, loss, inner, es.default_params)
        return mean, inner

    def _es(self, population: int) -> Any:
        from evosax.algorithms import CMA_ES

        return CMA_ES(population_size=population, solution=jnp.zeros(len(self.free)))


def _flat(layout: Layout) -> Float[Array, "pop number"]:
    pop = layout.yaw.shape[0]
    return jnp.concatenate([leaf.reshape(pop, -1) for leaf in jax.tree.leaves(layout)], axis=1)


def _unflat(flat: Float[Array, "pop number"], like: Layout) -> Layout:
    count = like.yaw.shape[1]
    xy, yaw, log_scale = flat[:, : 2 * count], flat[:, 2 * count : 3 * count], flat[:, 3 * count :]
    return Layout(xy.reshape(len(flat), count, 2), yaw, log_scale)


def open_cma_es(scene: SceneArrays, options: CEMOptions) -> CMAES:
    """Build CMA-ES for a scene.

    Raises:
        EngineError: evosax is not installed.
    """
    try:
        import evosax  # noqa: F401
    except ImportError:
        raise EngineError(
            "refine.optimizer: cma_es needs evosax: uv sync --inexact --extra baselines"
        ) from None
    sigma = initial_sigma(scene, options)
    free = np.flatnonzero(np.asarray(_flat(sigma))[0] > 0)
    return CMAES(sigma, tuple(int(k) for k in free))
