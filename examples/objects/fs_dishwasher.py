import math

from neoworld_mjx.program.sdk import Object, box, extrusion, hollow_box, sweep

# Dishwasher, given box 0.73 x 0.61 x 0.74 m: control panel with a rounded lip above a door that
# folds down.
X, Y, Z = 0.73, 0.61, 0.74
FRONT, PULL, WALL, GAP = 0.035, 0.065, 0.04, 0.001
DEPTH = X - FRONT - PULL - GAP
PANEL = 0.647  # lower edge of the control panel
LIP = 0.055  # how far its upper edge stands in front of the carcass

washer = Object("fs_dishwasher", label="dishwasher")
grey = washer.material(
    "grey_steel",
    like="insulated",
    rgb=(0.62, 0.62, 0.62),
    rgb2=(0.55, 0.55, 0.55),
    pattern="speckles",
)
bright = washer.material(
    "handle_steel", like="aluminium", rgb=(0.68, 0.68, 0.68), metallic=0.2, roughness=0.6
)

body = washer.part("body", material=grey)
shell = body.add(hollow_box((DEPTH, Y, Z), WALL, open="+x"), by="bottom", name="shell")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
inside = (-Y / 2 + WALL, Y / 2 - WALL)
washer.shelf(body, x=(back + WALL, x), y=inside, z=PANEL + 0.02, thickness=0.02, name="ceiling")

# Control panel: its outline in (x, z), extruded along y; it recedes towards its lower edge.
outline = [
    (x - 0.002, PANEL),
    (x + 0.036, PANEL),
    (x + 0.044, PANEL + 0.020),
    (x + 0.051, PANEL + 0.045),
    (x + LIP, PANEL + 0.070),
    (x + LIP, Z),
    (x - 0.002, Z),
]
body.add(extrusion(outline, Y), rpy=(math.pi / 2, 0, 0), name="control_panel")
body.add(
    box((0.004, 0.07, 0.008)),
    at=(x + 0.041, 0.01, PANEL + 0.012),
    role="visual",
    rgb=(0.35, 0.35, 0.35),
    name="slot",
)

door = washer.door(
    "door",
    body,
    x=x,
    y=(-Y / 2, Y / 2),
    z=(WALL, PANEL - 0.001),
    hinge="bottom",
    thickness=FRONT,
    gap=GAP,
    opens=1.4,
    material=grey,
)
px = door.anchor("front")[0]
R, HALF, BAR_Z = 0.02, Y / 2 - 0.03, 0.61
bar_x = px + PULL - R
door.add(
    sweep(
        [
            (px - 0.003, -HALF, BAR_Z),
            (bar_x, -HALF, BAR_Z),
            (bar_x, HALF, BAR_Z),
            (px - 0.003, HALF, BAR_Z),
        ],
        radius=R,
    ),
    material=bright,
    name="handle",
)


# The emblem near the lower edge: a hexagonal ring.
def hexagon(radius):
    return [
        (radius * math.cos(a), radius * math.sin(a))
        for a in (math.pi / 6 + i * math.pi / 3 for i in range(6))
    ]


door.add(
    extrusion(hexagon(0.05), 0.003, holes=[hexagon(0.035)]),
    at=(px + 0.001, 0.01, 0.13),
    rpy=(math.pi / 2, 0, math.pi / 2),
    role="visual",
    rgb=(0.55, 0.55, 0.55),
    name="emblem",
)
