# Label: mantel clock
# PartNet-Mobility: Clock
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    extrusion,
    hollow_box,
    panel,
    ring,
    tube,
)

depth = 0.13  # 0.11 to 0.17 m
width = 0.22  # 0.18 to 0.3 m
height = 0.36  # 0.3 to 0.46 m
roof = "gable"  # one of gable, flat, arch
pendulum = "yes"  # one of yes, no
numerals = "bars"  # one of bars, dots
wood = "walnut"  # one of walnut, oak, black, white

flat, upright = (0, math.pi / 2, 0), (math.pi / 2, 0, math.pi / 2)
clock = Object("mantel_clock", label="mantel clock")
painted = {"black": (0.1, 0.1, 0.11), "white": (0.92, 0.91, 0.88)}
if wood in painted:
    clock.material("case", like="mdf", rgb=painted[wood])
else:
    clock.material("case", like=wood)
body = clock.part("body", material="case")
WALL, DOOR, KNOB, KEY = 0.012, 0.012, 0.012, 0.016
deep = depth - DOOR - KNOB - KEY
middle = (KEY - DOOR - KNOB) / 2
x, back = middle + deep / 2, middle - deep / 2
RISE = 0.0 if roof == "flat" else 0.22 * height
tall = height - RISE - 0.016
body.add(box((deep + DOOR, width, 0.016)), at=(back, 0, 0), by="back.bottom", name="foot")
span = width - 0.03
body.add(
    hollow_box((deep, span, tall), WALL, open="+x"), at=(middle, 0, 0.016), by="bottom", name="case"
)
eaves = 0.016 + tall
if roof == "gable":
    outline = [(-width / 2, 0), (width / 2, 0), (width / 2, 0.01), (0, RISE), (-width / 2, 0.01)]
elif roof == "arch":
    outline = [
        (0.5 * width * math.cos(math.pi * k / 16), RISE * math.sin(math.pi * k / 16))
        for k in range(17)
    ]
if roof == "flat":
    body.add(box((deep + DOOR, width, 0.014)), at=(back, 0, eaves), by="back.top")
    eaves -= 0.014
else:
    body.add(
        extrusion(outline, deep + DOOR),
        at=(back, 0, eaves),
        rpy=upright,
        by="back.bottom",
        name="roof",
    )

# The dial, and three hands on an arbor.
radius = min(0.5 * span - WALL - 0.006, 0.24 * height)
centre = eaves - WALL - radius - 0.008
face = back + 0.55 * deep
body.add(
    box((face - back - WALL + 0.001, span - 2 * WALL + 0.001, 2 * radius + 0.012)),
    at=(face, 0, centre),
    by="front",
)
body.add(cylinder(radius, 0.002), at=(face, 0, centre), rpy=flat, by="back", rgb=(0.96, 0.94, 0.88))
plane = face + 0.002
for dy, dz, _ in ring(12, 0.84 * radius):
    a = math.atan2(dz, dy)
    mark = (
        cylinder(0.04 * radius, 0.0006)
        if numerals == "dots"
        else box((0.0006, 0.16 * radius, 0.05 * radius))
    )
    turn = flat if numerals == "dots" else (a, 0, 0)
    body.add(mark, at=(plane, dy, centre + dz), rpy=turn, rgb=(0.1, 0.1, 0.1), role="visual")
body.add(
    cylinder(0.0018, 0.009), at=(plane - 0.001, 0, centre), rpy=flat, by="back", material="brass"
)
hands = {}
for k, (name, long, wide, a) in enumerate(
    (("hour", 0.5, 0.07, -0.9), ("minute", 0.76, 0.05, 0.9), ("second", 0.8, 0.02, 2.6))
):
    hand = clock.part(f"{name}_hand", material="aluminium")
    start = plane + 0.001 + 0.0022 * k
    rgb = (0.7, 0.1, 0.1) if name == "second" else (0.08, 0.08, 0.09)
    hand.add(tube(0.005, 0.0022, 0.0014), at=(start, 0, centre), rpy=flat, by="back", rgb=rgb)
    out = 0.5 * (0.0035 + long * radius)
    at = (start, out * math.sin(a), centre + out * math.cos(a))
    blade = box((0.0014, wide * radius, long * radius - 0.0035))
    hand.add(blade, at=(at[0] + 0.0007, at[1], at[2]), rpy=(-a, 0, 0), rgb=rgb)
    spot = (start, 0, centre)
    if name == "hour":
        hours = hand
    elif name == "minute":
        hands[name] = clock.continuous("minute_turn", body, hand, at=spot, axis=(-1, 0, 0))
    else:
        clock.continuous("second_turn", body, hand, at=spot, axis=(-1, 0, 0))
spot = (plane + 0.001, 0, centre)
clock.continuous(
    "hour_turn", body, hours, at=spot, axis=(-1, 0, 0), mimic=hands["minute"], multiplier=1 / 12
)
if pendulum == "yes":
    bob = clock.part("pendulum", material="brass")
    hang = centre - radius - 0.004
    body.add(box((0.012, 0.012, 0.012)), at=(face, 0, hang), by="back", material="brass")
    length = 0.55 * (hang - 0.016 - WALL)
    pivot = (face + 0.006, 0, hang - 0.0068)
    bob.add(box((0.0015, 0.004, length)), at=pivot, by="top")
    size = min(0.32 * length, 0.02)
    bob.add(cylinder(size, 0.004), at=(pivot[0], 0, pivot[2] - length), rpy=flat)
    clock.revolute("swing", body, bob, at=pivot, axis="front", range=(-0.2, 0.2))
door = clock.part("door", material="case")
size = (span, eaves - 0.019)
hole = (0, 0, size[0] - 0.036, size[1] - 0.036)
leaf = door.add(
    panel(size, DOOR - 0.001, [hole]), at=(x + 0.0006, 0, 0.0175), rpy=upright, by="back.bottom"
)
knob = (leaf.anchor("front")[0] - 0.0005, -span / 2 + 0.009, 0.5 * eaves)
door.add(cylinder(0.006, depth / 2 - knob[0]), at=knob, rpy=flat, by="back", material="brass")
clock.revolute(
    "door_hinge",
    body,
    door,
    at=leaf.anchor("left.back"),
    axis=(0, 0, 1),
    range=(0, 1.57),
    opens="front",
    friction=0.02,
)
key = clock.part("key", material="brass")
spot = (back - 0.0008, 0.12 * width, centre)
key.add(cylinder(0.004, KEY - 0.0008), at=spot, rpy=flat, by="front")
key.add(box((0.003, 0.03, 0.014)), at=(-depth / 2, spot[1], spot[2]), by="back")
clock.continuous("wind", body, key, at=spot, axis="back")
