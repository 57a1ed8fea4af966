"""Networks of a policy and of its value function, as plain arrays.

The same functions run on NumPy and on JAX arrays, so a policy is evaluated without a compiler.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.array_types import AnyArray

CLIP = 10.0
"""Largest absolute value of a normalized observation."""
LEAST = 0.02
"""Deviation added to that of an observation, so that one that hardly varied in training, such as a
fixed object's position, is not amplified in another scene."""
LARGEST = 100.0
"""Largest absolute value of an observation, so that a world that flies apart spoils no mean."""


class Normalizer(NamedTuple):
    """Running mean and variance of observations."""

    seen: Float[AnyArray, ""]
    mean: Float[AnyArray, " obs"]
    squares: Float[AnyArray, " obs"]
    """Sum of the squared deviations from the mean."""

    def __call__(self, obs: Any, xp: Any = jnp) -> Any:
        """Return observations with zero mean and unit variance, clipped."""
        deviation = xp.sqrt(self.squares / xp.maximum(self.seen, 1.0)) + LEAST
        return xp.clip((obs - self.mean) / deviation, -CLIP, CLIP)

    def update(self, obs: Float[Array, "*batch obs"]) -> "Normalizer":
        """Return the statistics with a batch added (Welford's update)."""
        obs = obs.reshape(-1, obs.shape[-1])
        seen = self.seen + len(obs)
        from_old = obs - self.mean
        mean = self.mean + from_old.sum(axis=0) / seen
        added = (from_old * (obs - mean)).sum(axis=0)  # rounding may make it negative
        return Normalizer(seen, mean, jnp.maximum(self.squares + added, 0.0))


class Layer(NamedTuple):
    """Dense layer."""

    weight: Float[AnyArray, "input output"]
    bias: Float[AnyArray, " output"]


class Actor(NamedTuple):
    """Policy: the mean of a normal distribution of actions is a network of the observation."""

    layers: tuple[Layer, ...]
    log_std: Float[AnyArray, " action"]


def mlp(layers: tuple[Layer, ...], x: Any, xp: Any = jnp) -> Any:
    """Return the output of a network with swish between its layers."""
    for k, (weight, bias) in enumerate(layers):
        x = x @ weight + bias
        if k + 1 < len(layers):
            x = x * (0.5 + 0.5 * xp.tanh(0.5 * x))  # its gradient is finite for any x
    return x


def init_layers(key: Array, sizes: tuple[int, ...], last: float) -> tuple[Layer, ...]:
    """Return layers with orthogonal weights; `last` is the gain of the last layer."""
    layers = []
    for k, (rows, columns) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        key, own = jax.random.split(key)
        gain = last if k + 2 == len(sizes) else 2.0**0.5
        weight = jax.nn.initializers.orthogonal(gain)(own, (rows, columns), jnp.float32)
        layers.append(Layer(weight, jnp.zeros(columns)))
    return tuple(layers)


def flat(obs: dict[str, Any], xp: Any = jnp) -> Any:
    """Return named observations as one vector, in the order of their names, shape [obs]."""
    vector = xp.concatenate([xp.reshape(obs[name], (-1,)) for name in sorted(obs)])
    vector = xp.nan_to_num(vector.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return xp.clip(vector, -LARGEST, LARGEST)
