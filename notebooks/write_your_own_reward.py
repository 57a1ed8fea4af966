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
# # Write your own reward
#
# A reward term is a function of (scene, layouts, rollout) that returns one number per candidate;
# higher is better. It is vectorised over the population and traced by JAX. This example rewards
# objects that are aligned with the table, which physics alone does not do.

# %%
import jax
import jax.numpy as jnp
import numpy as np

from neoworld_mjx.config import load_config
from neoworld_mjx.search import refine
from neoworld_mjx.spec import Box, GeomSpec, Material, ObjectSpec, PartSpec, SceneObject, SceneSpec

# %% [markdown]
# ## A small scene
#
# A table, which is part of the environment and does not move, and two boxes that the parse has
# rotated slightly.


# %%
def box(name, x, y, z):
    """A wooden box whose origin is the centre of its bottom face."""
    wood = Material(name="wood", density=600, friction=0.5)
    geom = GeomSpec(name="box", shape=Box(size=(x, y, z)), pos=(0, 0, z / 2), material="wood")
    return ObjectSpec(name=name, materials=(wood,), parts=(PartSpec(name="body", geoms=(geom,)),))


askew = {"case": 0.35, "book": -0.3}
scene = SceneSpec(
    objects=(
        SceneObject(name="table", spec=box("table", 0.8, 0.8, 0.04), environment=True, z=-0.04),
        SceneObject(
            name="case",
            spec=box("case", 0.15, 0.1, 0.08),
            parent="table",
            z=0.04,
            yaw=askew["case"],
        ),
        SceneObject(
            name="book",
            spec=box("book", 0.2, 0.14, 0.03),
            parent="table",
            xy=(0.02, 0.2),
            z=0.04,
            yaw=askew["book"],
        ),
    )
)

# %% [markdown]
# ## The term
#
# `rollout.quat` holds every object's rotation, `[candidate, time, object, 4]` with w first, and
# `scene.optimised` marks the objects that the search may move.


# %%
@jax.jit
def square(scene, layouts, rollout):
    """1 where everything ends up parallel to the table's edges, -1 where it stands across."""
    w, x, y, z = jnp.moveaxis(rollout.quat[:, -1], -1, 0)
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.mean(jnp.cos(4 * yaw), axis=1, where=scene.optimised)


# %% [markdown]
# ## Use it in a configuration
#
# A term is named by import path, `package.module:function`, with its weight. This notebook is the
# module `__main__`; in a project it would be `my_rewards:square`.

# %%
config = {
    "refine": {
        "reward": {"terms": {"__main__:square": 1.0}, "w_prior": 0.02},
        "cem": {"population": 64, "iterations": 4},
        "rollout": {"engine": "native"},
    }
}
found = refine(scene, load_config(None, config).refine, seed=0)

# %% [markdown]
# The same search without the term:

# %%
config["refine"]["reward"]["terms"] = {}
plain = refine(scene, load_config(None, config).refine, seed=0)

# %% [markdown]
# ## Before and after


# %%
def degrees_off(yaw):
    """Angle to the nearest edge of the table."""
    return float(np.degrees(abs((yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4)))


def off(refined):
    """The same of both boxes of a refined scene."""
    return {item.name: degrees_off(item.yaw) for item in refined.scene.objects[1:]}


before = {name: degrees_off(yaw) for name, yaw in askew.items()}
without, with_term = off(plain), off(found)
print("degrees off the table's edges: before, refined without the term, with it")
for name in askew:
    print(f"  {name}: {before[name]:5.1f} {without[name]:5.1f} {with_term[name]:5.1f}")
print("stable:", found.measure.s_stab, "- checked:", found.passed)

# %%
assert found.passed
assert sum(with_term.values()) < 0.5 * min(sum(before.values()), sum(without.values()))
