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
# # Open a drawer
#
# A scene becomes a [Gymnasium](https://gymnasium.farama.org) environment in one call. Here a free
# gripper takes a drawer's handle and pulls it out, by a script of four lines; a learner would
# stand in its place.

# %%
import numpy as np

import neoworld_mjx as nw
from neoworld_mjx.program import build
from neoworld_mjx.spec import SceneObject, SceneSpec
from neoworld_mjx.templates import template

# %% [markdown]
# ## A scene
#
# A cabinet from a template, fastened. In place of it goes the folder of a run:
# `nw.gym_env("out", ...)`.

# %%
cabinet = build(template("drawer_cabinet").program()).spec
scene = SceneSpec(objects=(SceneObject(name="cabinet", spec=cabinet, fixed_base=True),))

# %% [markdown]
# ## The environment
#
# Every part that a joint moves has a handle. The gripper starts 10 cm in front of one, with its
# fingers across it. An action is where the tool should be beside its start [m], how it should be
# turned [rad], and how far its fingers should be apart [m].

# %%
env = nw.gym_env(
    scene,
    gripper="cabinet-drawer_3_handle",
    reward=lambda observation: float(observation["joints"][2]),
)
observation, _ = env.reset(seed=0)
print("actions:", env.action_space)
print("observations:", {name: value.shape for name, value in observation.items()})
print("joints:", env.controlled.joints)

# %% [markdown]
# ## The script


# %%
def go(start, end, opening, seconds):
    """Move the tool's target along x, from and to [m] beside its start."""
    for x in np.linspace(start, end, round(seconds / 0.02)):
        action = np.array([x, 0, 0, 0, 0, 0, opening], np.float32)
        observation, reward, terminated, _, _ = env.step(action)
        assert not terminated
    return observation, reward


go(0.0, -0.10, 0.12, 0.8)  # forwards, with open fingers
observation, closed = go(-0.10, -0.10, 0.0, 0.6)  # take hold
print(f"fingers hold something {1e3 * observation['gripper'][7]:.0f} mm thick")
observation, opened = go(-0.10, 0.10, 0.0, 1.6)  # pull
print(f"the drawer was {closed:.3f} m open, and is {opened:.3f} m open")

# %% [markdown]
# ## What it looks like

# %%
picture = env.render()

# %%
assert abs(closed) < 0.002
assert opened > 0.15
assert picture.shape == (320, 480, 3)
