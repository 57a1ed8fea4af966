import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    capsule,
    cylinder,
    extrusion,
    hollow_box,
    mirror,
    tube,
)

# Stove with a control box above it, given box 0.74 x 0.56 x 1.40 m.
X, Y, Z = 0.74, 0.56, 1.40
FRONT, PULL, WALL, GAP = 0.030, 0.046, 0.040, 0.0005
DEPTH = X - FRONT - PULL - GAP
TOP, COOKTOP = 0.95, 0.033  # height of the cooktop's surface, its thickness
LOW, HIGH = 0.2185, 0.772  # seams below and above the flap
HOOD_DEPTH, HOOD_Z = 0.37, 0.133
ALONG_X, ALONG_Y = (0, math.pi / 2, 0), (math.pi / 2, 0, 0)
R = 0.011

stove = Object("fs_oven", label="stove with oven and a control box above")
grey = stove.material(
    "grey_steel",
    like="insulated",
    rgb=(0.64, 0.64, 0.64),
    rgb2=(0.58, 0.58, 0.57),
    pattern="speckles",
)
black = stove.material("black_enamel", like="abs", rgb=(0.13, 0.13, 0.13), roughness=0.7)
metal = stove.material(
    "knob_metal", like="aluminium", rgb=(0.62, 0.62, 0.62), metallic=0.2, roughness=0.6
)
rail = stove.material("wall_rail", like="aluminium", rgb=(0.85, 0.85, 0.85), metallic=0)

body = stove.part("body", material=grey)
shell = body.add(hollow_box((DEPTH, Y, TOP - COOKTOP), WALL, open="+x"), by="bottom", name="shell")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
face = x + GAP + FRONT
inside = (-Y / 2 + WALL, Y / 2 - WALL)
stove.shelf(body, x=(back + WALL, x), y=inside, z=LOW + 0.02, thickness=0.04, name="oven_floor")
stove.shelf(body, x=(back + WALL, x), y=inside, z=HIGH + 0.03, thickness=0.04, name="oven_ceiling")
body.add(
    box((FRONT + GAP + 0.002, Y, TOP - COOKTOP - HIGH - 0.001)),
    at=(face, 0, HIGH + 0.001),
    by="front.bottom",
    name="front_panel",
)
body.add(
    box((face - back, Y, COOKTOP)), at=(back, 0, TOP), by="back.top", material=black, name="cooktop"
)
for i, (rx, ry) in enumerate(((-0.005, -0.127), (-0.005, 0.123), (0.247, -0.127), (0.247, 0.123))):
    body.add(
        cylinder(0.060, 0.001),
        at=(rx, ry, TOP),
        role="visual",
        material=black,
        rgb=(0.03, 0.03, 0.03),
        name=f"plate_{i}",
    )
    body.add(
        tube(0.066, 0.008, 0.002, sectors=24),
        at=(rx, ry, TOP),
        role="visual",
        rgb=(0.70, 0.70, 0.70),
        name=f"ring_{i}",
    )

# The control box hangs on the wall behind the stove; a thin rail joins the two.
hood_low = Z - HOOD_Z
hood = body.add(
    hollow_box((HOOD_DEPTH, Y, HOOD_Z), 0.006, open="-x"),
    at=(back, 0, Z),
    by="back.top",
    material=black,
    name="control_box",
)
body.add(
    box((0.003, 0.006, hood_low - TOP + 0.006)),
    at=(back, 0, TOP - 0.003),
    by="back.bottom",
    material=rail,
    name="rail",
)
hx = hood.anchor("front")[0]

# Four knobs with a pointer bar.
spots = ((-0.140, 1.367), (-0.071, 1.367), (-0.140, 1.301), (-0.071, 1.301))
for i, (ky, kz) in enumerate(spots, 1):
    knob = stove.part(f"knob_{i}", material=metal)
    disc = knob.add(
        cylinder(0.0295, 0.014), at=(hx + GAP, ky, kz), rpy=ALONG_X, by="back", name="disc"
    )
    knob.add(
        box((0.013, 0.016, 0.062)),
        at=(disc.anchor("front")[0] - 0.001, ky, kz),
        by="back",
        name="pointer",
    )
    stove.revolute(
        f"knob_{i}_turn", body, knob, at=disc.anchor("centre"), axis=(1, 0, 0), range=(0, 4.7)
    )

# The switch: a lever on a round boss that points to the front and to the left (+y); it tips to
# the other side.
SY, SZ, TILT, LENGTH = -0.222, 1.338, 0.6, 0.045
boss = body.add(
    cylinder(0.023, 0.008),
    at=(hx - 0.001, SY, SZ),
    rpy=ALONG_X,
    by="back",
    material=metal,
    name="switch_boss",
)
pivot = (boss.anchor("front")[0] + GAP + 0.011, SY, SZ)
switch = stove.part("switch", material=metal)
switch.add(
    capsule(0.011, LENGTH),
    rpy=(0, math.pi / 2, TILT),
    name="lever",
    at=(pivot[0] + LENGTH / 2 * math.cos(TILT), SY + LENGTH / 2 * math.sin(TILT), SZ),
)
stove.revolute(
    "switch_tip", body, switch, at=pivot, axis=(0, 0, -1), range=(0, 2 * TILT), opens="right"
)


def add_handle(part, z):
    part.add(
        cylinder(R, 0.30),
        at=(face + PULL, 0, z),
        rpy=ALONG_Y,
        by="front",
        material=black,
        name="bar",
    )
    for i, post in enumerate(mirror((face - 0.003, 0.11, z))):
        part.add(
            cylinder(0.008, PULL - R + 0.003),
            at=post,
            rpy=ALONG_X,
            by="back",
            material=black,
            name=f"post_{i}",
        )


flap = stove.part("oven_door", material=grey)
flap.add(
    box((FRONT, Y, HIGH - LOW - 0.003)),
    at=(x + GAP, 0, LOW + 0.002),
    by="back.bottom",
    name="leaf",
)
stove.revolute(
    "oven_door_hinge",
    body,
    flap,
    at=flap.anchor("bottom.front"),
    axis=(0, 1, 0),
    range=(0, 1.5),
    opens="front",
)
flap.add(
    box((0.002, 0.39, 0.26)),
    at=(face, 0.005, 0.545),
    role="visual",
    material=black,
    rgb=(0.04, 0.04, 0.04),
    name="window",
)


def hexagon(radius):
    return [
        (radius * math.cos(a), radius * math.sin(a))
        for a in (math.pi / 6 + i * math.pi / 3 for i in range(6))
    ]


flap.add(
    extrusion(hexagon(0.083), 0.004, holes=[hexagon(0.054)]),
    at=(face + 0.002, 0.007, 0.54),
    rpy=(math.pi / 2, 0, math.pi / 2),
    role="visual",
    rgb=(0.62, 0.62, 0.62),
    name="emblem",
)
add_handle(flap, 0.727)

drawer = stove.drawer(
    "drawer",
    body,
    x=x,
    y=inside,
    z=(WALL, LOW - 0.0395),
    depth=0.45,
    front=FRONT,
    overlay=0.039,
    travel=0.30,
    material=grey,
)
add_handle(drawer, 0.172)
