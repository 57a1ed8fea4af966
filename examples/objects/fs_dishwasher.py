# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, hollow_box, sweep

# Dishwasher, given box 0.70 x 0.65 x 0.80 m: a flap hinged at its lower edge under a control panel.
X, Y, Z = 0.70, 0.65, 0.80
PULL, FLAP = 0.062, 0.03
DEPTH = X - PULL - FLAP  # of the body; flap and handle stand before it
TOE, PANEL = 0.03, 0.70  # heights of the plinth and of the control panel's lower edge

washer = Object("dishwasher", label="grey dishwasher")
# Sheet metal over insulation: far lighter than solid steel.
washer.material("sheet", like="steel", density=500, rgb=(0.52, 0.52, 0.51))
steel = washer.material("pull", like="steel", density=2000, rgb=(0.62, 0.62, 0.61))
body = washer.part("body", material="sheet")
body.add(box((DEPTH - 0.03, Y, TOE)), at=(-0.015, 0, 0), by="bottom", name="plinth")
shell = body.add(
    hollow_box((DEPTH, Y, Z - TOE), 0.025, open="+x"), at=(0, 0, TOE), by="bottom", name="shell"
)
x = shell.anchor("front")[0]
# The control panel closes the top of the front and leans out a little towards its upper edge.
panel = [(0, 0), (FLAP - 0.008, 0), (FLAP, 0.035), (FLAP, Z - PANEL), (0, Z - PANEL)]
body.add(extrusion(panel, Y), at=(x, 0, PANEL), rpy=(math.pi / 2, 0, 0), name="panel")
slot = (x + FLAP - 0.004, 0.03, PANEL + 0.025)
body.add(box((0.002, 0.08, 0.006)), at=slot, role="visual", rgb=(0.8, 0.8, 0.8), name="latch")
# Two racks inside, fast: nothing of them is to be seen.
for z in (0.22, 0.45):
    body.add(hollow_box((DEPTH - 0.08, Y - 0.052, 0.08), 0.004), at=(0, 0, z), by="bottom")

flap = washer.door(
    "flap",
    body,
    x=x,
    y=(-Y / 2 + 0.012, Y / 2 - 0.012),
    z=(TOE + 0.004, PANEL - 0.002),
    hinge="bottom",
    thickness=FLAP,
    opens=1.5,
)
px = flap.anchor("front")[0]
R, W, H = 0.018, 0.285, 0.655
bar = [(px - 0.005, -W, H), (px + PULL - R, -W, H), (px + PULL - R, W, H), (px - 0.005, W, H)]
flap.add(sweep(bar, radius=R), material="pull", name="handle")
badge = (px + 0.001, 0, 0.16)
flap.add(
    cylinder(0.05, 0.002), at=badge, rpy=(0, math.pi / 2, 0), role="visual", rgb=(0.45, 0.45, 0.44)
)
