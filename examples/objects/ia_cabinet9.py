# Written by hand through the mailbox, from a picture of the object alone.
from neoworld_mjx.program.sdk import Object, box, hollow_box, sweep

# Base cabinet without a worktop, given box 0.545 x 0.60 x 0.75 m: three drawers, low, middle and
# high, whose fronts cover the whole carcass.
X, Y, Z = 0.545, 0.60, 0.75
PULL, FRONT, WALL = 0.03, 0.018, 0.018
DEPTH = X - PULL - FRONT

cabinet = Object("cabinet", label="grey base cabinet with three drawers, open at the top")
cabinet.material("light", like="chipboard", rgb=(0.72, 0.72, 0.72))
cabinet.material("front", like="mdf", rgb=(0.66, 0.66, 0.66))
carcass = cabinet.part("carcass", material="light")
shell = carcass.add(hollow_box((DEPTH, Y, Z), WALL, open=["+x", "+z"]), by="bottom", name="shell")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
# Two rails hold the sides together at the top.
rail = box((0.10, Y - 2 * WALL, WALL))
carcass.add(rail, at=(x, 0, Z), by="front.top", name="front_rail")
carcass.add(rail, at=(back + WALL, 0, Z), by="back.top", name="back_rail")

OVER = WALL - 0.001
inside = (-Y / 2 + WALL, Y / 2 - WALL)
for name, low, high, grip in (
    ("bottom_drawer", 0.0, 0.372, 0.325),
    ("middle_drawer", 0.375, 0.617, 0.585),
    ("top_drawer", 0.62, Z, 0.722),
):
    z = (low + OVER + 0.001, high - OVER - 0.001)
    drawer = cabinet.drawer(
        name,
        carcass,
        x=x,
        y=inside,
        z=z,
        depth=DEPTH - WALL - 0.02,
        front=FRONT,
        overlay=OVER,
        material="front",
    )
    px, W, R = drawer.anchor("front")[0], 0.09, PULL - 0.005
    bar = [(px - 0.002, -W, grip), (px + R, -W, grip), (px + R, W, grip), (px - 0.002, W, grip)]
    drawer.add(sweep(bar, width=0.012, thickness=0.010), material="steel", name=name + "_handle")
