# Label: toy excavator
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, rounded_box, sweep

depth = 0.4  # 0.32 to 0.5 m
width = 0.15  # 0.12 to 0.19 m
height = 0.22  # 0.18 to 0.27 m
wheels = 4  # 3 to 6
cab_side = "left"  # one of left, right
bucket_shape = "toothed"  # one of toothed, plain
colour = "yellow"  # one of yellow, orange, green, red

PAINT = {"yellow": (0.92, 0.72, 0.1), "orange": (0.9, 0.42, 0.1), "green": (0.2, 0.5, 0.25)}
obj = Object("excavator_toy", label="toy excavator")
paint = obj.material("paint", like="abs", rgb=PAINT.get(colour, (0.75, 0.13, 0.1)))
dark = obj.material("dark", like="abs", rgb=(0.13, 0.13, 0.14))
across = (math.pi / 2, 0, 0)
long, track = 0.46 * depth, 0.2 * width
back, R = -depth / 2, 0.13 * height
mid = back + 0.5 * long
base = obj.part("tracks", material=dark, mass=0.9)
for y in (-width / 2 + track / 2, width / 2 - track / 2):
    turns = [math.pi * (k / 6 - 0.5) for k in range(7)]
    belt = [(long / 2 - R + R * math.cos(t), R + R * math.sin(t)) for t in turns]
    belt += [(-px, 2 * R - pz) for px, pz in belt]
    base.add(extrusion(belt, track), at=(mid, y, 0), rpy=across)
    for k in range(wheels):
        wx = mid + (k / (wheels - 1) - 0.5) * (long - 2 * R)
        side = y + math.copysign(track / 2, y)
        hub = cylinder(0.55 * R, 0.002)
        base.add(hub, at=(wx, side, R), rpy=across, role="visual", material=paint)
base.add(box((0.5 * long, width - track, R)), at=(mid, 0, 0.6 * R), by="bottom")
base.add(cylinder(0.22 * width, 0.7 * R), at=(mid, 0, 1.55 * R), by="bottom")
deck = 2.25 * R + 0.0005

house = obj.part("house", material=paint)
house.add(box((0.85 * long, 0.86 * width, 0.06 * height)), at=(mid, 0, deck), by="bottom")
floor = deck + 0.06 * height - 0.001
engine = rounded_box((0.34 * long, 0.86 * width, 0.26 * height), 0.006)
house.add(engine, at=(mid - 0.425 * long, 0, floor), by="back.bottom")
sign = 1 if cab_side == "left" else -1
cab = (mid + 0.12 * long, sign * 0.26 * width, floor)
top = height - floor
house.add(box((0.42 * long, 0.34 * width, 0.4 * top)), at=cab, by="bottom")
house.add(box((0.42 * long, 0.34 * width, 0.06 * top)), at=(cab[0], cab[1], height), by="top")
glass = box((0.38 * long, 0.3 * width, 0.56 * top))
house.add(glass, at=(cab[0], cab[1], floor + 0.39 * top), by="bottom", rgb=(0.55, 0.7, 0.78))
pipe = (mid - 0.3 * long, -sign * 0.3 * width, floor + 0.25 * height)
house.add(cylinder(0.006, 0.1 * height), at=pipe, by="bottom", material=dark)
obj.continuous("swing", base, house, at=(mid, 0, deck), axis="top")

# Boom, stick and bucket lie in one plane beside the cab.
y = -sign * 0.08 * width
pin = (mid + 0.36 * long, y, floor + 0.07 * height)
thick = 0.13 * width
for off in (-thick / 2 - 0.005, thick / 2 + 0.005):
    lug = box((0.1 * long, 0.008, 0.14 * height))
    house.add(lug, at=(pin[0], y + off, floor), by="bottom")
knee_x = 0.5 * (pin[0] + depth / 2)
tip = (depth / 2 - 0.17 * depth, 0.72 * height)
boom = obj.part("boom", material=paint)
path = [(pin[0], y, pin[2]), (knee_x - 0.06 * depth, y, 0.9 * height), (tip[0], y, tip[1])]
boom.add(sweep(path, width=thick, thickness=[0.08 * height, 0.11 * height, 0.06 * height]))
boom.add(cylinder(0.045 * height, thick), at=pin, rpy=across)
boom.add(cylinder(0.035 * height, thick), at=(tip[0], y, tip[1]), rpy=across)
obj.revolute("boom_lift", house, boom, at=pin, axis=(0, -1, 0), range=(-0.15, 0.45), friction=1.5)
stick = obj.part("stick", material=paint)
end = (depth / 2 - 0.075 * height - 0.0035, 0.27 * height)
for off in (-thick / 2 - 0.0045, thick / 2 + 0.0045):
    rail = [
        (tip[0] - 0.02 * depth, y + off, tip[1] + 0.08 * height),
        (tip[0], y + off, tip[1]),
        (end[0], y + off, end[1]),
    ]
    stick.add(sweep(rail, width=0.008, thickness=[0.03 * height, 0.07 * height, 0.05 * height]))
low = (tip[0] + 0.6 * (end[0] - tip[0]), y, tip[1] + 0.6 * (end[1] - tip[1]))
stick.add(box((0.03 * height, thick + 0.004, 0.12 * height)), at=low)
obj.revolute(
    "stick_swing",
    boom,
    stick,
    at=(tip[0], y, tip[1]),
    axis=(0, -1, 0),
    range=(-0.25, 0.6),
    friction=0.8,
)
bucket = obj.part("bucket", material=dark)
bite = 0.25 * height
bucket.add(cylinder(0.028 * height, thick), at=(end[0], y, end[1]), rpy=across)
shell = [(0.02, -0.1), (0.26, -0.22), (0.3, -0.62), (0.12, -0.88), (-0.28, -0.9)]
curve = [(end[0] + px * bite, y, end[1] + pz * bite) for px, pz in shell]
wide = 0.42 * width
bucket.add(sweep(curve, width=wide, thickness=0.006))
bucket.add(
    box((0.12 * bite, thick, 0.25 * bite)), at=(end[0] + 0.02 * bite, y, end[1] - 0.08 * bite)
)
cheek = [(px * bite, pz * bite) for px, pz in shell]
for off in (-wide / 2 + 0.002, wide / 2 - 0.002):
    bucket.add(extrusion(cheek[::-1], 0.004), at=(end[0], y + off, end[1]), rpy=across)
if bucket_shape == "toothed":
    for k in range(4):
        tooth = (end[0] - 0.3 * bite, y + (k - 1.5) * wide / 4.2, end[1] - 0.9 * bite)
        bucket.add(box((0.12 * bite, 0.1 * wide, 0.006)), at=tooth)
obj.revolute(
    "bucket_curl",
    stick,
    bucket,
    at=(end[0], y, end[1]),
    axis=(0, -1, 0),
    range=(-0.3, 0.9),
    friction=0.2,
)
