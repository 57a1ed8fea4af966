# Label: bar clamp
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, difference, lathe

depth = 0.4  # 0.3 to 0.6 m
width = 0.15  # 0.12 to 0.2 m
height = 0.034  # 0.03 to 0.042 m
grip = "round"  # one of round, faceted
opening = 0.5  # 0.3 to 0.7
wood = "pine"  # one of pine, oak, walnut
paint = "red"  # one of red, blue, black

# It lies flat: the rail runs to the front along the left, the jaws reach to the right.
PAINT = {"red": (0.7, 0.12, 0.1), "blue": (0.12, 0.25, 0.55), "black": (0.12, 0.12, 0.13)}
obj = Object("bar_clamp", label="bar clamp")
cast = obj.material("cast", like="cast_iron", density=4000, rgb=PAINT[paint])
mid, left, along = height / 2, width / 2, (0, math.pi / 2, 0)
back, front, bar = -depth / 2, depth / 2, 0.022
rail = obj.part("rail", material="steel")
rail_y = left - bar / 2 - 0.006
rail.add(box((0.8 * depth, bar, 0.007)), at=(back, rail_y, mid), by="back")
for k in range(int(0.6 * depth / 0.02)):
    notch = (back + 0.15 * depth + 0.02 * k, rail_y - bar / 2, mid)
    rail.add(box((0.002, 0.002, 0.0072)), at=notch, role="visual", rgb=(0.2, 0.2, 0.2))
jaw_end = -left + 0.003
head = box((0.028, left - jaw_end, height))
rail.add(head, at=(back, left, mid), by="back.left", material=cast)
rail.add(
    cylinder(0.012, 0.006),
    at=(back + 0.028, -left + mid - 0.001, mid),
    rpy=along,
    by="back",
    material=cast,
)

# The arm slides on the rail, the screw in the arm; a pad swivels on the screw's end.
arm = obj.part("arm", material=cast)
tail = front - 0.1005
x = tail - 0.035 - (1 - opening) * 0.25 * (depth - 0.2)
sleeve = difference(box((0.026, bar + 0.012, height)), box((1, bar + 0.001, 0.008)))
arm.add(sleeve, at=(x, rail_y, mid))
screw_y = -left + mid - 0.001
reach = rail_y - bar / 2 - 0.004 - screw_y
nut = difference(cylinder(0.0145, 0.03).moved(rpy=along), cylinder(0.0068, 1).moved(rpy=along))
arm.add(nut, at=(x, screw_y, mid))
arm.add(box((0.02, reach - 0.01, 0.7 * height)), at=(x, screw_y + 0.012, mid), by="right")
limit = 0.8 * depth + back - 0.02
obj.prismatic("arm_slide", rail, arm, axis="front", range=(0, limit - x), friction=1.5)
screw = obj.part("screw", material="steel")
pad_x = back + 0.04 + 0.2 * (x - back)
screw.add(cylinder(0.006, tail - pad_x), at=(pad_x, screw_y, mid), rpy=along, by="back")
obj.prismatic(
    "screw_feed",
    arm,
    screw,
    axis="back",
    range=(0, min(pad_x - back - 0.044, tail - x - 0.018)),
    friction=1.5,
)
handle = obj.part("handle", material=wood)
r = mid - 0.001
profile = [(0, 0), (0.7 * r, 0), (r, 0.015), (0.85 * r, 0.05), (r, 0.09), (0.6 * r, 0.1)]
if grip == "faceted":
    profile = [(0, 0), (0.8 * r, 0), (r, 0.01), (r, 0.09), (0.8 * r, 0.1)]
stick = lathe(profile, sectors=6 if grip == "faceted" else 12)
handle.add(stick, at=(tail + 0.0005, screw_y, mid), rpy=along)
obj.continuous("handle_turn", screw, handle, at=(tail, screw_y, mid), axis="front")
pad = obj.part("pad", material="steel")
pad.add(cylinder(0.014, 0.006), at=(pad_x - 0.0015, screw_y, mid), rpy=along, by="front")
obj.ball("swivel", screw, pad, at=(pad_x - 0.0015, screw_y, mid), swing=0.08)
