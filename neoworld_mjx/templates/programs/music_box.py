# Label: music box with a dancer
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, frustum, hollow_box, sphere

depth = 0.14  # 0.11 to 0.18 m
width = 0.2  # 0.16 to 0.26 m
height = 0.09  # 0.075 to 0.12 m
pins = 14  # 8 to 20
drawer = "yes"  # one of yes, no
wood = "walnut"  # one of walnut, oak, pine
dress = "pink"  # one of pink, white, blue

TINT = {"pink": (0.92, 0.6, 0.68), "white": (0.95, 0.95, 0.93), "blue": (0.5, 0.65, 0.85)}
WALL, LID, CRANK = 0.007, 0.009, 0.03
obj = Object("music_box", label="music box with a dancer")
velvet = obj.material("velvet", like="fabric", rgb=(0.45, 0.08, 0.14))
KNOB = 0.01 if drawer == "yes" else 0.0
x, wide = depth / 2 - KNOB, width - CRANK
left = width / 2
mid_y = left - wide / 2
deep = depth - KNOB
cell = 0.03 if drawer == "yes" else 0.0
top = height - LID - 0.0005
body = obj.part("box", material=wood)
body.add(hollow_box((deep, wide, top - cell), WALL), at=(x, left, cell), by="front.left.bottom")
if cell:
    frame = hollow_box((deep, wide, cell + 0.002), WALL - 0.002, open="+x")
    body.add(frame, at=(x, left, 0), by="front.left.bottom")
    sides = (left - wide + WALL - 0.002, left - WALL + 0.002)
    tray = obj.drawer(
        "drawer",
        body,
        x=x - 0.006,
        y=sides,
        z=(0.005, cell - 0.003),
        depth=deep - 0.015,
        wall=0.003,
        front=0.0055,
        gap=0.001,
    )
    tray.add(sphere(0.006), at=(depth / 2, mid_y, cell / 2), by="front", material="brass")
    tray.add(
        cylinder(0.003, 0.01),
        at=(depth / 2 - 0.006, mid_y, cell / 2),
        rpy=(0, math.pi / 2, 0),
        by="front",
        material="brass",
    )
inside = cell + WALL
floor = box((deep - 2 * WALL, 0.45 * wide, 0.003))
body.add(floor, at=(x - deep / 2, left - WALL, inside), by="left.bottom", material=velvet)

# Drum and comb lie on the right, the dancer stands on the left; all turn with the crank.
across = (math.pi / 2, 0, 0)
R = min(0.016, 0.5 * (top - inside) - 0.003)
axis_z, drum_x = inside + R + 0.003, x - deep / 2
drum_y, long = left - wide + WALL + 0.008, 0.38 * wide
drum = obj.part("drum", material="brass", mass=0.06)
drum.add(cylinder(R - 0.001, long), at=(drum_x, drum_y, axis_z), rpy=across, by="right")
for k in range(pins):
    t, share = 2.4 * k, (k + 0.5) / pins
    at = (
        drum_x + (R - 0.001) * math.cos(t),
        drum_y + share * long,
        axis_z + (R - 0.001) * math.sin(t),
    )
    drum.add(sphere(0.001), at=at)
for y in (drum_y - 0.0045, drum_y + long + 0.0045):
    body.add(
        box((0.012, 0.008, R + 0.004)),
        at=(drum_x, y, inside - 0.001),
        by="bottom",
        material="steel",
    )
comb = box((0.022, long, 0.002))
comb_x = drum_x + R + 0.003
body.add(comb, at=(comb_x, drum_y, axis_z), by="back.right", material="steel")
body.add(
    box((0.012, long, axis_z - inside + 0.001)),
    at=(comb_x + 0.022, drum_y, inside - 0.001),
    by="front.right.bottom",
    material="cast_iron",
)
crank = obj.part("crank", material="brass")
wall_y, out_y = left - wide - 0.0005, -width / 2
hub_z = max(axis_z, 0.0265)
crank.add(cylinder(0.005, 0.008), at=(drum_x, wall_y, hub_z), rpy=across, by="left")
crank.add(box((0.026, 0.004, 0.007)), at=(drum_x - 0.003, wall_y - 0.008, hub_z), by="back.left")
turn = obj.continuous("drum_turn", body, drum, at=(drum_x, drum_y, axis_z), axis="left")
obj.continuous("crank_turn", body, crank, at=(drum_x, wall_y, hub_z), axis="left", mimic=turn)
knob = obj.part("knob", material="walnut")
pin = (drum_x + 0.019, wall_y - 0.0125, hub_z)
knob.add(cylinder(0.006, pin[1] - out_y), at=pin, rpy=across, by="left")
obj.continuous("knob_turn", crank, knob, at=pin, axis="left")
dancer = obj.part("dancer", material="plastic")
at = (drum_x, left - WALL - 0.22 * wide, inside + 0.0035)
tall = top - at[2] - 0.004
dancer.add(cylinder(0.016, 0.003), at=at, by="bottom", rgb=(0.8, 0.65, 0.3))
dancer.add(cylinder(0.002, 0.35 * tall), at=at, by="bottom", rgb=(0.93, 0.78, 0.65))
dancer.add(
    frustum(0.014, 0.003, 0.3 * tall),
    at=(at[0], at[1], at[2] + 0.28 * tall),
    by="bottom",
    rgb=TINT[dress],
)
dancer.add(
    cylinder(0.003, 0.25 * tall),
    at=(at[0], at[1], at[2] + 0.55 * tall),
    by="bottom",
    rgb=TINT[dress],
)
dancer.add(sphere(0.1 * tall), at=(at[0], at[1], top - 0.004), by="top", rgb=(0.93, 0.78, 0.65))
obj.continuous("dance", body, dancer, at=at, axis="top", mimic=turn, multiplier=0.5)
lid = obj.part("lid", material=wood)
lid.add(box((deep, wide, LID)), at=(x, left, height), by="front.left.top")
mirror_glass = box((deep - 0.03, wide - 0.04, 0.001))
lid.add(
    mirror_glass,
    at=(x - deep / 2, mid_y, top + 0.0006),
    by="top",
    role="visual",
    rgb=(0.75, 0.84, 0.88),
)
obj.revolute(
    "lid_hinge",
    body,
    lid,
    at=(x - deep, mid_y, top),
    axis=(0, -1, 0),
    range=(0, 1.7),
    friction=0.06,
)
