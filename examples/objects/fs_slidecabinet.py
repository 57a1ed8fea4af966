# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box

# Cabinet, given box 0.53 x 0.68 x 0.30 m: its right half (+y) is closed by a fixed panel, its left
# half by a panel that slides to the right in front of that.
X, Y, Z = 0.53, 0.68, 0.30
PULL, FRONT, WALL = 0.065, 0.024, 0.018
DEPTH = X - PULL - FRONT

cabinet = Object("cabinet", label="wooden cabinet with a sliding door")
cabinet.material("warm_wood", like="pine", rgb=(0.72, 0.43, 0.18))
cabinet.material("grey_metal", like="aluminium", density=2000, rgb=(0.60, 0.61, 0.61))
carcass = cabinet.part("carcass", material="warm_wood")
shell = carcass.add(hollow_box((DEPTH, Y, Z), WALL, open="+x"), by="bottom", name="shell")
x = shell.anchor("front")[0]
half = box((WALL, Y / 2 - WALL, Z - 2 * WALL))
carcass.add(half, at=(x, 0, WALL), by="front.right.bottom", name="fixed_panel")

door = cabinet.part("sliding_door", material="warm_wood")
low, high = -Y / 2, 0.035
panel = door.add(
    box((FRONT - 0.001, high - low, Z - 0.006)),
    at=(x + 0.001, low, 0),
    by="back.right.bottom",
    name="panel",
)
px = panel.anchor("front")[0]
door.add(
    cylinder(0.0165, 0.25),
    at=(px + PULL - 0.0165, low + 0.05, Z / 2),
    material="grey_metal",
    name="bar",
)
for up in (-0.085, 0.085):
    post = (px - 0.004, low + 0.05, Z / 2 + up)
    door.add(
        cylinder(0.012, PULL - 0.013),
        at=post,
        rpy=(0, math.pi / 2, 0),
        by="back",
        material="grey_metal",
    )
cabinet.prismatic("slide", carcass, door, axis=(0, 1, 0), range=(0, 0.30))
