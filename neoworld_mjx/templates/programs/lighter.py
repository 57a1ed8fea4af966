# Label: lighter with a lid
# PartNet-Mobility: Lighter
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box

depth = 0.014  # 0.012 to 0.017 m
width = 0.038  # 0.034 to 0.044 m
height = 0.058  # 0.052 to 0.068 m
lid_share = 0.38  # 0.34 to 0.42
engraved = "lines"  # one of lines, diamond, none
vents = 3  # 2 to 4
finish = "steel"  # one of steel, brass, black, blue

lighter = Object("lighter", label="lighter with a lid")
tones = {
    "steel": (0.72, 0.73, 0.75),
    "brass": (0.8, 0.64, 0.3),
    "black": (0.12, 0.12, 0.13),
    "blue": (0.15, 0.25, 0.5),
}
lighter.material("case", like="aluminium", rgb=tones[finish])
dark = (0.15, 0.15, 0.16)
WALL = 0.001
case = lighter.part("case", material="case")
line = (1 - lid_share) * height
case.add(hollow_box((depth, width, line), WALL, open="+z"), by="bottom")
for k in range({"lines": 3, "diamond": 1, "none": 0}[engraved]):
    mark, turn, z = box((0.0004, 0.6 * width, 0.0014)), 0.0, (0.3 + 0.2 * k) * line
    if engraved == "diamond":
        mark, turn, z = box((0.0004, 0.3 * width, 0.3 * width)), math.pi / 4, 0.5 * line
    case.add(mark, at=(depth / 2, 0, z), rpy=(turn, 0, 0), rgb=(0.35, 0.35, 0.37), role="visual")
lid = lighter.part("lid", material="case")
cover = hollow_box((depth, width, height - line - 0.0004), WALL, open="-z")
lid.add(cover, at=(0, 0, height), by="top")
swing = lighter.revolute(
    "lid_hinge",
    case,
    lid,
    at=(0, width / 2, line + 0.0002),
    axis=(-1, 0, 0),
    range=(0, 2.0),
    friction=0.004,
    opens="up",
)
# The insert with wick, chimney and wheel can be drawn out of the case.
unit = lighter.part("insert", material="aluminium")
inner = (depth - 2 * WALL - 0.001, width - 2 * WALL - 0.001)
top = line + 0.003
shell = hollow_box((*inner, top - WALL - 0.0005), WALL, open="-z")
unit.add(shell, at=(0, 0, top), by="top")
room = height - WALL - top - 0.001
tall = 0.8 * room
wide = 0.4 * width
middle = 0.06 * width  # of the chimney; the wheel stands beside it, away from the lid's hinge
for side in (-1, 1):
    wall = box((WALL, wide, tall))
    unit.add(wall, at=(side * (inner[0] / 2 - 0.0008), middle, top), by="bottom")
    for k in range(vents):
        hole = cylinder(0.0012, 0.0003)
        at = (
            side * (inner[0] / 2 - 0.0002),
            middle + (k - (vents - 1) / 2) * 0.0036,
            top + 0.6 * tall,
        )
        unit.add(hole, at=at, rpy=(0, math.pi / 2, 0), rgb=dark, role="visual")
unit.add(box((inner[0] - 0.0016, WALL, tall)), at=(0, middle + wide / 2, top), by="left.bottom")
unit.add(cylinder(0.0014, 0.6 * tall), at=(0, middle, top), by="bottom", material="fabric")
lighter.prismatic(
    "insert_pull", case, unit, axis="up", range=(0, 0.8 * line), after=swing, friction=0.3
)
wheel = lighter.part("wheel", material="steel")
size = 0.0042
hub = (0, middle - wide / 2 - size + 0.0006, top + 0.5 * tall)
for side in (-1, 1):
    cheek = box((0.0008, 0.005, 0.5 * tall + 0.002))
    unit.add(cheek, at=(side * 0.0034, hub[1], top), by="bottom")
wheel.add(cylinder(size, 0.005), at=hub, rpy=(0, math.pi / 2, 0), rgb=(0.3, 0.3, 0.32))
for k in range(8):
    a = math.pi * k / 4
    tooth = (0, hub[1] + size * math.sin(a), hub[2] + size * math.cos(a))
    wheel.add(
        box((0.005, 0.0008, 0.0006)), at=tooth, rpy=(-a, 0, 0), rgb=(0.2, 0.2, 0.2), role="visual"
    )
lighter.continuous("strike", unit, wheel, at=hub, axis="front")
cam = lighter.part("cam", material="steel")
spot = (0, width / 2 - WALL - 0.0025, top + 0.0006)
cam.add(box((0.003, 0.003, 0.006)), at=spot, by="left.bottom")
lighter.revolute("cam_tip", unit, cam, at=spot, axis=(1, 0, 0), range=(-0.3, 0.0), friction=0.0003)
