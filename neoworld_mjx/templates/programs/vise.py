# Label: bench vise
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, difference, frustum, rounded_box, sphere

depth = 0.36  # 0.3 to 0.46 m
width = 0.18  # 0.15 to 0.24 m
height = 0.2  # 0.16 to 0.25 m
base = "swivel"  # one of swivel, fixed
anvil = "flat"  # one of flat, horn
colour = "blue"  # one of blue, red, grey, green

PAINT = {"blue": (0.12, 0.25, 0.5), "red": (0.65, 0.12, 0.1), "green": (0.2, 0.38, 0.25)}
obj = Object("vise", label="bench vise")
paint = obj.material(
    "paint", like="cast_iron", density=2200, rgb=PAINT.get(colour, (0.4, 0.42, 0.44))
)
steel = obj.material("steel_bar", like="steel", density=4500)
along, across = (0, math.pi / 2, 0), (math.pi / 2, 0, 0)
back, front, FOOT = -depth / 2, depth / 2, 0.16 * height
jaw, x = 0.8 * width, back + 0.66 * depth
foot = obj.part("base", material=paint)
centre = (x - 0.2 * depth, 0, 0)
foot.add(cylinder(0.36 * width, FOOT), at=centre, by="bottom")
for k in range(3):
    t = 2 * math.pi * k / 3
    r = 0.4 * width
    lug = (centre[0] + r * math.cos(t), r * math.sin(t), 0)
    foot.add(box((0.25 * width, 0.2 * width, 0.5 * FOOT)), at=lug, rpy=(0, 0, t), by="bottom")
body = foot
if base == "swivel":
    body = obj.part("body", material=paint)
    foot.add(
        cylinder(0.01, 0.03), at=(centre[0], 0.36 * width, 0.7 * FOOT), rpy=across, material=steel
    )
lift = FOOT + 0.0005
mid = 0.52 * height
bore = 0.2 * width
# The fixed jaw stands before the anvil; a square tunnel through both holds the sliding one.
block = box((x - back - 0.01, 0.44 * width, mid + bore - lift))
tunnel = box((1, 0.3 * width + 0.002, 0.3 * width + 0.002)).moved(
    (0, 0, mid - (mid + bore + lift) / 2)
)
stretch = (x + back + 0.01) / 2
body.add(difference(block, tunnel), at=(stretch, 0, (mid + bore + lift) / 2))
body.add(cylinder(0.34 * width, 0.1 * height), at=(centre[0], 0, lift), by="bottom")
if base == "fixed":
    body.add(cylinder(0.3 * width, 0.002), at=(centre[0], 0, FOOT - 0.0005), by="bottom")
cap = mid + bore
body.add(
    rounded_box((0.1 * depth, jaw, height - cap + 0.006), 0.006), at=(x, 0, height), by="front.top"
)
body.add(
    box((0.008, width, 0.14 * height)), at=(x, 0, height - 0.004), by="back.top", material=steel
)
if anvil == "flat":
    body.add(
        box((0.14 * depth, 0.5 * width, 0.16 * height)),
        at=(back, 0, cap + 0.01),
        by="back.top",
        material=steel,
    )
else:
    horn = frustum(0.09 * width, 0.02 * width, 0.16 * depth)
    body.add(
        horn,
        at=(back + 0.16 * depth, 0, cap - 0.02),
        rpy=(0, -math.pi / 2, 0),
        by="front",
        material=steel,
    )
    body.add(box((0.05, 0.3 * width, 0.02)), at=(back, 0, cap), by="back.top", material=steel)
if base == "swivel":
    obj.revolute("swivel", foot, body, at=(centre[0], 0, lift), axis="top", range=(-1.5, 1.5))

slider = obj.part("sliding_jaw", material=paint)
plate_x = x + 0.009
slider.add(
    box((0.008, width, 0.14 * height)),
    at=(plate_x, 0, height - 0.004),
    by="back.top",
    material=steel,
)
head = rounded_box((0.1 * depth, jaw, height - cap + 0.02), 0.006)
slider.add(head, at=(plate_x + 0.0075, 0, height), by="back.top")
slider.add(
    box((0.1 * depth, 0.42 * width, height - mid + 0.28 * width - 0.02)),
    at=(plate_x + 0.0075, 0, height - 0.015),
    by="back.top",
)
ram_end = plate_x + 0.01
hole = cylinder(0.062 * width, 1).moved(rpy=along)
ram = difference(box((0.5 * depth, 0.3 * width, 0.3 * width)), hole)
slider.add(ram, at=(ram_end, 0, mid), by="front")
slider.add(
    cylinder(0.12 * width, 0.02),
    at=(plate_x + 0.0075 + 0.1 * depth - 0.004, 0, mid),
    rpy=along,
    by="back",
)
slide = obj.prismatic(
    "jaw_slide", body, slider, axis="front", range=(0, 0.3 * depth), opens="front", friction=5
)

screw = obj.part("screw", material=steel)
nose = plate_x + 0.0075 + 0.1 * depth + 0.0165
slot = nose + 0.5 * (front - nose)
eye = cylinder(0.007, 1).moved((0, 0, 0), rpy=across)
knob = difference(cylinder(0.09 * width, front - nose).moved(rpy=along), eye)
screw.add(knob, at=(slot, 0, mid))
obj.continuous("screw_turn", slider, screw, at=(nose, 0, mid), axis="front")
bar = obj.part("tommy_bar", material=steel)
reach = 0.42 * width
bar.add(cylinder(0.006, 2 * reach), at=(slot, 0, mid), rpy=across)
for y in (-reach, reach):
    bar.add(sphere(0.01), at=(slot, y, mid))
obj.prismatic("bar_slide", screw, bar, axis="left", range=(-0.2 * width, 0.2 * width), friction=1)
