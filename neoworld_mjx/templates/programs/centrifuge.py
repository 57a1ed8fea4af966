# Label: laboratory centrifuge
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    difference,
    hollow_box,
    rounded_box,
    tube,
)

depth = 0.36  # 0.28 to 0.46 m
width = 0.3  # 0.24 to 0.4 m
height = 0.24  # 0.18 to 0.3 m
places = 8  # 4 to 12
knobs = 2  # 1 to 3
lid_shape = "flat"  # one of flat, domed
colour = "white"  # one of white, grey, blue

SHADE = {"white": (0.92, 0.92, 0.9), "grey": (0.62, 0.64, 0.66), "blue": (0.35, 0.5, 0.66)}
obj = Object("centrifuge", label="laboratory centrifuge")
case = obj.material("case", like="insulated", density=350, rgb=SHADE[colour])
dark = obj.material("dark", like="abs", rgb=(0.15, 0.15, 0.17))
LID, KNOB, FOOT = 0.035, 0.012, 0.01
x, back = depth / 2 - KNOB, -depth / 2
top = height - LID - 0.001
R = 0.38 * min(width, 0.86 * depth)
bowl_x, pit = back + 0.03 + R + 0.02, 0.6 * top
body = obj.part("body", material=case)
block = box((x - back, width, top - FOOT)).moved(((x + back) / 2, 0, (top + FOOT) / 2))
body.add(difference(block, cylinder(R, pit).moved((bowl_x, 0, top - pit / 2 + 0.001))))
for fx in (back + 0.03, x - 0.03):
    for y in (-width / 2 + 0.03, width / 2 - 0.03):
        body.add(cylinder(0.015, FOOT), at=(fx, y, 0), by="bottom", material="rubber")
panel_z = FOOT + 0.5 * (top - FOOT)
body.add(
    box((0.002, 0.8 * width, 0.5 * (top - FOOT))), at=(x, 0, panel_z), role="visual", material=dark
)
body.add(
    box((0.004, 0.28 * width, 0.03)),
    at=(x, 0.2 * width, panel_z),
    role="visual",
    rgb=(0.3, 0.75, 0.6),
)
body.add(cylinder(0.008, 0.03), at=(bowl_x, 0, top - pit - 0.002), by="bottom", material="steel")
for k in range(knobs):
    knob = obj.part(f"knob_{k + 1}", material="plastic")
    at = (x + 0.0005, -0.08 * width - k * 0.13 * width, panel_z)
    turned = (0, math.pi / 2, 0)
    knob.add(cylinder(0.045 * width, KNOB - 0.001), at=at, rpy=turned, by="back")
    mark = (x + KNOB - 0.0005, at[1], panel_z + 0.022 * width)
    knob.add(
        box((0.001, 0.003, 0.04 * width)), at=mark, by="front", role="visual", rgb=(0.8, 0.1, 0.1)
    )
    obj.revolute(f"knob_{k + 1}_turn", body, knob, at=at, axis="front", range=(0, 4.7))

# A cone with slanted tubes around it; the lid must be open to take one out.
rotor = obj.part("rotor", material="aluminium", mass=0.8)
low = top - pit + 0.0285
tall = pit - 0.045
rotor.add(cylinder(0.3 * R, tall), at=(bowl_x, 0, low), by="bottom")
rotor.add(cylinder(0.8 * R, 0.3 * tall), at=(bowl_x, 0, low + 0.35 * tall), by="bottom")
rotor.add(cylinder(0.014, 0.01), at=(bowl_x, 0, low + tall), by="bottom", material=dark)
for k in range(places):
    t = 2 * math.pi * k / places
    at = (bowl_x + 0.6 * R * math.cos(t), 0.6 * R * math.sin(t), low + 0.55 * tall)
    r = min(0.1 * R, 1.3 * R / places)
    rotor.add(
        tube(r, 0.001, 0.75 * tall, sectors=8), at=at, rpy=(0, -0.35, t), material="polypropylene"
    )
obj.continuous("spin", body, rotor, at=(bowl_x, 0, low), axis="top")
lid = obj.part("lid", material=case)
deep = min(2 * R + 0.05, x - back)
plate = hollow_box((deep, width, LID), 0.006, open="-z")
if lid_shape == "domed":
    lid.add(
        rounded_box((deep, width, 0.6 * LID), 0.008), at=(back, 0, top + 0.001), by="back.bottom"
    )
    lid.add(cylinder(0.8 * R, LID - 0.002), at=(bowl_x, 0, height), by="top")
    lid.add(
        cylinder(0.35 * R, 0.0015), at=(bowl_x, 0, height), role="visual", by="top", material=dark
    )
else:
    lid.add(plate, at=(back, 0, height), by="back.top")
    lid.add(
        cylinder(0.5 * R, 0.001), at=(bowl_x, 0, height), by="top", role="visual", material=dark
    )
if deep < x - back - 0.02:
    body.add(box((x - back - deep - 0.002, width, LID)), at=(x, 0, top - 0.0005), by="front.bottom")
hinge = (back, 0, top + 0.001)
obj.revolute(
    "lid_hinge", body, lid, at=hinge, axis=(0, -1, 0), range=(0, 1.5), friction=2.5, opens="up"
)
