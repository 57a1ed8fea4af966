"""An MJX loop of your own: push one object of every candidate, harder and harder."""

import jax
import jax.numpy as jnp

import neoworld_mjx as nw
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.sweeps import case

POPULATION, STEPS = 8, 50
scene = compile_scene(case("crowded:1").scene)
layouts = nw.Layout.zero(POPULATION, len(scene.names))
model, axes, data = nw.mjx_batch(scene, layouts)
body = scene.static.mjm.nbody - 1  # the last object
force = jnp.linspace(0.0, 4.0, POPULATION)  # N, along x
push = data.xfrc_applied.at[:, body, 0].set(force)


@jax.jit
def simulate(model, data):
    step = jax.vmap(nw.mjx_step, in_axes=(axes, 0))
    return jax.lax.fori_loop(0, STEPS, lambda _, d: step(model, d), data)


end = simulate(model, data.replace(xfrc_applied=push))
moved = jnp.linalg.norm(end.qpos[:, -7:-4] - data.qpos[:, -7:-4], axis=1)
for f, d in zip(force, moved, strict=True):
    print(f"{float(f):.1f} N: moved {1e3 * float(d):.1f} mm in {STEPS * 0.004:.1f} s")
