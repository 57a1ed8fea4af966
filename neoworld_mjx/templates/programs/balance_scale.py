# Label: balance scale
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, frustum, lathe, sphere, sweep

depth = 0.16  # 0.12 to 0.2 m
width = 0.44  # 0.34 to 0.56 m
height = 0.42  # 0.34 to 0.52 m
pans = "bowl"  # one of bowl, plate
foot = "box"  # one of box, round
metal = "brass"  # one of brass, steel, black

LOOK = {"brass": (0.78, 0.62, 0.28), "steel": (0.74, 0.75, 0.77), "black": (0.12, 0.12, 0.13)}
obj = Object("balance_scale", label="balance scale")
cast = obj.material("cast", like="aluminium", rgb=LOOK[metal])
R, BASE = min(0.48 * depth, 0.19 * width), 0.05
arm = width / 2 - R
pivot_z = height - 0.045
body = obj.part("stand", material=cast)
if foot == "box":
    body.add(box((depth, 0.6 * width, BASE)), by="bottom", material="walnut")
else:
    plinth = [(0, 0), (depth / 2, 0), (depth / 2, 0.015), (0.3 * depth, BASE)]
    body.add(lathe(plinth, thickness=0.006), material="walnut")
    body.add(cylinder(0.3 * depth, 0.006), at=(0, 0, BASE), by="top")
body.add(frustum(0.018, 0.009, pivot_z - BASE - 0.012), at=(0, 0, BASE), by="bottom")
for x in (-0.009, 0.009):
    body.add(box((0.005, 0.016, 0.03)), at=(x, 0, pivot_z - 0.013), by="centre")
dial = box((0.003, min(0.09, 0.16 * width), 0.03))
body.add(dial, at=(0.012, 0, 0.45 * pivot_z), rgb=(0.95, 0.93, 0.85))

beam = obj.part("beam", material=cast)
path = [(0, -arm, pivot_z + 0.004), (0, -0.5 * arm, pivot_z + 0.022), (0, 0, pivot_z + 0.012),
        (0, 0.5 * arm, pivot_z + 0.022), (0, arm, pivot_z + 0.004)]  # fmt: skip
beam.add(sweep(path, width=0.008, thickness=[0.008, 0.012, 0.018, 0.012, 0.008], smooth=3))
beam.add(box((0.012, 0.02, 0.03)), at=(0, 0, pivot_z + 0.004))
beam.add(sphere(0.01), at=(0, 0, height), by="top")
beam.add(cylinder(0.003, 0.04), at=(0, 0, height - 0.008), by="top")
needle = box((0.002, 0.003, 0.5 * pivot_z))
beam.add(needle, at=(0.0155, 0, pivot_z + 0.01), by="top", rgb=(0.7, 0.1, 0.1))
beam.add(box((0.012, 0.006, 0.008)), at=(0.0105, 0, pivot_z + 0.012))
swing = 0.22
tip = obj.revolute(
    "balance", body, beam, at=(0, 0, pivot_z), axis="front", range=(-swing, swing), friction=0.01
)

# The pans hang level: they turn back as far as the beam tips.
hang = 0.55 * pivot_z
for side, name in ((1, "left"), (-1, "right")):
    pan = obj.part(f"{name}_pan", material=cast)
    y, top = side * arm, pivot_z - 0.0005
    low = top - hang
    pan.add(sphere(0.005), at=(0, y, top), by="top")
    for k in range(3):
        t = 2 * math.pi * k / 3 + 0.5
        rim = (0.93 * R * math.cos(t), y + 0.93 * R * math.sin(t), low + 0.004)
        pan.add(sweep([(0, y, top - 0.005), rim], radius=0.0012))
    if pans == "bowl":
        dish = [(0, 0), (0.4 * R, 0), (0.8 * R, 0.012), (R, 0.03)]
        pan.add(lathe(dish, thickness=0.002), at=(0, y, low - 0.024))
    else:
        dish = [(0, 0), (0.9 * R, 0), (R, 0.007)]
        pan.add(lathe(dish, thickness=0.002), at=(0, y, low - 0.002))
    obj.revolute(
        f"{name}_hang",
        beam,
        pan,
        at=(0, y, pivot_z),
        axis="front",
        range=(-swing, swing),
        mimic=tip,
        multiplier=-1,
    )
