# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, grid, hollow_box, tube

# Kitchen range, given box 0.74 x 0.557 x 1.335 m: an oven with a flap, a drawer under it, four
# burners; above it, held to the wall, a box with four knobs and a toggle lever.
Y, TOP, Z = 0.557, 0.90, 1.335
DEPTH, FRONT, PULL = 0.67, 0.03, 0.04
LOW, HIGH = 0.22, 0.747  # the flap's lower and upper edge
HOOD, REACH = 1.21, 0.374  # height of the upper box's bottom, and its depth

range_ = Object("range", label="grey kitchen range with a control box above")
range_.material("sheet", like="steel", density=500, rgb=(0.62, 0.62, 0.61))
range_.material("black", like="glass", density=700, rgb=(0.08, 0.08, 0.08))
range_.material("knob_grey", like="plastic", rgb=(0.62, 0.62, 0.60))
range_.material("bar_black", like="aluminium", density=1500, rgb=(0.08, 0.08, 0.08))
body = range_.part("body", material="sheet")
shell = body.add(hollow_box((DEPTH, Y, TOP - 0.02), 0.02, open="+x"), by="bottom", name="shell")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
cook = body.add(
    box((DEPTH + FRONT, Y, 0.02)),
    at=(back, 0, TOP - 0.02),
    by="back.bottom",
    material="black",
    name="cooktop",
)
for px, py, _ in grid((2, 2), (0.34, 0.27), (0.0, 0, 0)):
    ring = tube(0.075, 0.008, 0.002)
    body.add(ring, at=(px, py, TOP), by="bottom", role="visual", rgb=(0.6, 0.6, 0.6))
body.add(box((DEPTH - 0.02, Y - 0.04, 0.016)), at=(0.01, 0, 0.209), name="oven_floor")
body.add(box((DEPTH - 0.02, Y - 0.04, 0.016)), at=(0.01, 0, HIGH + 0.008), name="oven_roof")
body.add(box((FRONT, Y, TOP - 0.02 - HIGH)), at=(x, 0, HIGH), by="back.bottom", name="fascia")
body.add(box((0.5, Y - 0.04, 0.008)), at=(0, 0, 0.45), name="rack")
# The wall that carries the upper box is not part of it: two thin rods stand for it.
upper = body.add(
    box((REACH, Y - 0.01, Z - HOOD)),
    at=(back, 0, HOOD),
    by="back.bottom",
    material="black",
    name="upper_box",
)
for side in (-0.2, 0.2):
    body.add(
        cylinder(0.006, HOOD - TOP), at=(back + 0.008, side, TOP), by="bottom", material="steel"
    )

flap = range_.part("flap", material="sheet")
face = flap.add(
    box((FRONT, Y - 0.002, HIGH - LOW - 0.004)), at=(x + 0.0005, 0, LOW + 0.002), by="back.bottom"
)
fx = face.anchor("front")[0]
flap.add(
    box((0.002, 0.40, 0.245)),
    at=(fx, 0.005, 0.54),
    role="visual",
    rgb=(0.08, 0.08, 0.08),
    name="window",
)
flap.add(
    tube(0.065, 0.02, 0.006, sectors=6),
    at=(fx + 0.002, 0.005, 0.54),
    rpy=(0, math.pi / 2, 0),
    role="visual",
    rgb=(0.6, 0.6, 0.6),
    name="badge",
)
# Turned about its lower front edge, so that it does not dip into the drawer's front.
range_.revolute(
    "flap_hinge", body, flap, at=face.anchor("bottom.front"), axis=(0, 1, 0), range=(0, 1.5)
)
drawer = range_.drawer(
    "drawer",
    body,
    x=x,
    y=(-Y / 2 + 0.02, Y / 2 - 0.02),
    z=(0.02, 0.20),
    depth=0.55,
    front=FRONT,
    overlay=0.018,
    travel=0.35,
)
along = (math.pi / 2, 0, 0)
outward = (0, math.pi / 2, 0)
for part, z in ((flap, 0.71), (drawer, 0.165)):
    part.add(cylinder(0.011, 0.33), at=(fx + PULL - 0.011, 0, z), rpy=along, material="bar_black")
    for side in (-0.12, 0.12):
        part.add(
            cylinder(0.008, PULL - 0.007),
            at=(fx - 0.004, side, z),
            rpy=outward,
            by="back",
            material="bar_black",
        )

ux = upper.anchor("front")[0]
for name, y, z in (
    ("knob_upper_a", -0.144, 1.302),
    ("knob_upper_b", -0.077, 1.302),
    ("knob_lower_a", -0.144, 1.243),
    ("knob_lower_b", -0.077, 1.243),
):
    knob = range_.part(name, material="knob_grey")
    disc = knob.add(cylinder(0.0285, 0.012), at=(ux + 0.0008, y, z), rpy=outward, by="back")
    knob.add(box((0.016, 0.012, 0.056)), at=disc.anchor("front"), by="back")
    range_.revolute(
        name + "_turn", body, knob, at=disc.anchor("centre"), axis=(-1, 0, 0), range=(0, 1.57)
    )

lever = range_.part("lever", material="knob_grey")
pivot = (ux + 0.013, -0.233, 1.272)
lever.add(cylinder(0.012, 0.024), at=pivot, rpy=(0, 0, 0), name="boss")
# It points half to the left (+y) and swings over to the other side.
lever.add(
    cylinder(0.0085, 0.06),
    at=(pivot[0] + 0.021, pivot[1] + 0.021, pivot[2]),
    rpy=(0, math.pi / 2, math.pi / 4),
)
range_.revolute("toggle", body, lever, at=pivot, axis=(0, 0, -1), range=(0, 1.4))
