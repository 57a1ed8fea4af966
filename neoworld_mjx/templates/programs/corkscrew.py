# Label: wing corkscrew
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe, sphere, sweep, torus, tube

depth = 0.034  # 0.03 to 0.044 m
width = 0.075  # 0.066 to 0.09 m
height = 0.17  # 0.15 to 0.2 m
top = "opener"  # one of opener, knob, bar
metal = "steel"  # one of steel, brass, black

LOOK = {"steel": (0.74, 0.75, 0.77), "brass": (0.78, 0.6, 0.28), "black": (0.1, 0.1, 0.11)}
obj = Object("corkscrew", label="wing corkscrew")
cast = obj.material("cast", like="aluminium", rgb=LOOK[metal])
R, pivot_z = depth / 2, 0.58 * height
bell = 0.3 * height
body = obj.part("body", material=cast)
body.add(tube(R, 0.003, 0.4 * bell), by="bottom")
for y in (-R + 0.003, R - 0.003):
    path = [(0, y, 0.3 * bell), (0, y * 0.9, bell), (0, 0.55 * y, pivot_z)]
    body.add(sweep(path, width=0.009, thickness=0.004))
body.add(tube(0.0115, 0.006, 0.026), at=(0, 0, pivot_z))
body.add(tube(0.0125, 0.0065, 0.004), at=(0, 0, pivot_z + 0.015))

# The wings hang at rest; lifting them lets the worm down.
lift = None
for side, name in ((1, "left"), (-1, "right")):
    wing = obj.part(f"{name}_wing", material=cast)
    y, tip = side * 0.0175, side * (width / 2 - 0.0035)
    wing.add(cylinder(0.0055, 0.01), at=(0, y, pivot_z), rpy=(0, math.pi / 2, 0))
    path = [(0, y, pivot_z), (0, side * (R + 0.0085), pivot_z - 0.016),
            (0, side * (R + 0.009), 0.32 * height), (0, tip, 0.22 * height)]  # fmt: skip
    wing.add(sweep(path, width=[0.009, 0.009, 0.012, 0.014], thickness=0.005))
    wing.add(sphere(0.0035), at=(0, tip, 0.22 * height))
    for k in range(3):
        turn = 0.5 + k * 0.8
        tooth = (0, y - side * 0.0055 * math.sin(turn), pivot_z + 0.0055 * math.cos(turn))
        wing.add(box((0.008, 0.0015, 0.0015)), at=tooth, rpy=(turn * side, 0, 0), role="visual")
    hinge, axis = (0, y, pivot_z), (side, 0, 0)
    if lift is None:
        lift = obj.revolute(
            "wing_lift", body, wing, at=hinge, axis=axis, range=(0, 1.9), friction=0.1
        )
    else:
        obj.revolute("right_lift", body, wing, at=hinge, axis=axis, range=(0, 1.9), mimic=lift)

spindle = obj.part("spindle", material="steel")
tail = 0.16 * height
travel = tail - 0.004
head = pivot_z + 0.02 + travel
spindle.add(cylinder(0.0045, head - pivot_z + 0.018), at=(0, 0, head), by="top")
turns, steps = 4, 32
helix = [
    (0.0025 * math.cos(2 * math.pi * turns * k / steps),
     0.0025 * math.sin(2 * math.pi * turns * k / steps),
     tail + (pivot_z - 0.016 - tail) * k / steps)
    for k in range(steps + 1)
]  # fmt: skip
spindle.add(sweep(helix, radius=0.0013, sectors=6), name="worm")
obj.prismatic("screw_down", body, spindle, axis="bottom", range=(0, travel), mimic=lift,
              multiplier=travel / 1.9, friction=1.5)  # fmt: skip
grip = obj.part("handle", material=cast)
z = head + 0.0005
rest = height - z
if top == "opener":
    grip.add(cylinder(0.007, 0.3 * rest), at=(0, 0, z), by="bottom")
    loop = torus(0.34 * rest, 0.0032)
    grip.add(loop, at=(0, 0, height), rpy=(math.pi / 2, 0, math.pi / 2), by="top")
elif top == "knob":
    grip.add(lathe([(0, 0), (0.007, 0), (0.011, 0.5 * rest), (0.009, rest)]), at=(0, 0, z))
else:
    grip.add(cylinder(0.006, rest - 0.006), at=(0, 0, z), by="bottom")
    bar = cylinder(0.006, 0.8 * width)
    grip.add(bar, at=(0, 0, height), rpy=(math.pi / 2, 0, 0), by="top", material="walnut")
obj.continuous("handle_turn", spindle, grip, at=(0, 0, z), axis="top")
