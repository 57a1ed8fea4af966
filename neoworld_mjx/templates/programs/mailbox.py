# Label: mailbox
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, hollow_box

depth = 0.48  # 0.4 to 0.6 m
width = 0.2  # 0.17 to 0.28 m
height = 1.2  # 0.9 to 1.4 m
newspapers = "below"  # one of below, none
roof = "round"  # one of round, gable
colour = "grey"  # one of grey, red, green, black
post = "oak"  # one of oak, pine, steel

COLOURS = {"grey": (0.6, 0.62, 0.64), "red": (0.65, 0.12, 0.1), "green": (0.12, 0.3, 0.2)}
KNOB, FLAG, WALL, LEAF, FOOT = 0.02, 0.012, 0.003, 0.006, 0.04
obj = Object("mailbox", label="mailbox on a post")
paint = obj.material(
    "paint", like="aluminium", density=2000, rgb=COLOURS.get(colour, (0.1, 0.1, 0.11))
)
signal = obj.material("signal", like="aluminium", rgb=(0.85, 0.12, 0.08))
half, deep = width / 2 - FLAG, depth - KNOB - LEAF - 0.0005
x = depth / 2 - KNOB - LEAF - 0.0005
tall = 2.3 * half
floor = height - tall
turns = [math.pi * k / 10 for k in range(11)]
outline = [(half * math.cos(t), tall - half + half * math.sin(t)) for t in turns]
if roof == "gable":
    outline = [(half, tall - 0.7 * half), (0, tall), (-half, tall - 0.7 * half)]
outline = [(-half, 0), (half, 0), *outline]
hole = [(px * (1 - WALL / half), tall / 2 + (pz - tall / 2) * (1 - 2 * WALL / tall))
        for px, pz in outline]  # fmt: skip
fronts = (math.pi / 2, 0, math.pi / 2)  # fmt: skip
body = obj.part("body", material=paint)
body.add(extrusion(outline, deep, [hole]), at=(x - deep / 2, 0, floor), rpy=fronts)
body.add(extrusion(outline, WALL), at=(x - deep + WALL / 2, 0, floor), rpy=fronts)
stem = box((0.09, 0.09, floor - FOOT)) if post != "steel" else cylinder(0.03, floor - FOOT)
post_material = obj.material("post", like=post, density=600)
body.add(stem, at=(-0.05, 0, FOOT), by="bottom", material=post_material)
body.add(
    box((0.75 * depth, width - 2 * FLAG, FOOT)), by="bottom", at=(-0.03, 0, 0), material="concrete"
)
if newspapers == "below":
    tube_box = hollow_box((0.8 * deep, 1.5 * half, 0.12), WALL, open="+x")
    body.add(tube_box, at=(x, 0, floor - 0.012), by="front.top")
    body.add(box((0.2, half, 0.014)), at=(-0.05, 0, floor + 0.001), by="top")
else:
    body.add(box((0.6 * deep, 1.2 * half, 0.02)), at=(-0.02, 0, floor + 0.001), by="top")

door = obj.part("door", material=paint)
door.add(extrusion(outline, LEAF), at=(x + 0.0005 + LEAF / 2, 0, floor), rpy=fronts)
tab = box((KNOB + 0.002, 0.04, 0.012))
door.add(tab, at=(depth / 2, 0, height - 0.03), by="front.top", material=signal)
hinge = (x + LEAF, 0, floor)
obj.revolute("door_hinge", body, door, at=hinge, axis=(0, 1, 0), range=(0, 1.55), opens="front")

# The flag lies along the side and is turned up when there is post to collect.
flag = obj.part("flag", material=signal)
at = (x - 0.2 * deep, -half, floor + 0.45 * tall)
hub = flag.add(cylinder(0.012, 0.005), at=(at[0], at[1] - 0.0005, at[2]),
               rpy=(math.pi / 2, 0, 0), by="left")  # fmt: skip
y = -half - 0.0035
flag.add(box((0.17, 0.003, 0.016)), at=(at[0], y, at[2]), by="front")
flag.add(box((0.06, 0.003, 0.05)), at=(at[0] - 0.165, y, at[2]), by="front")
screw = cylinder(0.006, 0.008)
flag.add(
    screw, at=(at[0], -width / 2, at[2]), rpy=(math.pi / 2, 0, 0), by="right", material="steel"
)
knob = cylinder(0.006, FLAG)
body.add(knob, at=(x - 0.8 * deep, half, at[2]), rpy=(math.pi / 2, 0, 0), by="right")
obj.revolute(
    "flag_turn", body, flag, at=hub.anchor("centre"), axis=(0, 1, 0), range=(0, 1.57), friction=0.15
)
