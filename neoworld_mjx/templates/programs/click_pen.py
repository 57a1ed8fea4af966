# Label: ballpoint pen with a button
# PartNet-Mobility: Pen
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    difference,
    extrusion,
    frustum,
    ring,
    tube,
)

depth = 0.142  # 0.125 to 0.155 m
width = 0.017  # 0.0165 to 0.02 m
height = 0.011  # 0.01 to 0.012 m
barrel = "hexagon"  # one of hexagon, octagon
grip = "rubber"  # one of rubber, plain, rings
colour = "blue"  # one of blue, red, black, green, white

pen = Object("click_pen", label="ballpoint pen with a button")
tones = {
    "blue": (0.12, 0.25, 0.65),
    "red": (0.75, 0.1, 0.1),
    "black": (0.13, 0.13, 0.14),
    "green": (0.15, 0.5, 0.25),
    "white": (0.94, 0.94, 0.94),
}
pen.material("barrel", like="abs", rgb=tones[colour])
pen.material("metal", like="aluminium", rgb=(0.8, 0.81, 0.83))
# It lies on a flat side of its barrel, its tip to the front, its clip at -y.
along = (0, math.pi / 2, 0)
BUTTON, CONE, TRAVEL, BORE = 0.012, 0.018, 0.004, 0.0028
sides = 6 if barrel == "hexagon" else 8
flat = height / 2
corner = flat / math.cos(math.pi / sides)
outline = [(p[0], p[1]) for p in ring(sides, corner, start=math.pi / sides)]
hole = [(p[0], p[1]) for p in ring(10, BORE)]
reach = max(p[1] for p in outline)
y, z = width / 2 - reach, flat
front, rear = depth / 2, -depth / 2 + BUTTON
long = front - CONE - rear
body = pen.part("barrel", material="barrel")
middle = (rear + front - CONE) / 2
body.add(extrusion(outline, long, [hole]), at=(middle, y, z), rpy=along, name="barrel")
nose = difference(frustum(0.96 * flat, 0.0022, CONE), cylinder(0.0015, 2 * CONE))
body.add(nose, at=(front, y, z), rpy=along, by="front", material="metal", name="nose")
if grip != "plain":
    for k in range(1 if grip == "rubber" else 4):
        size = 0.035 if grip == "rubber" else 0.003
        band = tube(corner + 0.0001, 0.001, size, sectors=16)
        x = front - CONE - 0.004 - 0.008 * k
        tone = (0.15, 0.15, 0.16)
        body.add(band, at=(x, y, z), rpy=along, by="front", rgb=tone, role="visual")
collar = difference(cylinder(0.95 * flat, 0.006), cylinder(BORE, 0.02))
body.add(collar, at=(rear + 0.0005, y, z), rpy=along, by="front", material="metal")
button = pen.part("button", material="metal")
button.add(cylinder(0.0021, BUTTON + 0.012), at=(-depth / 2, y, z), rpy=along, by="back")
click = pen.prismatic("click", body, button, axis="front", range=(0, TRAVEL), friction=0.3)
refill = pen.part("refill", material="brass")
refill.add(cylinder(0.0011, 0.05), at=(front - 0.0008, y, z), rpy=along, by="front")
pen.prismatic("tip_out", body, refill, axis="front", range=(0, TRAVEL), mimic=click, friction=0.1)
# The clip springs away from the barrel.
clip = pen.part("clip", material="metal")
edge = y - reach
clip.add(box((0.038, 0.001, 0.003)), at=(rear + 0.002, -width / 2, z), by="back.right")
clip.add(
    box((0.005, edge - 0.0006 + width / 2, 0.003)),
    at=(rear + 0.002, -width / 2, z),
    by="back.right",
)
clip.add(
    box((0.003, edge - 0.0012 + width / 2, 0.003)),
    at=(rear + 0.04, -width / 2, z),
    by="front.right",
)
hinge = (rear + 0.0045, edge - 0.0006, z)
pen.revolute(
    "clip_lift",
    body,
    clip,
    at=hinge,
    axis=(0, 0, -1),
    range=(0, 0.06),
    stiffness=0.0008,
    damping=0.0002,
)
