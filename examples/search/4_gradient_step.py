"""A gradient step: D_pen is differentiable, so optax can pull overlapping objects apart."""

import jax
import jax.numpy as jnp
import optax

import neoworld_mjx as nw
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.sweeps import case

scene = compile_scene(case("crowded:3").scene)
zero = nw.Layout.zero(1, len(scene.names))
# Push all objects 1.2 cm towards the middle, so that they overlap.
toward = -0.012 * jnp.sign(jnp.asarray([item.xy for item in scene.spec.objects]))
xy = (toward * scene.optimised[:, None])[None]  # yaw and sizes stay
adam = optax.adam(0.001)
state = adam.init(xy)


@jax.jit
def step(xy, state):
    total = lambda xy: jnp.sum(nw.rewards.d_pen(scene, nw.Layout(xy, zero.yaw, zero.log_scale)))
    depth, slope = jax.value_and_grad(total)(xy)
    updates, state = adam.update(slope, state)
    return optax.apply_updates(xy, updates), state, depth


for k in range(31):
    xy, state, depth = step(xy, state)
    if k % 10 == 0:
        print(f"step {k}: D_pen {1e3 * float(depth):.1f} mm")
