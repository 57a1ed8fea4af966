# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, hollow_box, sweep

# Microwave oven, given box 0.375 x 0.52 x 0.29 m: a door with a window, hinged on the viewer's left
# (-y), its handle beside the control panel; a plate turns inside.
X, Y, Z = 0.375, 0.52, 0.29
PULL, FRONT, WALL = 0.042, 0.03, 0.012
DEPTH = X - PULL - FRONT
SPLIT = 0.17  # between door and control panel, along y

oven = Object("microwave", label="black microwave oven")
# Sheet metal and plastic over air.
oven.material("case", like="plastic", density=700, rgb=(0.10, 0.10, 0.10))
oven.material("pane", like="glass", rgb=(0.16, 0.16, 0.16))
oven.material("pull", like="aluminium", density=1500, rgb=(0.62, 0.62, 0.61))
body = oven.part("body", material="case")
shell = body.add(hollow_box((DEPTH, Y, Z), WALL, open="+x"), by="bottom", name="shell")
x = shell.anchor("front")[0]
body.add(box((DEPTH - WALL, 0.01, Z - 2 * WALL)), at=(WALL / 2, SPLIT, Z / 2), name="divider")
panel = body.add(
    box((FRONT, Y / 2 - SPLIT - 0.002, Z)), at=(x, Y / 2, 0), by="back.left.bottom", name="controls"
)
px, py, _ = panel.anchor("front")
body.add(
    box((0.001, 0.07, 0.19)), at=(px, py, 0.165), role="visual", rgb=(0.13, 0.13, 0.13), name="keys"
)
body.add(
    box((0.002, 0.07, 0.026)),
    at=(px, py, 0.035),
    role="visual",
    rgb=(0.55, 0.55, 0.54),
    name="strip",
)

plate = oven.part("plate", material="glass")
MID = (-Y / 2 + WALL + SPLIT) / 2
hub = plate.add(cylinder(0.02, 0.012), at=(0, MID, WALL + 0.001), by="bottom", name="hub")
plate.add(cylinder(0.125, 0.006), at=hub.anchor("top"), by="bottom", name="disc")
oven.continuous("turn", body, plate, at=hub.anchor("centre"), axis=(0, 0, 1))

door = oven.part("door", material="case")
low, high = -Y / 2, SPLIT - 0.002
outline = [(low, 0), (high, 0), (high, Z), (low, Z)]
WINDOW = [(-0.175, 0.055), (0.085, 0.055), (0.085, 0.235), (-0.175, 0.235)]
# The outline's (x, y) become (y, z), its height x.
upright = (math.pi / 2, 0, math.pi / 2)
frame = door.add(
    extrusion(outline, FRONT - 0.0005, holes=[WINDOW]),
    at=(x + FRONT / 2 + 0.00025, 0, 0),
    rpy=upright,
    name="frame",
)
door.add(box((0.006, 0.262, 0.182)), at=(x + 0.008, -0.045, 0.145), material="pane", name="window")
fx = x + FRONT
R, H = 0.013, 0.10
bar = [
    (fx - 0.004, 0.128, 0.145 - H),
    (fx + PULL - R, 0.128, 0.145 - H),
    (fx + PULL - R, 0.128, 0.145 + H),
    (fx - 0.004, 0.128, 0.145 + H),
]
door.add(sweep(bar, radius=R), material="pull", name="handle")
oven.revolute("hinge", body, door, at=frame.anchor("right.back"), axis=(0, 0, -1), range=(0, 1.57))
