# Label: garlic press
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, sweep, torus

depth = 0.19  # 0.16 to 0.23 m
width = 0.044  # 0.036 to 0.052 m
height = 0.058  # 0.05 to 0.068 m
basket = "square"  # one of square, long
finish = "steel"  # one of steel, black, red
end = "ring"  # one of ring, round

LOOK = {"steel": (0.74, 0.75, 0.77), "black": (0.12, 0.12, 0.13), "red": (0.7, 0.12, 0.1)}
obj = Object("garlic_press", label="garlic press")
cast = obj.material("cast", like="aluminium", rgb=LOOK[finish])
steel = obj.material("sieve", like="stainless_steel", density=4000)
WALL, front = 0.003, depth / 2
long = 0.036 if basket == "square" else 0.05
deep = 0.5 * height
bar = 0.18 * height
body = obj.part("body", material=cast)
cup_x = front - 0.016 - long / 2

# The lower handle carries an open frame; the sieve basket hangs in it.
for y in (-width / 2 + 0.003, width / 2 - 0.003):
    body.add(box((long + 0.03, 0.006, 0.45 * deep)), at=(front, y, 0.9 * deep), by="front.top")
    body.add(box((0.012, 0.006, 0.9 * deep)), at=(front, y, 0), by="front.bottom")
back = front - long - 0.03
body.add(box((0.008, width, 0.45 * deep)), at=(back, 0, 0.9 * deep), by="back.top")
body.add(box((0.01, 0.6 * width, 0.012)), at=(front, 0, 0.012), by="front.top")
body.add(box((0.01, width, 0.006)), at=(front, 0, 0), by="front.bottom")
path = [
    (back + 0.004, 0, 0.7 * deep),
    (0.1 * depth, 0, 0.5 * deep),
    (-0.2 * depth, 0, bar / 2 + 0.002),
    (-front + 0.012, 0, bar / 2),
]
body.add(sweep(path, width=[0.02, 0.016, 0.018, 0.02], thickness=bar, smooth=3))
if end == "ring":
    loop = torus(0.009, 0.003)
    body.add(loop, at=(-front, 0, bar / 2), by="back")
else:
    body.add(cylinder(0.011, bar), at=(-front, 0, bar / 2), by="back")

inner = width - 0.014
top = deep
shell = hollow_box((long, inner, 0.66 * deep), WALL, open="+z")
body.add(shell, at=(cup_x - 0.004, 0, top), by="top", material=steel)
for k in range(4):
    for j in range(3):
        dot = (cup_x - 0.004 + (k - 1.5) * long / 5, (j - 1) * inner / 4, top - 0.66 * deep)
        body.add(cylinder(0.0015, 0.0006), at=dot, role="visual", rgb=(0.1, 0.1, 0.1))
for y in (-inner / 2, inner / 2):
    # The basket hangs in the frame by its edges.
    edge = box((long, 0.004, 0.006))
    body.add(edge, at=(cup_x - 0.004, 1.06 * y, top - 0.002), by="top", material=steel)

# The upper handle turns about the front; a plunger hangs under it and stays upright.
lever = obj.part("lever", material=cast)
pin = (front - 0.007, 0, 0.9 * deep + 0.0085)
for y in (-width / 2 + 0.0025, width / 2 - 0.0025):
    body.add(box((0.014, 0.005, 0.02)), at=(front, y, 0.9 * deep - 0.004), by="front.bottom")
wide = width - 0.0115
lever.add(cylinder(0.006, wide), at=pin, rpy=(math.pi / 2, 0, 0))
level = height - bar / 2
hook = [
    (pin[0], 0, pin[2] + 0.001),
    (cup_x + 0.01, 0, level),
    (0, 0, level),
    (-front + 0.012, 0, level - 0.001),
]
lever.add(sweep(hook, width=[0.02, 0.02, 0.016, 0.02], thickness=[0.01, bar, bar, bar]))
lever.add(cylinder(0.011, bar), at=(-front, 0, level), by="back")
turn = obj.revolute("squeeze", body, lever, at=pin, axis=(0, 1, 0), range=(0, 1.3), friction=0.06)
piston = obj.part("plunger", material=steel)
head = (cup_x - 0.004, 0, level - bar / 2 - 0.0075)
gap = head[2] - top
piston.add(cylinder(0.006, 0.016), at=head, rpy=(math.pi / 2, 0, 0))
piston.add(box((0.01, 0.014, gap + 0.004)), at=head, by="top")
piston.add(
    box((long - 2 * WALL - 0.004, inner - 2 * WALL - 0.003, 0.004)),
    at=(head[0], 0, top + 0.001),
    by="bottom",
)
obj.revolute(
    "plunger_tilt",
    lever,
    piston,
    at=head,
    axis=(0, -1, 0),
    range=(0, 0.65),
    mimic=turn,
    multiplier=0.5,
)
