# Label: dishwasher
# PartNet-Mobility: Dishwasher
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror

depth = 0.6  # 0.55 to 0.65 m
width = 0.6  # 0.45 to 0.65 m
height = 0.85  # 0.8 to 0.92 m
racks = 2  # 1 to 3
buttons = 3  # 2 to 5
controls = "strip"  # one of strip, door
finish = "stainless_steel"  # one of stainless_steel, white, black

FRONT, PULL, WALL, TOE = 0.03, 0.04, 0.035, 0.1
STRIP = 0.11 if controls == "strip" else 0.0
machine = Object("dishwasher", label="dishwasher")
colours = {
    "stainless_steel": (0.72, 0.73, 0.75),
    "white": (0.93, 0.93, 0.92),
    "black": (0.1, 0.1, 0.11),
}
machine.material("finish", like="insulated", rgb=colours[finish])
machine.material("wire", like="steel", rgb=(0.55, 0.58, 0.65))
body = machine.part("body", material="finish")
body_depth = depth - FRONT - PULL
shell = body.add(
    hollow_box((body_depth, width, height - TOE), WALL, open="+x"), at=(0, 0, TOE), by="bottom"
)
x = shell.anchor("front")[0]
body.add(
    box((body_depth - 0.06, width - 0.02, TOE)),
    at=(-0.03, 0, 0),
    by="bottom",
    rgb=(0.08, 0.08, 0.08),
)
low, high = TOE + WALL, height - max(WALL, STRIP)

door = machine.door(
    "door",
    body,
    x=x,
    y=(-width / 2, width / 2),
    z=(TOE, height - STRIP),
    hinge="bottom",
    thickness=FRONT,
)
face = door.anchor("front")[0]
top = height - STRIP - (0.05 if STRIP else 0.14)
bar = (face + PULL, 0, top)
door.add(
    cylinder(0.011, 0.75 * width), at=bar, rpy=(math.pi / 2, 0, 0), by="front", material="steel"
)
for post in mirror((face - 0.002, 0.3 * width, top)):
    door.add(
        cylinder(0.008, PULL - 0.006), at=post, rpy=(0, math.pi / 2, 0), by="back", material="steel"
    )

# Controls: on a strip of the body above the door, or on the door's upper edge.
panel, plane, level = door, face, height - 0.06
if STRIP:
    strip = body.add(
        box((FRONT, width, STRIP - 0.003)), at=(x, 0, height), by="back.top", rgb=(0.2, 0.2, 0.22)
    )
    panel, plane = body, strip.anchor("front")[0]
    body.add(
        box((0.002, 0.12, 0.035)),
        at=(plane, 0, level),
        by="back",
        rgb=(0.05, 0.25, 0.3),
        role="visual",
    )
for k in range(buttons):
    button = machine.part(f"button_{k + 1}", material="abs")
    at = (plane + 0.0015, width * 0.42 - 0.035 * k, level)
    button.add(
        cylinder(0.011, 0.006), at=at, rpy=(0, math.pi / 2, 0), by="back", rgb=(0.75, 0.75, 0.77)
    )
    machine.prismatic(f"press_{k + 1}", panel, button, axis="back", range=(0, 0.0018))
knob = machine.part("knob", material="abs")
dial = knob.add(
    cylinder(0.024, 0.02),
    at=(plane + 0.0008, -width * 0.38, level),
    rpy=(0, math.pi / 2, 0),
    by="back",
)
knob.add(
    box((0.002, 0.004, 0.02)),
    at=dial.anchor("front"),
    by="bottom",
    rgb=(0.9, 0.9, 0.9),
    role="visual",
)
machine.continuous("turn", panel, knob, at="centre", axis="front")

# Racks of wire run on rails at the walls.
span, deep = width - 2 * WALL - 0.03, body_depth - WALL - 0.06
step = (high - low - 0.08) / racks
for k in range(racks):
    z = low + 0.06 + k * step
    tall = min(0.12, step - 0.06)
    for side in mirror((x - deep / 2 - 0.03, width / 2 - WALL + 0.002, z)):
        body.add(box((deep, 0.05, 0.008)), at=side, by="top", material="wire")
    rack = machine.part(f"rack_{k + 1}", material="wire")
    for y in mirror((x - 0.02 - deep / 2, span / 2 - 0.003, z + 0.001)):
        rack.add(box((deep, 0.006, 0.006)), at=y, by="bottom")
        rack.add(box((deep, 0.006, 0.006)), at=(y[0], y[1], z + tall), by="top")
    for i in range(9):
        at = (x - 0.02 - deep + 0.003 + i * (deep - 0.006) / 8, 0, z + 0.001)
        rack.add(box((0.005, span, 0.005)), at=at, by="bottom")
        for side in mirror((at[0], span / 2 - 0.003, z + 0.001)):
            rack.add(box((0.005, 0.005, tall - 0.002)), at=side, by="bottom")
        if i in (0, 8):
            rack.add(box((0.005, span, 0.005)), at=(at[0], 0, z + tall), by="top")
    machine.prismatic(
        f"rack_slide_{k + 1}", body, rack, axis="front", range=(0, 0.75 * deep), after=door
    )
arm = machine.part("spray_arm", material="polypropylene")
body.add(cylinder(0.03, 0.02), at=(-0.02, 0, low - 0.002), by="bottom", material="polypropylene")
hub = arm.add(cylinder(0.025, 0.012), at=(-0.02, 0, low + 0.0185), by="bottom")
arm.add(box((0.05, 0.8 * span, 0.01)), at=hub.anchor("centre"))
machine.continuous("spray_turn", body, arm, at=hub.anchor("centre"), axis="up")
