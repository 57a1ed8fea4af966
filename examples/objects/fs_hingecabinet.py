# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import Object, cylinder, hollow_box

# Cabinet, given box 0.54 x 0.58 x 0.31 m: two doors that open to the sides, with bar handles.
X, Y, Z = 0.54, 0.58, 0.31
PULL, FRONT, WALL = 0.065, 0.025, 0.018
DEPTH = X - PULL - FRONT

cabinet = Object("cabinet", label="wooden cabinet with two doors")
cabinet.material("warm_wood", like="pine", rgb=(0.58, 0.31, 0.13))
cabinet.material("grey_metal", like="aluminium", rgb=(0.55, 0.56, 0.56))
carcass = cabinet.part("carcass", material="warm_wood")
shell = carcass.add(hollow_box((DEPTH, Y, Z), WALL, open="+x"), by="bottom")
x = shell.anchor("front")[0]

for name, hinge, side in (("right_door", "right", -1), ("left_door", "left", 1)):
    low, high = sorted((0.0, side * Y / 2))
    door = cabinet.door(
        name, carcass, x=x, y=(low, high), z=(0, Z - 0.004), hinge=hinge, thickness=FRONT
    )
    px = door.anchor("front")[0]
    bar = (px + PULL - 0.0175, side * 0.05, Z / 2 - 0.01)
    door.add(cylinder(0.0165, 0.25), at=bar, material="grey_metal", name=name + "_bar")
    for up in (-0.085, 0.085):
        post = (px - 0.004, side * 0.05, Z / 2 - 0.01 + up)
        door.add(
            cylinder(0.012, PULL - 0.014),
            at=post,
            rpy=(0, math.pi / 2, 0),
            by="back",
            material="grey_metal",
        )
