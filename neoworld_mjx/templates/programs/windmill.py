# Label: windmill
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe

depth = 0.24  # 0.2 to 0.3 m
width = 0.42  # 0.34 to 0.5 m
height = 0.56  # 0.5 to 0.7 m
sails = "four"  # one of four, eight
laths = 6  # 4 to 9
tower = "round"  # one of round, smock
walls = "white"  # one of white, brick, wood

LOOK = {"white": (0.92, 0.9, 0.86), "brick": (0.62, 0.32, 0.24), "wood": (0.5, 0.36, 0.24)}
obj = Object("windmill", label="windmill")
plaster = obj.material("plaster", like="pine", rgb=LOOK[walls])
roof = obj.material("roof", like="pine", rgb=(0.28, 0.2, 0.16))
cloth = obj.material("cloth", like="fabric", rgb=(0.93, 0.9, 0.8))
# Upright sails span the width; their upper end is the top of the box.
span = width / 2
hub_z = height - span
SAIL = 0.012
R = 0.5 * (depth - 0.02)
x0 = -depth / 2 + R
eaves, cap_r = hub_z - 0.03, 0.62 * R
body = obj.part("tower", material=plaster)
sectors = 8 if tower == "smock" else 16
outline = [(0, 0), (R, 0), (R, 0.012), (0.88 * R, 0.02), (cap_r, eaves)]
body.add(lathe(outline, thickness=0.006, sectors=sectors), at=(x0, 0, 0))
body.add(cylinder(cap_r - 0.002, 0.005), at=(x0, 0, eaves), by="top")
for z in (0.35, 0.65):
    r = 0.88 * R + (cap_r - 0.88 * R) * z
    window = box((0.006, 0.03, 0.04))
    body.add(window, at=(x0 + r, 0, z * eaves), role="visual", rgb=(0.3, 0.4, 0.45))
# A porch on the left holds the door.
tall, wide, y = 0.3 * eaves, 0.07, R + 0.002
body.add(box((wide, 0.5 * R, tall)), at=(x0, y, 0), by="left.bottom")
body.add(box((wide + 0.014, 0.5 * R, 0.008)), at=(x0, y, tall), by="left.bottom", material=roof)
door = obj.part("door", material=roof)
door.add(box((wide - 0.014, 0.005, tall - 0.012)), at=(x0, y + 0.0005, 0.002), by="right.bottom")
door.add(
    cylinder(0.003, 0.006),
    at=(x0 + 0.02, y + 0.0055, 0.45 * tall),
    rpy=(math.pi / 2, 0, 0),
    by="right",
    material="brass",
)
obj.revolute("door_hinge", body, door, at=door.anchor("back.right"), axis=(0, 0, 1), range=(0, 1.5))

cap = obj.part("cap", material=roof)
z = eaves + 0.0005
dome = [
    (0, 0),
    (cap_r + 0.008, 0),
    (cap_r + 0.008, 0.012),
    (0.75 * cap_r, 0.07),
    (0.2 * cap_r, 0.09),
]
cap.add(lathe(dome, sectors=sectors), at=(x0, 0, z))
nose = 0.5 * depth - SAIL - 0.012 - x0
along = (0, math.pi / 2, 0)
cap.add(cylinder(0.012, nose), at=(x0, 0, hub_z), rpy=along, by="back")
tail = cap_r + 0.006
cap.add(box((0.01, 0.01, 0.08)), at=(x0 - 0.8 * cap_r, 0, z), by="bottom")
obj.continuous("cap_turn", body, cap, at=(x0, 0, z), axis="top")
rotor = obj.part("sails", material=roof)
x = x0 + nose + 0.0005
rotor.add(cylinder(0.02, SAIL), at=(x, 0, hub_z), rpy=along, by="back")
rotor.add(cylinder(0.009, 0.5 * depth - x), at=(x, 0, hub_z), rpy=along, by="back")


def place(t, u, v):
    """Return the point u out along the sail at angle t and v beside it."""
    y, z = u * math.sin(t) + v * math.cos(t), u * math.cos(t) - v * math.sin(t)
    return (x + SAIL / 2, y, hub_z + z)


count = 4 if sails == "four" else 8
for k in range(count):
    t = 2 * math.pi * k / count
    turned = (-t, 0, 0)
    rotor.add(box((0.007, 0.009, span)), at=place(t, span / 2, 0), rpy=turned)
    long = 0.72 * span
    for m in range(laths):
        u = 0.26 * span + m * long / (laths - 1)
        rotor.add(box((0.004, 0.05, 0.004)), at=place(t, min(u, span - 0.003), 0.02), rpy=turned)
    rotor.add(box((0.004, 0.004, long)), at=place(t, 0.26 * span + long / 2, 0.044), rpy=turned)
    sheet = box((0.0012, 0.04, long))
    rotor.add(sheet, at=place(t, 0.26 * span + long / 2, 0.024), rpy=turned, material=cloth)
obj.continuous("sails_turn", cap, rotor, at=(x, 0, hub_z), axis="front")
