# Label: hand shower on a rail
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, frustum, sphere

depth = 0.24  # 0.2 to 0.3 m
width = 0.2  # 0.16 to 0.26 m
height = 0.9  # 0.7 to 1.1 m
handles = 2  # 1 to 2
head = "round"  # one of round, square
mixer = "bar"  # one of bar, box
metal = "chrome"  # one of chrome, black, brass

LOOK = {"chrome": (0.78, 0.8, 0.82), "black": (0.13, 0.13, 0.14), "brass": (0.76, 0.6, 0.28)}
obj = Object("shower_head", label="hand shower on a rail")
coat = obj.material("coat", like="brass", density=1500, rgb=LOOK[metal])
tile = obj.material("tile", like="ceramic", density=350, rgb=(0.8, 0.86, 0.88))
white = obj.material("nozzles", like="abs", rgb=(0.88, 0.88, 0.88))
back, along, across = -depth / 2, (0, math.pi / 2, 0), (math.pi / 2, 0, 0)
wall = obj.part("wall", material=tile)
WALL, FLOOR = 0.02, 0.03
wall.add(box((WALL, width, height)), at=(back, 0, 0), by="back.bottom")
wall.add(box((depth, width, FLOOR)), by="bottom", material="stone")
rail_x = back + WALL + 0.045
for z in (0.42 * height, 0.95 * height):
    wall.add(
        cylinder(0.012, 0.046), at=(back + WALL - 0.001, 0, z), rpy=along, by="back", material=coat
    )
wall.add(cylinder(0.009, 0.57 * height), at=(rail_x, 0, 0.685 * height), material=coat)
mix_z = 0.27 * height
shape = cylinder(0.022, 0.75 * width) if mixer == "bar" else box((0.75 * width, 0.044, 0.044))
wall.add(
    shape,
    at=(rail_x, 0, mix_z),
    rpy=across if mixer == "bar" else (0, 0, math.pi / 2),
    material=coat,
)
for y in (-0.05, 0.05):
    wall.add(
        cylinder(0.018, 0.04),
        at=(back + WALL - 0.001, y, mix_z),
        rpy=along,
        by="back",
        material=coat,
    )
wall.add(cylinder(0.008, 0.04), at=(rail_x, 0, mix_z - 0.015), by="top", material=coat)
for k in range(handles):
    tap = obj.part(f"tap_{k + 1}", material=coat)
    side = 1 if k else -1
    at = (rail_x, side * (0.375 * width + 0.0005), mix_z)
    tap.add(cylinder(0.021, 0.12 * width), at=at, rpy=across, by="right" if side > 0 else "left")
    tip = (rail_x, side * 0.45 * width, mix_z + 0.018)
    tap.add(box((0.008, 0.012, 0.022)), at=tip, by="bottom")
    obj.revolute(
        f"tap_{k + 1}_turn", wall, tap, at=at, axis=(0, 1, 0), range=(0, 1.5), friction=0.05
    )

# A carriage runs on the rail; the hand shower swivels in it on a ball.
slider = obj.part("slider", material=coat)
z = 0.8 * height
for x in (-0.0175, 0.0175):
    slider.add(box((0.016, 0.04, 0.05)), at=(rail_x + x, 0, z))
for y in (-0.0155, 0.0155):
    slider.add(box((0.05, 0.012, 0.05)), at=(rail_x, y, z))
obj.prismatic(
    "height_slide", wall, slider, axis="bottom", range=(-0.1 * height, 0.3 * height), friction=4
)
hinge = (rail_x + 0.025, 0, z)
slider.add(cylinder(0.016, 0.02), at=hinge, rpy=along, by="back")
slider.add(cylinder(0.008, 0.02), at=(hinge[0] + 0.018, 0, z), rpy=along, by="back")
hand = obj.part("hand_shower", material=coat)
ball = (hinge[0] + 0.049, 0, z)
hand.add(sphere(0.0115), at=ball)
# The head looks down and forward; its rim is the front of the box at the top.
R, top = min(0.27 * width, (depth - 0.125) / 2), z + 0.1
hand.add(cylinder(0.0115, top - z + 0.07), at=(ball[0] + 0.004, 0, top), by="top")
hand.add(cylinder(0.012, R + 0.02), at=(ball[0], 0, top - 0.012), rpy=along, by="back")
centre = (depth / 2 - R, 0, top - 0.03)
if head == "round":
    hand.add(cylinder(R, 0.02), at=centre)
else:
    hand.add(box((2 * R, 2 * R, 0.02)), at=centre)
hand.add(frustum(0.9 * R, 0.3 * R, 0.02), at=(centre[0], 0, centre[2] + 0.009), by="bottom")
hand.add(cylinder(0.85 * R, 0.003), at=(centre[0], 0, centre[2] - 0.0095), by="top", material=white)
obj.ball("head_swivel", slider, hand, at=ball, swing=0.3, friction=1.0)
