# Label: parking barrier
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, rounded_box

depth = 0.4  # 0.32 to 0.5 m
width = 2.6  # 1.8 to 3.2 m
height = 1.05  # 0.9 to 1.2 m
stripes = 6  # 4 to 9
housing = "box"  # one of box, round
skirt = 5  # 0 to 8
colour = "yellow"  # one of yellow, grey, orange

PAINT = {"yellow": (0.92, 0.75, 0.1), "grey": (0.6, 0.62, 0.64), "orange": (0.92, 0.45, 0.1)}
obj = Object("parking_barrier", label="parking barrier")
case = obj.material("case", like="insulated", density=350, rgb=PAINT[colour])
white = obj.material("white", like="aluminium", density=300, rgb=(0.95, 0.95, 0.93))
red = obj.material("red", like="aluminium", density=300, rgb=(0.8, 0.1, 0.08))
kerb = obj.material("kerb", like="concrete", rgb=(0.55, 0.55, 0.53))
left, KERB, LAMP = width / 2, 0.06, 0.06
HUB = 0.32
post_y = left - HUB / 2 - 0.02
body = obj.part("housing", material=case)
body.add(box((depth, width, KERB)), by="bottom", material=kerb)
top = height - LAMP
x = -depth / 2 + 0.3 * depth
if housing == "box":
    body.add(rounded_box((0.5 * depth, HUB, top - KERB), 0.02), at=(x, post_y, KERB), by="bottom")
else:
    body.add(cylinder(0.25 * depth, top - KERB), at=(x, post_y, KERB), by="bottom")
body.add(cylinder(0.035, LAMP + 0.001), at=(x, post_y, height), by="top", rgb=(0.95, 0.55, 0.1))
front = x + 0.25 * depth
pivot = (front + 0.0005, post_y, 0.82 * top)
along = (0, math.pi / 2, 0)
if housing == "box":
    hatch = obj.part("hatch", material=case)
    at = (x - 0.25 * depth - 0.0005, post_y, KERB + 0.12)
    hatch.add(box((0.012, 0.75 * HUB, 0.45 * top)), at=at, by="front.bottom")
    hatch.add(
        cylinder(0.012, 0.012),
        at=(at[0] - 0.012, post_y - 0.3 * HUB, 0.4 * top),
        rpy=along,
        by="front",
        material="steel",
    )
    hinge = (at[0] - 0.012, post_y + 0.375 * HUB, 0.4)
    obj.revolute("hatch_hinge", body, hatch, at=hinge, axis=(0, 0, -1), range=(0, 1.5))

# The boom tips up about the hub; a counterweight on its short end all but balances it.
boom = obj.part("boom", material=white)
boom.add(cylinder(0.07, 0.03), at=pivot, rpy=along, by="back", material=case)
bx = pivot[0] + 0.03
end = -width / 2
long = left - 0.02 - end
step = (post_y - 0.1 - end) / (2 * stripes)
for k in range(2 * stripes):
    piece = box((0.03, step, 0.07))
    y = end + k * step
    boom.add(piece, at=(bx - 0.002, y, pivot[2]), by="back.right", material=red if k % 2 else white)
tail = box((0.03, left - post_y + 0.1, 0.07))
boom.add(tail, at=(bx - 0.002, left, pivot[2]), by="back.left")
boom.add(
    box((0.028, 0.12, 0.14)),
    at=(bx - 0.002, left - 0.002, pivot[2]),
    by="back.left",
    material="cast_iron",
)
lift = obj.revolute(
    "raise", body, boom, at=pivot, axis=(-1, 0, 0), range=(0, 1.45), friction=40, opens="up"
)
# The bars of the skirt hang before the boom and stay upright as it rises.
span = post_y - 0.35 - end
for k in range(skirt):
    bar = obj.part(f"skirt_{k + 1}", material=white)
    y = end + 0.15 + k * span / max(skirt - 1, 1)
    at = (bx + 0.0285, y, pivot[2])
    bar.add(cylinder(0.012, 0.02), at=at, rpy=along, by="back", material="steel")
    bar.add(cylinder(0.01, 0.55 * pivot[2]), at=(at[0] + 0.01, y, pivot[2]), by="top")
    obj.revolute(
        f"skirt_{k + 1}_hang", boom, bar, at=at, axis=(-1, 0, 0), range=(-1.45, 0), mimic=lift,
        multiplier=-1,
    )  # fmt: skip
rest = end + 0.04
body.add(
    box((0.06, 0.05, pivot[2] - 0.036 - KERB)),
    at=(bx + 0.013, rest, KERB),
    by="bottom",
    material="steel",
)
