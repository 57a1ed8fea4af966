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
# gripper grasps a drawer's handle and pulls the drawer open by a script of a few lines, which a
# learned policy would replace.

# %%
import numpy as np

import neoworld_mjx as nw
from neoworld_mjx.program import build
from neoworld_mjx.spec import SceneObject, SceneSpec
from neoworld_mjx.templates import template

# %% [markdown]
# ## A scene
#
# The scene is a fixed cabinet from a template. For a reconstructed scene pass the folder of a run
# instead: `nw.gym_env("out", ...)`.

# %%
cabinet = build(template("drawer_cabinet").program()).spec
scene = SceneSpec(objects=(SceneObject(name="cabinet", spec=cabinet, fixed_base=True),))

# %% [markdown]
# ## The environment
#
# Every part that a joint moves has a handle. The gripper starts 10 cm in front of one, with its
# fingers across it. An action is the target of the tool's displacement from its start [m], of its
# rotation [rad], and of the distance of its fingers [m].

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


go(0.0, -0.10, 0.12, 0.8)  # move forward with open fingers
observation, closed = go(-0.10, -0.10, 0.0, 0.6)  # grasp
print(f"fingers hold something {1e3 * observation['gripper'][7]:.0f} mm thick")
observation, opened = go(-0.10, 0.10, 0.0, 1.6)  # pull
print(f"the drawer was {closed:.3f} m open, and is {opened:.3f} m open")

# %% [markdown]
# ## Result

# %%
picture = env.render()

# %%
assert abs(closed) < 0.002
assert opened > 0.15
assert picture.shape == (320, 480, 3)
