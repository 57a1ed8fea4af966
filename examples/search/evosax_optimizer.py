"""Strategies of evosax (Lange, arXiv:2212.04180): `refine.optimizer: evosax_optimizer:SNES`."""

from functools import cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from evosax.algorithms import algorithms
from jax.flatten_util import ravel_pytree

import neoworld_mjx as nw
from neoworld_mjx.search.cem import initial_sigma


class Strategy(eqx.Module):
    # Searches the free layout variables, in units of their initial standard deviations.
    strategy: Any = eqx.field(static=True)
    sigma: nw.Layout
    free: tuple[int, ...] = eqx.field(static=True)  # variables with a deviation, flattened

    def init(self, mean):
        params, start = self.strategy.default_params, jnp.zeros(len(self.free))
        return mean, self.strategy.init(jax.random.key(0), start, params)

    def ask(self, key, state, population):
        free = jnp.array(self.free)
        samples, _ = self.strategy.ask(key, state[1], self.strategy.default_params)
        rows = jnp.repeat(flat(state[0]), population, axis=0)
        rows = rows.at[:, free].add(samples * flat(self.sigma)[:, free])
        return jax.vmap(ravel_pytree(jax.tree.map(lambda leaf: leaf[0], state[0]))[1])(rows)

    def tell(self, state, layouts, reward, *, key, **_):
        (mean, inner), free, params = state, jnp.array(self.free), self.strategy.default_params
        samples = (flat(layouts) - flat(mean))[:, free] / flat(self.sigma)[:, free]
        finite = jnp.isfinite(reward)  # failed candidates count as worse than all others
        loss = jnp.where(finite, -reward, 1.0 + jnp.max(jnp.where(finite, -reward, 0.0)))
        _, inner = self.strategy.ask(key, inner, params)  # changes the state of evosax, too
        key = jax.random.fold_in(key, 1)
        return mean, self.strategy.tell(key, samples, loss, inner, params)[0]


built = cache(lambda name, n, k: algorithms[name](n, np.zeros(k, np.float32)))  # compiled once


def flat(layout):
    return jax.vmap(lambda candidate: ravel_pytree(candidate)[0])(layout)


def open_strategy(name, scene, options):
    sigma = initial_sigma(scene, options)
    free = tuple(np.flatnonzero(flat(sigma)[0] > 0).tolist())
    return Strategy(built(name, options.population, len(free)), sigma, free)


def __getattr__(name):
    if name in algorithms:
        return partial(open_strategy, name)
    raise AttributeError(name)
