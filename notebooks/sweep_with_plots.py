# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A sweep and its plots
#
# How much does a setting of the search matter? `nw.sweep` refines a scene with every combination of
# some options' values and several seeds; `neoworld sweep FILE.yaml --out DIR` does the same and
# writes a figure, tables and Parquet files. Here the rows are plotted with Matplotlib.

# %%
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown

import neoworld_mjx as nw
from neoworld_mjx.spec import Box, GeomSpec, Material, ObjectSpec, PartSpec, SceneObject, SceneSpec

# %% [markdown]
# ## A scene with errors
#
# Three boxes on a table, as a parse may place them: two penetrate by 3 cm, and half of the third
# extends over the table's edge.


# %%
def box(name, x, y, z):
    """A wooden box whose origin is the centre of its bottom face."""
    wood = Material(name="wood", density=600, friction=0.5)
    geom = GeomSpec(name="box", shape=Box(size=(x, y, z)), pos=(0, 0, z / 2), material="wood")
    return ObjectSpec(name=name, materials=(wood,), parts=(PartSpec(name="body", geoms=(geom,)),))


def on_table(name, size, xy, yaw):
    return SceneObject(name=name, spec=box(name, *size), parent="table", z=0.04, xy=xy, yaw=yaw)


table = SceneObject(name="table", spec=box("table", 0.6, 0.6, 0.04), environment=True, z=-0.04)
scene = SceneSpec(
    objects=(
        table,
        on_table("case", (0.15, 0.10, 0.08), (0.0, 0.0), 0.35),
        on_table("book", (0.20, 0.14, 0.03), (0.0, 0.09), -0.30),
        on_table("tin", (0.08, 0.08, 0.10), (-0.2, -0.275), 0.0),
    )
)

# %% [markdown]
# ## The sweep
#
# Two axes, the search radius and the weight of drift, with three seeds each: eighteen runs, each
# of them one `nw.refine`. Settling alone would repair this scene, and there would be nothing to
# search; without it, candidates are judged where their layouts place them.

# %%
wide, weight = "refine.cem.sigma_xy", "refine.reward.w_drift"
plan = {
    "seeds": [0, 1, 2],
    "base": {
        "refine": {
            "cem": {"population": 24, "iterations": 4, "hold_resting": False, "stop_by": "elites"},
            "settle": {"enabled": False},
            "rollout": {"engine": "native"},
        }
    },
    "axes": {wide: [0.01, 0.03, 0.08], weight: [0.5, 2.0]},
}
found = nw.sweep(plan, cases=[scene])
print(len(found.rows), "runs;", ", ".join(sorted(found.about)))

# %% [markdown]
# The reward uses each point's own weights: where weights differ, compare its terms. `n` is scenes
# times seeds, and brackets are 95 % intervals.

# %%
Markdown(found.table)

# %% [markdown]
# ## Convergence
#
# The best reward so far by iteration: median and range over the seeds.

# %%
widths = sorted({row[wide] for row in found.rows})
weights = sorted({row[weight] for row in found.rows})
figure, places = plt.subplots(1, len(weights), figsize=(7, 2.6), layout="constrained")
for place, w in zip(places, weights, strict=True):
    for sigma in widths:
        runs = [row for row in found.rows if (row[wide], row[weight]) == (sigma, w)]
        longest = max(len(row["history"]) for row in runs)
        best = np.array(
            [
                np.pad([step["best"] for step in row["history"]], (0, longest - n), mode="edge")
                for row in runs
                for n in [len(row["history"])]
            ],
            float,
        )
        t = np.arange(1, longest + 1)
        (line,) = place.plot(t, np.median(best, axis=0), ".-", label=f"sigma_xy {sigma:g}")
        low, high = best.min(axis=0), best.max(axis=0)
        place.fill_between(t, low, high, alpha=0.2, color=line.get_color(), linewidth=0)
    place.set(title=f"w_drift {w:g}", xlabel="iteration", xticks=t)
places[0].set_ylabel("best reward so far")
places[0].legend(fontsize=7)
plt.show()

# %% [markdown]
# ## Both axes, and the trade-off of terms
#
# Left: the share of scenes that passed the final check. Right: drift of objects over their
# agreement with the parse.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(7, 2.6), layout="constrained")
passed = np.array(
    [
        [
            np.mean([row["passed"] for row in found.rows if (row[wide], row[weight]) == (s, w)])
            for s in widths
        ]
        for w in weights
    ]
)
image = left.imshow(100 * passed, vmin=0, vmax=100, origin="lower", aspect="auto")
left.set(title="passed, %", xlabel=wide, ylabel=weight)
left.set_xticks(range(len(widths)), widths)
left.set_yticks(range(len(weights)), weights)
figure.colorbar(image)
for sigma in widths:
    runs = [row for row in found.rows if row[wide] == sigma]
    drift, agreement = ([row[name] for row in runs] for name in ("d_drift", "s_sem"))
    right.plot(drift, agreement, "o", label=f"sigma {sigma:g}")
right.set(title="terms of the winners", xlabel="D_drift", ylabel="S_sem")
right.legend(fontsize=7)
plt.show()

# %%
assert len(found.rows) == 18
assert passed.max() == 1.0
