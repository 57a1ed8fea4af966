# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    extrusion,
    rounded_box,
    sphere,
    sweep,
    tube,
)

# Desk, given box 0.53 x 1.19 x 0.95 m: a drawer under the top; behind it a slanted back with an
# open compartment, a sliding door before it, and a lever in two slots; a push button on the top.
Y, DESK, BACK = 1.19, 0.61, 0.90  # width, height of the top, height of the slanted back
X0, X1 = -0.235, 0.235  # back and front of the top
LEG, SLAB = 0.06, 0.05
FOOT, HEAD = 0.035, -0.195  # where the slant begins (on the top) and ends (at the head), along x
ALONG = (math.pi / 2, 0, 0)  # outlines (x, z), drawn out along y

desk = Object("desk", label="wooden desk with a slanted back")
desk.material("wood", like="oak", rgb=(0.60, 0.37, 0.18))
desk.material("black", like="plastic", rgb=(0.03, 0.03, 0.03))
desk.material("white", like="plastic", rgb=(0.92, 0.92, 0.92))
body = desk.part("body", material="wood")
body.add(box((X1 - X0, Y, SLAB)), at=(0, 0, DESK), by="top", name="top")
for k, (sx, sy) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
    foot = (sx * (X1 - LEG / 2), sy * (Y / 2 - LEG / 2), 0)
    body.add(box((LEG, LEG, DESK - SLAB)), at=foot, by="bottom", name=f"leg_{k}")
# Aprons under the top; the front one leaves the drawer's opening.
LOW = 0.44
D0, D1 = -0.06, 0.47  # the drawer's opening along y
for sy in (-1, 1):
    side = (0, sy * (Y / 2 - 0.02), DESK - SLAB)
    body.add(box((X1 - X0 - 2 * LEG, 0.02, DESK - SLAB - LOW)), at=side, by="top")
body.add(box((0.02, Y - 2 * LEG, DESK - SLAB - LOW)), at=(X0 + 0.02, 0, DESK - SLAB), by="top.back")
for low, high in ((-Y / 2 + LEG, D0), (D1, Y / 2 - LEG)):
    face = (X1 - 0.03, (low + high) / 2, DESK - SLAB)
    body.add(box((0.02, high - low, DESK - SLAB - LOW)), at=face, by="top.front")
for y in (D0 - 0.01, D1 + 0.01):
    body.add(box((X1 - X0 - 0.07, 0.02, DESK - SLAB - LOW)), at=(-0.005, y, DESK - SLAB), by="top")
body.add(box((X1 - X0 - 0.07, D1 - D0 + 0.04, 0.01)), at=(-0.005, (D0 + D1) / 2, LOW), by="bottom")

drawer = desk.drawer(
    "drawer",
    body,
    x=X1 - 0.03,
    y=(D0, D1),
    z=(LOW + 0.01, DESK - SLAB),
    depth=0.36,
    front=0.035,
    travel=0.25,
)
px, py, pz = drawer.anchor("front")
W = 0.15
bar = [
    (px - 0.005, py - W, pz),
    (px + 0.04, py - W, pz),
    (px + 0.04, py + W, pz),
    (px - 0.005, py + W, pz),
]
drawer.add(sweep(bar, width=0.035, thickness=0.025), material="black", name="pull")


# The slanted back: cheeks, a head, a back wall, and a closed panel on the right.
def slant(z):
    return FOOT + (HEAD - FOOT) * (z - DESK) / (BACK - DESK)


cheek = [(X0, DESK), (FOOT, DESK), (HEAD, BACK), (X0, BACK)]
body.add(extrusion(cheek, 0.09), at=(0, -Y / 2 + 0.045, 0), rpy=ALONG, name="left_cheek")
body.add(extrusion(cheek, 0.03), at=(0, Y / 2 - 0.015, 0), rpy=ALONG, name="right_cheek")
head = [(X0, 0.85), (slant(0.85), 0.85), (HEAD, BACK), (X0, BACK)]
body.add(extrusion(head, Y), rpy=ALONG, name="head")
body.add(box((0.02, Y, BACK - DESK)), at=(X0, 0, DESK), by="back.bottom", name="back_wall")
plate = [(FOOT - 0.03, DESK), (FOOT, DESK), (HEAD, BACK), (HEAD - 0.03, BACK)]
P0 = 0.22
body.add(extrusion(plate, Y / 2 - P0), at=(0, (Y / 2 + P0) / 2, 0), rpy=ALONG, name="plate")
body.add(
    box((0.04, 0.27, 0.028)),
    at=(X0 + 0.02, -0.38, BACK),
    by="bottom",
    material="white",
    name="strip",
)
body.add(sphere(0.03), at=(X0 + 0.02, 0.27, BACK + 0.02), material="white", name="bulb")
body.add(tube(0.05, 0.012, 0.02), at=(0.12, -0.36, DESK), by="bottom", name="collar")

# Everything on the slant is placed by how far up it lies, and how far before it.
A = math.atan2(FOOT - HEAD, BACK - DESK)
UP, OUT = (-math.sin(A), 0, math.cos(A)), (math.cos(A), 0, math.sin(A))
TILT = (0, -A, 0)


def on_slant(up, y, out):
    return (FOOT + up * UP[0] + out * OUT[0], y, DESK + up * UP[2] + out * OUT[2])


door = desk.part("sliding_door", material="wood")
door.add(box((0.022, 0.40, 0.33)), at=on_slant(0.178, 0.02, 0.0118), rpy=TILT, name="panel")
grip = [
    on_slant(0.08, 0.04, 0.02),
    on_slant(0.08, 0.04, 0.06),
    on_slant(0.28, 0.04, 0.06),
    on_slant(0.28, 0.04, 0.02),
]
door.add(sweep(grip, width=0.04, thickness=0.025), material="black", name="grip")
desk.prismatic("slide", body, door, axis=(0, -1, 0), range=(0, 0.30))

for y in (0.33, 0.43):
    slot = on_slant(0.21, y, 0.0005)
    body.add(box((0.001, 0.008, 0.17)), at=slot, rpy=TILT, role="visual", rgb=(0.05, 0.04, 0.03))
lever = desk.part("lever", material="white")
lever.add(
    rounded_box((0.03, 0.15, 0.03), 0.008), at=on_slant(0.15, 0.38, 0.045), rpy=TILT, name="bar"
)
for y in (0.33, 0.43):
    lever.add(box((0.034, 0.006, 0.02)), at=on_slant(0.15, y, 0.0178), rpy=TILT)
desk.prismatic("flip", body, lever, axis=UP, range=(0, 0.12))

button = desk.part("button", material="black")
button.add(cylinder(0.0372, 0.022), at=(0.12, -0.36, DESK + 0.011), by="bottom", name="cap")
desk.prismatic("press", body, button, axis=(0, 0, -1), range=(0, 0.01))
