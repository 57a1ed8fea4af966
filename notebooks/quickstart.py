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
# # From a photograph to a simulation
#
# One photograph in, a scene out that MuJoCo can step. The repository contains the photograph and a
# tape of the models' responses, so no API key is needed; everything else is computed here.

# %%
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import PIL.Image
from IPython.display import Image

import neoworld_mjx as nw
from neoworld_mjx.config import load_config

photo = Path("../examples/coffee.png")
PIL.Image.open(photo).resize((240, 160))

# %% [markdown]
# ## Reconstruct it
#
# The five steps are parse, program, verify, compose and refine. This example uses a small search;
# omit `config` for the full one. The output folder contains all results; start with `report.html`.

# %%
small = {
    "refine": {"cem": {"population": 24, "iterations": 2}},
    "render": {"width": 320, "supersample": 1},
}
folder = Path(tempfile.mkdtemp()) / "out"
result = nw.reconstruct(photo, folder, load_config(overrides=small))
print("objects:", ", ".join(result.objects))
print("seconds per step:", ", ".join(result.seconds))
print("model calls:", result.cost["calls"], "- cost:", result.cost["cost_usd"], "USD")

# %% [markdown]
# The scene before and after the search:

# %%
Image(folder / "pictures" / "before.png")

# %%
Image(folder / "pictures" / "after.png")

# %% [markdown]
# ## Is it valid?
#
# In two seconds of free fall no object may move by 1 cm, rotate by 5 degrees or penetrate by 1 mm.

# %%
limits = {"max_depth_m": 0.001, "max_drift_m": 0.01, "max_tilt_deg": 5.0}
for name, limit in limits.items():
    print(f"{name} {result.metrics[name]:.2g}, limit {limit:g}")
print("valid:", result.passed)

# %% [markdown]
# ## Step it in MuJoCo

# %%
model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
start = data.xpos.copy()
for _ in range(250):
    mujoco.mj_step(model, data)
moved = np.linalg.norm(data.xpos - start, axis=1).max()
print(f"{model.nbody - 1} bodies moved by at most {1000 * moved:.1f} mm in {data.time:.1f} s")

# %%
assert {"table", "saucer", "cup", "spoon"} == set(result.objects)
assert moved < 0.02
