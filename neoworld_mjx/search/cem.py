"""The Cross-Entropy Method over layouts (paper Algorithm 1), as init / ask / tell.

The elite ratio is static. The initial standard deviations are traced, and so is the random key, so
`jax.vmap` maps over deviations and seeds.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from ..config import CEMOptions
from ..config.search_options import SIGMA_LOG_SCALE, SIGMA_XY, SIGMA_YAW_DEG
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays, on_device

PAPER = np.array([SIGMA_XY, SIGMA_XY, np.radians(SIGMA_YAW_DEG), SIGMA_LOG_SCALE])
"""Initial standard deviations of x, y, yaw and log scale in Appendix B."""
PLATE_THICKNESS = 0.3
"""A box is a plate if its thickness is less than this fraction of its second-shortest side."""


class CEMState(eqx.Module):
    """A diagonal Gaussian over (dx, dy, dyaw, log s) of every object.

    `mean` and `std` are layouts whose population axis has length 1.
    """

    mean: Layout
    std: Layout


class CEM(eqx.Module):
    """The sampling and fitting steps of Algorithm 1; implements `optimizer.Optimizer`."""

    sigma: Layout
    """Initial standard deviations, with a population axis of length 1."""
    widest: Float[Array, ""]
    """Largest multiple of `sigma` to which the deviations of x and y of an object grow while it
    rests in no candidate. At 1, it does not matter what rests, as in Algorithm 1."""
    elite_ratio: float = eqx.field(static=True)
    """Fraction rho of the candidates that are elites: K = rho N."""

    def init(self, mean: Layout | None = None) -> CEMState:
        """Return the initial state. If `mean` is None, the mean is the composed scene."""
        zero = on_device(jax.tree.map(lambda s: np.zeros(s.shape), self.sigma))
        return CEMState(zero if mean is None else mean, self.sigma)

    def ask(self, key: Key[Array, ""], state: CEMState, population: int) -> Layout:
        """Sample a population; `key` must not be used again.

        Objects whose standard deviations are zero, such as environment supports, do not move.
        """
        return draw(key, state.mean, state.std, population)

    def tell(
        self,
        state: CEMState,
        layouts: Layout,
        reward: Float[AnyArray, " pop"],
        *,
        key: Key[Array, ""] | None = None,
        rests: Bool[AnyArray, "pop object"] | None = None,
    ) -> CEMState:
        """Fit the Gaussian of each object to its elites.

        They are the K candidates of highest reward among those in which the object rests. Without
        elites, the Gaussian of an object keeps its mean and widens.

        Args:
            state: previous state.
            layouts: the candidates.
            reward: reward that ranks the candidates. Candidates whose reward is -inf or NaN are
                never elites, so there may be fewer than K elites.
            key: unused.
            rests: mask of the objects that rest in each candidate. If None, all do.
        """
        del key
        count, elites = layouts.yaw.shape[1], elite_count(self.elite_ratio, len(reward))
        counts = jnp.ones((len(reward), count), bool) if rests is None else rests
        ranks = jnp.where(counts | (self.widest <= 1), reward[:, None], -jnp.inf)
        rows, weight = jax.vmap(lambda x: elite_rows(x, elites), 1, 1)(ranks)  # [elite, object]
        total = jnp.sum(weight, axis=0)

        def mean(chosen: Array) -> Array:
            """Return the mean over the elites of each object; chosen is [elite, object, ...]."""
            spread = (..., *(None,) * (chosen.ndim - 2))
            return jnp.sum(chosen * weight[spread], axis=0) / jnp.maximum(total, 1.0)[spread]

        def fit(leaf: Array, old: Array, widened: Array) -> tuple[Array, Array]:
            chosen, fitted = leaf[rows, jnp.arange(count)], total > 0
            fitted = fitted.reshape(-1, *(1,) * (leaf.ndim - 2))
            center = mean(chosen)
            spread = jnp.sqrt(mean((chosen - center) ** 2))
            return jnp.where(fitted, center, old), jnp.where(fitted, spread, widened)

        wide = jnp.minimum(2 * state.std.xy, self.widest * self.sigma.xy)
        widened = Layout(jnp.maximum(state.std.xy, wide), state.std.yaw, state.std.log_scale)
        trees = (jax.tree.leaves(t) for t in (layouts, state.mean, widened))
        fitted = [fit(*leaves) for leaves in zip(*trees, strict=True)]
        return CEMState(Layout(*(m for m, _ in fitted)), Layout(*(s for _, s in fitted)))


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

    A stated deviation holds for all objects. By default, the deviations of an object are those of
    the estimate, so that a search varies what the photograph leaves open, and at most `PAPER`; and
    `PAPER` for an object that was not aligned. Those of x and y are relative to the horizontal
    bounding-box diagonal. The standard deviations of environment supports, and of known poses and
    sizes, are zero. Objects attached to an upright plate, such as a wall, move only along the plate
    and do not turn.
    """
    diagonal, estimated = np.asarray(scene.diagonal), np.array(scene.deviations)
    in_diagonals = np.stack([diagonal, diagonal, *np.ones((2, len(diagonal)))], axis=1)
    yaw = None if options.sigma_yaw_deg is None else np.radians(options.sigma_yaw_deg)
    stated = (options.sigma_xy, options.sigma_xy, yaw, options.sigma_log_scale)
    estimated[~estimated.any(axis=1)] = np.inf
    sigma = np.minimum(estimated, PAPER * in_diagonals)
    for axis, value in enumerate(stated):
        if value is not None:
            sigma[:, axis] = value * in_diagonals[:, axis]
    fixed = _fixed_axes(scene)
    sigma *= np.asarray(scene.optimised)[:, None]
    sigma[:, :2] *= ~fixed
    sigma[:, 2] *= ~fixed.any(axis=1)
    sigma[:, 3] *= np.asarray(scene.resized)
    return on_device(Layout(sigma[None, :, :2], sigma[None, :, 2], sigma[None, :, 3]))


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
    widest = on_device(np.float32(options.widest))
    return CEM(initial_sigma(scene, options), widest, options.elite_ratio)
