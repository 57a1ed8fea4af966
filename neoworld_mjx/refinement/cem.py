"""The Cross-Entropy Method over layouts (paper Algorithm 1), as init / ask / tell.

What shapes arrays (population, elites) is static; every number is traced, so a sweep over numbers,
seeds included, is one `vmap`; the options declare which they are.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from ..config import CEMOptions
from ..physics.layout import Layout
from ..physics.model import SceneModel


class CEMParams(eqx.Module):
    """Traced hyperparameters."""

    sigma: Layout
    """Initial standard deviations, pop axis of length 1."""
    floor: Float[Array, ""]
    """Smallest standard deviation, as a fraction of the initial one."""
    smoothing: Float[Array, ""]
    """Weight of the old mean and deviation in an update; 0 is Algorithm 1."""
    stop_gain: Float[Array, ""]


class CEMState(eqx.Module):
    """A diagonal Gaussian over (dx, dy, dyaw, log s) of every object, pop axes of length 1."""

    mean: Layout
    std: Layout
    iteration: Int[Array, ""]
    elite_mean: Float[Array, ""]
    """Mean absolute reward of the last elites; -inf before the first."""
    gain: Float[Array, ""]
    """By how much `elite_mean` rose in the last update; inf before the second."""


class CEM(eqx.Module):
    """Algorithm 1 with a fixed population and number of elites."""

    population: int = eqx.field(static=True)
    elites: int = eqx.field(static=True)
    zero_candidate: bool = eqx.field(static=True, default=True)

    def init(self, scene: SceneModel, params: CEMParams, mean: Layout | None = None) -> CEMState:
        """Start at the composed scene, or at `mean`, with the initial deviations."""
        zero = jax.tree.map(jnp.zeros_like, params.sigma)
        return CEMState(
            zero if mean is None else mean,
            params.sigma,
            jnp.asarray(0),
            jnp.asarray(-jnp.inf),
            jnp.asarray(jnp.inf),
        )

    def ask(self, key: Key[Array, ""], state: CEMState, params: CEMParams) -> Layout:
        """Draw a population; `key` is consumed.

        With `zero_candidate` the first is the mean, which at first is the composed scene. Objects whose deviation is zero
        (environment supports) stay where they are.
        """
        del params
        keys = jax.random.split(key, 3)
        draws = [
            mean + std * jax.random.normal(k, (self.population, *mean.shape[1:]))
            for k, mean, std in zip(
                keys, jax.tree.leaves(state.mean), jax.tree.leaves(state.std), strict=True
            )
        ]
        drawn = Layout(*draws)
        if not self.zero_candidate:
            return drawn
        return jax.tree.map(lambda leaf, mean: leaf.at[0].set(mean[0]), drawn, state.mean)

    def tell(
        self,
        state: CEMState,
        layouts: Layout,
        reward: Float[Array, " pop"],
        absolute: Float[Array, " pop"],
        params: CEMParams,
        credit: Float[Array, "pop object"] | None = None,
    ) -> CEMState:
        """Fit the Gaussian to the top-K candidates.

        Args:
            state: before.
            layouts: the population of the last `ask`.
            reward: what they are ranked by; -inf or NaN never becomes an elite, and when fewer than
                K candidates are finite only those count.
            absolute: the reward by which iterations are compared.
            params: hyperparameters.
            credit: the reward by objects; given, each object's numbers are fitted to the K
                candidates that are best for it.
        """
        reward = jnp.where(jnp.isfinite(reward), reward, -jnp.inf)
        # A stable sort, so that equal rewards are taken in the order of the population.
        best = jnp.argsort(-reward, stable=True)[: self.elites]
        weight = jnp.isfinite(reward[best]).astype(jnp.float32)
        total = jnp.maximum(jnp.sum(weight), 1.0)
        any_finite = jnp.sum(weight) > 0

        count = layouts.yaw.shape[1]
        rows, mine = jnp.repeat(best[:, None], count, 1), jnp.repeat(weight[:, None], count, 1)
        if credit is not None:
            credit = jnp.where(jnp.isfinite(reward)[:, None], credit, -jnp.inf)
            rows = jnp.argsort(-credit, axis=0, stable=True)[: self.elites]
            mine = jnp.isfinite(reward)[rows].astype(jnp.float32)

        def fit(
            leaf: Float[Array, "pop object ..."], old: Array, old_std: Array, sigma: Array
        ) -> tuple[Array, Array]:
            chosen = leaf[rows, jnp.arange(count)]
            w = (mine / total).reshape(*mine.shape, *(1,) * (leaf.ndim - 2))
            mean = jnp.sum(chosen * w, axis=0, keepdims=True)
            std = jnp.sqrt(jnp.sum((chosen - mean) ** 2 * w, axis=0, keepdims=True))
            keep = params.smoothing
            mean = keep * old + (1 - keep) * mean
            std = jnp.maximum(keep * old_std + (1 - keep) * std, params.floor * sigma)
            return jnp.where(any_finite, mean, old), jnp.where(any_finite, std, old_std)

        fitted = [
            fit(*leaves)
            for leaves in zip(
                *(jax.tree.leaves(t) for t in (layouts, state.mean, state.std, params.sigma)),
                strict=True,
            )
        ]
        finite = jnp.where(weight > 0, absolute[best], 0.0)
        elite_mean = jnp.where(any_finite, jnp.sum(finite) / total, -jnp.inf)
        return CEMState(
            Layout(*(mean for mean, _ in fitted)),
            Layout(*(std for _, std in fitted)),
            state.iteration + 1,
            elite_mean,
            jnp.where(state.iteration > 0, elite_mean - state.elite_mean, jnp.inf),
        )


def open_cem(scene: SceneModel, options: CEMOptions) -> tuple[CEM, CEMParams]:
    """Build the method and its hyperparameters for a scene.

    sigma_xy is a fraction of each object's horizontal bounding-box diagonal; supports of the
    environment get zero (paper Appendix B).
    """
    moves = scene.optimised.astype(jnp.float32)
    xy = options.sigma_xy * scene.diagonal * moves
    sigma = Layout(
        jnp.repeat(xy[None, :, None], 2, axis=-1),
        (np.radians(options.sigma_yaw_deg) * moves)[None],
        (options.sigma_log_scale * moves)[None],
    )
    cem = CEM(
        options.population,
        max(1, round(options.elite_ratio * options.population)),
        options.zero_candidate,
    )
    f32 = lambda x: jnp.asarray(x, jnp.float32)
    return cem, CEMParams(
        sigma, f32(options.sigma_floor), f32(options.smoothing), f32(options.stop_gain)
    )
