"""Gradient refinement: Adam steps out of interpenetration and toward the photograph's boxes.

Rollouts give no gradient; penetration and projected boxes do. A few steps on them cost less than
one rollout.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from ..physics.layout import Layout
from ..physics.placed import pair_depths
from ..physics.scene_arrays import SceneArrays
from .rewards import deeper
from .semantic import reprojection_error

PEN_SCALE = (0.001, 0.0001)
"""Penetration [m] that costs as much as a box error of one noise unit, at the first and last step.

The early, larger value lets objects pass through each other.
"""


@eqx.filter_jit
def refine_by_gradient(
    scene: SceneArrays,
    layouts: Layout,
    sigma: Layout,
    *,
    steps: int,
    rate: float,
    samples: int,
    photo: bool,
) -> Layout:
    """Descend D_pen from each candidate, with a penalty on the distance moved.

    Minimizes, for each candidate separately, the sum of pair depths over PEN_SCALE, plus half the
    squared distance from the given layout in units of `sigma`, plus, with `photo`,
    `reprojection_error`.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        sigma: standard deviations, pop axis of length 1; objects with zero deviation do not move.
        steps: number of Adam steps.
        rate: learning rate in units of `sigma`; decays to a tenth over the steps.
        samples: number of surface samples per object for the depths, corners first.
        photo: True to include `reprojection_error`.
    """
    free = jax.tree.map(lambda s: (s > 0).astype(jnp.float32), sigma)
    start = jax.tree.map(lambda z, s: z / jnp.maximum(s, 1e-9), layouts, sigma)
    sampled = eqx.tree_at(lambda s: s.samples, scene, scene.samples[:, :samples])

    def loss(unit: Layout, i: Array) -> Float[Array, ""]:
        moved = jax.tree.map(
            lambda u, s, z, f: jnp.where(f > 0, u * s, z), unit, sigma, layouts, free
        )
        poses = scene.place(moved)
        depth = deeper(pair_depths(sampled, poses))
        hard = (1 / PEN_SCALE[0]) * (PEN_SCALE[0] / PEN_SCALE[1]) ** (i / max(steps - 1, 1))
        cost = jnp.sum(depth, axis=(1, 2)) / 2 * hard
        away = jax.tree.map(lambda u, z, f: jnp.sum(f * (u - z) ** 2) / 2, unit, start, free)
        cost = jnp.sum(cost) + sum(jax.tree.leaves(away))
        return cost + jnp.sum(reprojection_error(scene, poses)) if photo else cost

    adam = optax.adam(optax.cosine_decay_schedule(rate, steps, alpha=0.1), b1=0.8)

    def step(i: Array, carry: tuple[Layout, optax.OptState]) -> tuple[Layout, optax.OptState]:
        unit, state = carry
        grad = jax.grad(loss)(unit, i)
        grad = jax.tree.map(lambda g, f: jnp.where(jnp.isfinite(g), g, 0.0) * f, grad, free)
        change, state = adam.update(grad, state)
        return jax.tree.map(jnp.add, unit, change), state

    unit, _ = jax.lax.fori_loop(0, steps, step, (start, adam.init(start)))
    return jax.tree.map(lambda u, s, z, f: jnp.where(f > 0, u * s, z), unit, sigma, layouts, free)
