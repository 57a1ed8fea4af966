# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---
# %% [markdown]
# # A batch of policies in MJX
#
# `nw.mjx_env` makes a scene's environment as pure functions, so `jax.vmap` runs one policy for each
# of many environments and `jax.lax.scan` runs them through time, on a CPU or a GPU. Here a
# linear policy learns to open the upper drawer of a cabinet by a given length and to leave the
# other one closed, by the cross-entropy method over its parameters.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
from IPython.display import Image

import neoworld_mjx as nw
from neoworld_mjx.program import build
from neoworld_mjx.render import render_object, to_png
from neoworld_mjx.spec import SceneObject, SceneSpec
from neoworld_mjx.templates import template

# %% [markdown]
# ## The environment
#
# The scene is a fixed cabinet with two drawers from a template; the folder of a run can replace it.
# Actions are targets of the joint drives [m]. Drives are damped springs, so drawers follow with a
# lag.

# %%
kind = template("drawer_cabinet")
cabinet = build(kind.program(kind.of_box((0.4, 0.4, 0.5)) | {"drawers": 2.0})).spec
scene = SceneSpec(objects=(SceneObject(name="cabinet", spec=cabinet, fixed_base=True),))
env = nw.mjx_env(scene, drive_joints=True)
print("joints:", env.controlled.joints)

# %% [markdown]
# ## Rollouts
#
# A policy is a matrix from the observation (joint positions, velocities, and 1) to the targets. A
# rollout is one second of 50 control steps; `vmap` batches it, with one policy per environment.

# %%
GOAL_M, POPULATION, ELITES = 0.12, 24, 6
size = (env.action_size, 2 * len(env.controlled.joints) + 1)


def rollout(policy):
    """Return the joints at every step [50, joint] m."""

    def step(state, _):
        seen = jnp.concatenate([state.obs["joints"], state.obs["joint_velocities"], jnp.ones(1)])
        state = env.step(state, policy @ seen)
        return state, state.obs["joints"]

    return jax.lax.scan(step, env.reset(jax.random.key(0)), length=50)[1]


rollouts = jax.jit(jax.vmap(rollout))


def reward(joints):
    """Mean distance from the goal over the second half, negative [m]."""
    goal = jnp.zeros(joints.shape[-1]).at[-1].set(GOAL_M)
    return -jnp.abs(joints[:, 25:] - goal).mean(axis=(1, 2))


# %% [markdown]
# ## Learning
#
# Each of four generations samples policies around a mean, rolls all of them out at once, and fits
# mean and standard deviation to the best.

# %%
mean, deviation, key = jnp.zeros(size), 0.2 * jnp.ones(size), jax.random.key(1)
history, paths = [], []
for generation in range(4):
    key, draw = jax.random.split(key)
    policies = mean + deviation * jax.random.normal(draw, (POPULATION, *size))
    joints = rollouts(policies)
    rewards = reward(joints)
    best = policies[jnp.argsort(-rewards)[:ELITES]]
    mean, deviation = best.mean(axis=0), best.std(axis=0) + 0.01
    history.append(rewards)
    paths.append(joints[jnp.argmax(rewards)])
    print(f"generation {generation + 1}: best mean error {-1e3 * rewards.max():.1f} mm")

# %% [markdown]
# ## Result

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(7, 2.6), layout="constrained")
rounds = jnp.arange(1, 5)
every = 1e3 * jnp.array(history)
left.fill_between(rounds, every.min(axis=1), every.max(axis=1), alpha=0.2, linewidth=0)
left.plot(rounds, jnp.median(every, axis=1), ".-", label="median of the batch")
left.plot(rounds, every.max(axis=1), ".-", label="best")
left.set(xlabel="generation", ylabel="reward, mm", xticks=rounds)
left.legend(fontsize=7)
time = 0.02 * jnp.arange(1, 51)
for k, path in enumerate(paths):
    right.plot(time, 1e3 * path[:, -1], label=f"generation {k + 1}")
right.axhline(1e3 * GOAL_M, color="k", lw=0.8, ls=":")
right.set(xlabel="time, s", ylabel="upper drawer, mm", title="best policy of each")
right.legend(fontsize=7)
plt.show()

# %%
last = {
    name.removeprefix("cabinet-"): float(value)
    for name, value in zip(env.controlled.joints, paths[-1][-1], strict=True)
}
Image(to_png(render_object(cabinet, last, width=320, height=220)))

# %%
assert history[-1].max() > 0.5 * history[0].max()
assert abs(paths[-1][-1, -1] - GOAL_M) < 0.03
