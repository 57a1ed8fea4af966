# Label: treasure chest
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, hollow_box, sweep

depth = 0.32  # 0.22 to 0.45 m
width = 0.5  # 0.35 to 0.8 m
height = 0.36  # 0.26 to 0.5 m
straps = 3  # 2 to 5
lid_shape = "barrel"  # one of barrel, gable, flat
metal = "brass"  # one of brass, steel, cast_iron
wood = "oak"  # one of oak, walnut, pine

WALL, STRAP, RING = 0.014, 0.003, 0.02
deep, wide = depth - 0.02 - STRAP, width - 2 * RING
x = depth / 2 - 0.02
rise = {"barrel": 0.42, "gable": 0.35, "flat": 0.16}[lid_shape] * height
seam = height - rise
obj = Object("treasure_chest", label="treasure chest")
fitting = obj.material("fitting", like=metal, density=3000)
body = obj.part("body", material=wood)
body.add(hollow_box((deep, wide, seam - 0.001), WALL), at=(x, 0, 0), by="front.bottom")

# The lid's outline in (x, z) over its middle; half as many points bound it inside.
half, over = deep / 2, rise - STRAP
if lid_shape == "barrel":
    turns = [math.pi * k / 10 for k in range(11)]
    outer = [(half * math.cos(t), 0.25 * over + 0.75 * over * math.sin(t)) for t in turns]
    outer = [(half, 0), *outer, (-half, 0)]
elif lid_shape == "gable":
    outer = [(half, 0), (half, 0.3 * over), (0.3 * half, over), (-0.3 * half, over),
             (-half, 0.3 * over), (-half, 0)]  # fmt: skip
else:
    outer = [(half, 0), (half, over), (-half, over), (-half, 0)]
shrink, middle = 1 - WALL / half, x - half
inner = [(px * shrink, pz * (1 - WALL / over)) for px, pz in reversed(outer)]
upright = (math.pi / 2, 0, 0)
lid = obj.part("lid", material=wood)
lid.add(extrusion(outer + inner, wide), at=(middle, 0, seam), rpy=upright)
for y in (-wide / 2 + WALL / 2, wide / 2 - WALL / 2):
    lid.add(extrusion(outer, WALL), at=(middle, y, seam), rpy=upright)
obj.revolute(
    "lid_hinge", body, lid, at=(x - deep - STRAP, 0, seam), axis=(0, -1, 0), range=(0, 1.6)
)
grow = 1 + STRAP / half
band = [(px * grow, pz * (1 + STRAP / over)) for px, pz in outer]
inside = [(px * 0.99, pz * 0.99) for px, pz in reversed(outer)]
for k in range(straps):
    y = (k / (straps - 1) - 0.5) * (wide - 0.04)
    lid.add(extrusion(band + inside, 0.03), at=(middle, y, seam), rpy=upright, material=fitting)
    hoop = box((STRAP, 0.03, seam - 0.001))
    body.add(hoop, at=(x, y, 0), by="back.bottom", material=fitting)
    body.add(hoop, at=(x - deep, y, 0), by="front.bottom", material=fitting)

# A hasp hangs on the lid before the lock on the body.
mid = 0.02 if straps % 2 == 0 else 0.0
lock = box((STRAP + 0.004, 0.06, 0.05))
body.add(lock, at=(x, mid, seam - 0.015), by="back.top", material=fitting)
hasp = obj.part("hasp", material=fitting)
lug = box((STRAP + 0.005, 0.044, 0.014))
lid.add(lug, at=(x, mid, seam + 0.012), by="back.bottom", material=fitting)
at = (x + STRAP + 0.0055, mid, seam + 0.026)
hasp.add(box((0.005, 0.034, 0.075)), at=at, by="back.top")
hasp.add(
    cylinder(0.006, 0.008),
    at=hasp.anchor("front.bottom"),
    rpy=(0, math.pi / 2, 0),
    by="back.bottom",
)
obj.revolute(
    "hasp_hinge",
    lid,
    hasp,
    at=hasp.anchor("top.back"),
    axis=(0, -1, 0),
    range=(0, 1.5),
    friction=0.05,
)
for side, name in ((1, "left"), (-1, "right")):
    edge, z, reach = side * wide / 2, 0.7 * seam, 0.22 * deep
    for px in (middle - reach, middle + reach):
        eye = box((0.014, 0.012, 0.016))
        face = "right" if side > 0 else "left"
        body.add(eye, at=(px, edge, z), by=face, material=fitting)
    loop = obj.part(f"{name}_handle", material=fitting)
    y, foot = edge + side * (RING - 0.005), reach - 0.0125
    path = [(middle - foot, y, z), (middle - foot, y, z - 0.06), (middle + foot, y, z - 0.06),
            (middle + foot, y, z)]  # fmt: skip
    loop.add(sweep(path, radius=0.005))
    axis = (side, 0, 0)
    obj.revolute(
        f"{name}_handle_hinge",
        body,
        loop,
        at=(middle, y, z),
        axis=axis,
        range=(0, 1.5),
        friction=0.06,
    )
