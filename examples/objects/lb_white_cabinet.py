# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box

# Chest, given box 0.47 x 0.58 x 0.50 m: three equal drawers with thick bar handles under a top that
# laps over at the sides and in front.
X, Y, Z = 0.47, 0.58, 0.50
TOP, LAP, WALL, FRONT, PULL = 0.018, 0.02, 0.018, 0.018, 0.065
DEPTH = X - FRONT - PULL
WIDE, HIGH = Y - 2 * LAP, Z - TOP

chest = Object("chest", label="white chest of three drawers")
chest.material("white", like="mdf", rgb=(0.86, 0.86, 0.87))
chest.material("dark_metal", like="aluminium", rgb=(0.33, 0.35, 0.35))
carcass = chest.part("carcass", material="white")
shell = carcass.add(hollow_box((DEPTH, WIDE, HIGH), WALL, open="+x"), by="bottom")
x = shell.anchor("front")[0]
carcass.add(
    box((DEPTH + FRONT + 0.01, Y, TOP)),
    at=(x + FRONT + 0.01, 0, HIGH),
    by="front.bottom",
    name="top",
)
# The sides reach forward past the drawers' fronts, which lie between them.
for side in (-1, 1):
    edge = (x, side * (WIDE / 2 - WALL / 2), 0)
    carcass.add(box((FRONT, WALL, HIGH)), at=edge, by="back.bottom")

inside = (-WIDE / 2 + WALL, WIDE / 2 - WALL)
STEP = (HIGH - 2 * WALL) / 3
for k, name in enumerate(("bottom_drawer", "middle_drawer", "top_drawer")):
    low = WALL + k * STEP
    # A thin floor under the upper two carries them.
    if k:
        carcass.add(box((DEPTH - 0.01, WIDE - 2 * WALL, 0.006)), at=(0, 0, low - 0.003))
    z = (low + (0.004 if k else 0), low + STEP - (0.003 if k < 2 else 0) - 0.001)
    drawer = chest.drawer(name, carcass, x=x, y=inside, z=z, depth=DEPTH - WALL - 0.01, front=FRONT)
    px, _, pz = drawer.anchor("front")
    bar = (px + PULL - 0.021, 0, pz)
    drawer.add(
        cylinder(0.02, 0.21),
        at=bar,
        rpy=(math.pi / 2, 0, 0),
        material="dark_metal",
        name=name + "_bar",
    )
    for side in (-0.07, 0.07):
        post = (px - 0.004, side, pz)
        drawer.add(
            cylinder(0.012, PULL - 0.02),
            at=post,
            rpy=(0, math.pi / 2, 0),
            by="back",
            material="dark_metal",
        )
