"""The Cross-Entropy Method over layouts (paper Algorithm 1), as init / ask / tell.

The elite ratio and `zero_candidate` are static. All other hyperparameters are traced, and so is the
random key, so `jax.vmap` maps over hyperparameters and seeds.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from ..config import CEMOptions
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays, on_device

PLATE_THICKNESS = 0.3
"""A box is a plate if its thickness is less than this fraction of its second-shortest side."""


class CEMParams(eqx.Module):
    """Traced hyperparameters of CEM."""

    sigma: Layout
    """Initial standard deviations, with a population axis of length 1."""
    floor: Float[Array, ""]
    """Smallest standard deviation, as a fraction of the initial standard deviation."""
    smoothing: Float[Array, ""]
    """Weight of the old mean and standard deviation in an update; Algorithm 1 uses 0."""


class CEMState(eqx.Module):
    """A diagonal Gaussian over (dx, dy, dyaw, log s) of every object.

    `mean` and `std` are layouts whose population axis has length 1.
    """

    mean: Layout
    std: Layout


class CEM(eqx.Module):
    """The sampling and fitting steps of Algorithm 1; implements `optimizer.Optimizer`."""

    params: CEMParams
    elite_ratio: float = eqx.field(static=True)
    """Fraction rho of the candidates that are elites: K = rho N."""
    zero_candidate: bool = eqx.field(static=True, default=True)
    """If True, the first candidate is the mean itself."""

    def init(self, mean: Layout | None = None) -> CEMState:
        """Return the initial state. If `mean` is None, the mean is the composed scene."""
        zero = on_device(jax.tree.map(lambda s: np.zeros(s.shape), self.params.sigma))
        return CEMState(zero if mean is None else mean, self.params.sigma)

    def ask(self, key: Key[Array, ""], state: CEMState, population: int) -> Layout:
        """Sample a population; `key` must not be used again.

        Objects whose standard deviations are zero, such as environment supports, do not move.
        """
        samples = draw(key, state.mean, state.std, population)
        if not self.zero_candidate:
            return samples
        return jax.tree.map(lambda leaf, mean: leaf.at[0].set(mean[0]), samples, state.mean)

    def tell(
        self,
        state: CEMState,
        layouts: Layout,
        reward: Float[AnyArray, " pop"],
        *,
        key: Key[Array, ""] | None = None,
        absolute: Float[AnyArray, " pop"] | None = None,
        credit: Float[AnyArray, "pop object"] | None = None,
    ) -> CEMState:
        """Fit the Gaussian to the elites, the K candidates of highest reward.

        Args:
            state: previous state.
            layouts: the candidates.
            reward: reward that ranks the candidates. Candidates whose reward is -inf or NaN are
                never elites, so there may be fewer than K elites.
            key: unused.
            absolute: unused.
            credit: reward of each object. If given, the mean and standard deviation of an object
                are fitted to the K candidates in which this object has its highest finite credit.
                They stay unchanged if no credit of the object is finite.
        """
        del key, absolute
        elites, count = elite_count(self.elite_ratio, len(reward)), layouts.yaw.shape[1]
        ranks = jnp.repeat(reward[:, None], count, 1) if credit is None else credit
        rows, weights = jax.vmap(lambda x: elite_rows(x, elites), 1, 1)(ranks)
        total = jnp.maximum(jnp.sum(weights, axis=0), 1.0)
        is_fitted = jnp.sum(weights, axis=0) > 0

        def fit(
            leaf: Float[Array, "pop object ..."], old: Array, old_std: Array, sigma: Array
        ) -> tuple[Array, Array]:
            chosen = leaf[rows, jnp.arange(count)]
            spread = (1,) * (leaf.ndim - 2)
            weight, fitted_here = (
                (weights / total).reshape(-1, count, *spread),
                is_fitted.reshape(-1, *spread),
            )
            mean = jnp.sum(chosen * weight, axis=0, keepdims=True)
            std = jnp.sqrt(jnp.sum((chosen - mean) ** 2 * weight, axis=0, keepdims=True))
            smoothing = self.params.smoothing
            mean = smoothing * old + (1 - smoothing) * mean
            std = jnp.maximum(
                smoothing * old_std + (1 - smoothing) * std, self.params.floor * sigma
            )
            return jnp.where(fitted_here, mean, old), jnp.where(fitted_here, std, old_std)

        trees = (layouts, state.mean, state.std, self.params.sigma)
        fitted = [fit(*leaves) for leaves in zip(*(jax.tree.leaves(t) for t in trees), strict=True)]
        return CEMState(Layout(*(mean for mean, _ in fitted)), Layout(*(std for _, std in fitted)))


def draw(key: Key[Array, ""], mean: Layout, std: Layout, population: int) -> Layout:
    """Sample candidates from a diagonal Gaussian; `key` must not be used again."""
    # One key per object, so that samples do not depend on padding.
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(mean.yaw.shape[1]))
    normals = jax.vmap(lambda k: jax.random.normal(k, (population, 4)), out_axes=1)(keys)
    noise = Layout(normals[..., :2], normals[..., 2], normals[..., 3])
    return jax.tree.map(lambda m, s, n: m + s * n, mean, std, noise)


def elite_count(elite_ratio: float, population: int) -> int:
    """Return the number of elites K = rho N, at least 1."""
    return max(1, round(elite_ratio * population))


def elite_rows(
    reward: Float[AnyArray, " pop"], elites: int
) -> tuple[Array, Float[Array, " elite"]]:
    """Return the indices of the elites, best first, and their weights: 0 if not finite, else 1."""
    reward = jnp.where(jnp.isfinite(reward), reward, -jnp.inf)
    # The sort is stable: candidates of equal reward keep the order of the population.
    best = jnp.argsort(-reward, stable=True)[:elites]
    return best, jnp.isfinite(reward[best]).astype(jnp.float32)


def initial_sigma(scene: SceneArrays, options: CEMOptions) -> Layout:
    """Return the initial standard deviations, with a population axis of length 1 (Appendix B).

    `sigma_xy` is a fraction of each object's horizontal bounding-box diagonal. The standard
    deviations of environment supports, and of known poses and sizes, are zero. Objects attached to
    an upright plate, such as a wall, move only along the plate and do not turn.
    """
    moves = np.asarray(scene.optimised).astype(np.float32)
    xy = options.sigma_xy * np.asarray(scene.diagonal) * moves
    fixed = _fixed_axes(scene)
    sigma = Layout(
        (xy[:, None] * ~fixed)[None],
        (np.radians(options.sigma_yaw_deg) * moves * ~fixed.any(axis=1))[None],
        (options.sigma_log_scale * np.asarray(scene.resized).astype(np.float32))[None],
    )
    return on_device(sigma)


def _fixed_axes(scene: SceneArrays) -> Bool[np.ndarray, "object 2"]:
    """Return a mask of the axes (x and y of the parent) along which an attached object is fixed.

    An object is fixed along the thickness direction of its parent if the parent is a plate; see
    PLATE_THICKNESS.
    """
    parent = np.asarray(scene.arrangement.parent)
    attached = (parent >= 0) & ~np.asarray(scene.arrangement.snapped) & np.asarray(scene.optimised)
    corners = np.asarray(scene.corners)
    sides = (corners.max(axis=1) - corners.min(axis=1))[parent]
    thin, next_longer, _ = np.sort(sides, axis=1).T
    normal = sides.argmin(axis=1)[:, None] == np.arange(2)
    return normal & (attached & (thin < PLATE_THICKNESS * next_longer))[:, None]


def open_cem(scene: SceneArrays, options: CEMOptions) -> CEM:
    """Build CEM for a scene, with the hyperparameters that the options give."""
    sigma = initial_sigma(scene, options)
    floor, smoothing = on_device((options.sigma_floor, options.smoothing))
    params = CEMParams(sigma, floor, smoothing)
    return CEM(params, options.elite_ratio, options.zero_candidate)
