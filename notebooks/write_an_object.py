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
# # An object from scratch
#
# Objects are programs that define shapes, parts and joints in a small SDK, in metres and radians,
# with the front along +x. A model writes them from an image; here we write one by hand, with errors
# that the checks detect.

# %%
from IPython.display import Image

from neoworld_mjx.config import VerifyOptions
from neoworld_mjx.export import object_files
from neoworld_mjx.program import build
from neoworld_mjx.render import render_object, to_png
from neoworld_mjx.verify import verify_and_repair

BOX = """
from neoworld_mjx.program.sdk import Object, box, hollow_box

o = Object("chest", "wooden chest")
oak = o.material("oak", like="oak")
body = o.part("body", material=oak)
body.add(hollow_box((0.3, 0.5, 0.25), wall=0.015, open=("+z",)), at=(0, 0, 0), by="bottom")
lid = o.part("lid", material=oak)
lid.add(box((0.3, 0.5, 0.02)), at=(0, 0, {height}), by="bottom")
o.revolute("hinge", body, lid, at=(-0.15, 0, 0.25), axis=(0, -1, 0), range=(0, {widest}))
"""

# %% [markdown]
# ## First version
#
# The lid penetrates the body by 5 mm, and its range is in degrees.

# %%
program = BOX.format(height=0.245, widest=100)
first = build(program)
for signal in first.signals:
    print(signal.listing("chest.py", program))

# %% [markdown]
# ## Corrected version

# %%
chest = build(BOX.format(height=0.2502, widest=1.75))
print("valid:", chest.ok, [signal.phrase() for signal in chest.signals])

# %%
Image(to_png(render_object(chest.spec, width=320, height=220)))

# %%
Image(to_png(render_object(chest.spec, {"hinge": 1.2}, width=320, height=220)))

# %% [markdown]
# ## Is it valid?
#
# The object tests of Step 3: static checks, free fall, pushes, and each joint driven, released and
# held.

# %%
verdict = verify_and_repair(chest.spec, VerifyOptions(rounds=0)).verdict
print("passed:", verdict.passed, "-", len(verdict.checks), "checks,", f"{verdict.mass_kg:.2f} kg")
for check in verdict.checks:
    if check.outcome == "FAIL":
        print(check.scenario, check.name, check.value, check.threshold, check.hint)

# %% [markdown]
# ## Export to every format

# %%
for name, text in sorted(object_files(chest.spec).items()):
    if "/" not in name:
        print(f"{name}: {len(text)} characters")

# %%
assert not first.ok and chest.ok
assert "overlap_at_rest" in {signal.code for signal in first.signals}
