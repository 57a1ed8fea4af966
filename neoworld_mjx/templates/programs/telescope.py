# Label: telescope on a fork mount
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, tube

depth = 0.6  # 0.48 to 0.8 m
width = 0.24  # 0.2 to 0.3 m
height = 0.44  # 0.4 to 0.56 m
arms = "boards"  # one of boards, bars
base_shape = "round"  # one of round, square
colour = "white"  # one of white, red, blue, black

PAINT = {"white": (0.92, 0.92, 0.9), "red": (0.7, 0.13, 0.1), "blue": (0.15, 0.28, 0.55)}
obj = Object("telescope", label="telescope on a fork mount")
paint = obj.material(
    "paint", like="aluminium", density=1500, rgb=PAINT.get(colour, (0.14, 0.14, 0.15))
)
dark = obj.material("dark", like="abs", rgb=(0.1, 0.1, 0.11))
wood = obj.material("mount", like="plywood", rgb=(0.16, 0.16, 0.18))
across, along = (math.pi / 2, 0, 0), (0, math.pi / 2, 0)
R = 0.26 * width
finder = 0.045
axis_z = height - R - finder
back, front = -depth / 2, depth / 2
pivot_x = back + 0.4 * depth
base = obj.part("base", material=wood, mass=2.5)
if base_shape == "round":
    base.add(cylinder(width / 2, 0.02), at=(pivot_x, 0, 0.012), by="bottom")
else:
    base.add(box((width, width, 0.02)), at=(pivot_x, 0, 0.012), by="bottom")
for k in range(3):
    t = 2 * math.pi * k / 3
    at = (pivot_x + 0.42 * width * math.cos(t), 0.42 * width * math.sin(t), 0)
    base.add(cylinder(0.015, 0.014), at=at, by="bottom", material="rubber")
fork = obj.part("fork", material=wood)
z = 0.0325
fork.add(box((0.8 * width, 0.8 * width, 0.016)), at=(pivot_x, 0, z), by="bottom")
for y in (-0.36 * width, 0.36 * width):
    board = (0.4 if arms == "boards" else 0.18) * width
    fork.add(box((board, 0.014, axis_z - z)), at=(pivot_x, y, z), by="bottom")
    fork.add(cylinder(0.2 * width, 0.014), at=(pivot_x, y, axis_z), rpy=across)
obj.continuous("azimuth", base, fork, at=(pivot_x, 0, z), axis="top")

# Its rear end comes down to the fork's floor as far as the front rises.
barrel = obj.part("tube", material=paint)
clear, rear = axis_z - z - 0.022, pivot_x - back
reach = math.hypot(rear, R)
up = 1.2 if clear >= reach else min(1.2, math.asin(clear / reach) - math.atan2(R, rear))
body = tube(R, 0.003, depth - 0.045, sectors=16)
barrel.add(body, at=(back, 0, axis_z), rpy=along, by="back")
cell = tube(R + 0.004, 0.006, 0.05, sectors=16)
barrel.add(cell, at=(front, 0, axis_z), rpy=along, by="front", material=dark)
barrel.add(cylinder(R - 0.002, 0.006), at=(back, 0, axis_z), rpy=along, by="back", material=dark)
for side in (-1, 1):
    stub = 0.36 * width - 0.0075 - R + 0.004
    at = (pivot_x, side * (R - 0.004), axis_z)
    boss = cylinder(0.4 * R, stub)
    barrel.add(boss, at=at, rpy=across, by="right" if side > 0 else "left", material=dark)
for x in (pivot_x - 0.03, pivot_x + 0.05):
    post = box((0.008, 0.008, finder - 0.014))
    barrel.add(post, at=(x, 0, axis_z + R - 0.003), by="bottom", material=dark)
scope = cylinder(0.012, 0.16)
barrel.add(scope, at=(pivot_x + 0.01, 0, height), rpy=along, by="top", material=dark)
obj.revolute(
    "altitude", fork, barrel, at=(pivot_x, 0, axis_z), axis=(0, -1, 0), range=(-0.1, up), friction=4
)
# The eyepiece of such a telescope sits on its side, near the open end.
eye, wheel = obj.part("eyepiece", material=dark), obj.part("focus_knob", material="steel")
spot, out, turned = (front - 0.14, R + 0.0005, axis_z), "left", across
long = min(0.035, width / 2 - R - 0.001)
eye.add(cylinder(0.018, 0.4 * long), at=spot, rpy=turned, by="right")
eye.add(cylinder(0.013, 0.6 * long), at=(spot[0], R + 0.4 * long, axis_z), rpy=turned, by="right")
obj.prismatic("focus", barrel, eye, axis=out, range=(0, 0.012))
wheel_at = (spot[0] - 0.04, R + 0.0005, axis_z)
wheel.add(cylinder(0.012, 0.014), at=wheel_at, rpy=turned, by="right")
obj.continuous("focus_knob_turn", barrel, wheel, at=wheel_at, axis=out)
