"""Gradient refinement: Adam steps out of interpenetration and towards the photograph's boxes.

Physics tells good layouts from bad ones but gives no direction; penetration and projected boxes
do. A few steps on them cost less than one rollout.
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
"""Penetration [m] that costs as much as a box off by its noise, at the first and at the last step.

At first objects may pass through each other, at the end they must not.
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
    """Move candidates down D_pen, staying near where they are.

    Minimises, for each candidate by itself, the sum of pair depths over PEN_SCALE, plus half the
    squared distance from where it was drawn in units of `sigma`, plus, with `photo`,
    `reprojection_error`.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        sigma: standard deviations, pop axis of length 1; objects with none stay where they are.
        steps: of Adam.
        rate: length of a step in units of `sigma`; it falls to a tenth over the steps.
        samples: surface samples of an object that depths are taken at, corners first.
        photo: whether to follow the photograph's boxes too.
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
