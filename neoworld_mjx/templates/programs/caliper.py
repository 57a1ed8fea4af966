# Label: vernier caliper
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, prism

depth = 0.08  # 0.07 to 0.1 m
width = 0.23  # 0.19 to 0.3 m
height = 0.016  # 0.0135 to 0.02 m
reading = "dial"  # one of dial, digital, vernier
marks = 24  # 15 to 40
depth_rod = "rod"  # one of rod, none

# It lies flat with its scale up, the beam along y; the long jaws point to the front.
obj = Object("caliper", label="vernier caliper")
steel = obj.material("satin", like="stainless_steel", density=6000)
THICK, BEAM = 0.0036, 0.016
left, front = width / 2, depth / 2
x = front - 0.62 * depth
base = obj.part("beam", material=steel)
zero = left - 0.03
base.add(box((BEAM, width, THICK)), at=(x, left, 0), by="left.bottom")
long_jaw = [
    (x - 0.002, left - 0.002),
    (x - 0.002, zero),
    (front, zero),
    (front, zero + 0.004),
    (x + 0.4 * depth, left - 0.006),
]
base.add(prism(long_jaw[::-1], THICK), at=(0, 0, THICK / 2))
short_jaw = [(x, zero + 0.012), (x, zero), (-front, zero), (-front, zero + 0.003)]
base.add(prism(short_jaw, THICK), at=(0, 0, THICK / 2))
for k in range(marks):
    tall = 0.006 if k % 5 == 0 else 0.004
    y = zero - 0.01 - k * (width - 0.09) / marks
    line = (x + BEAM / 2 - 0.001, y, THICK)
    base.add(box((tall, 0.0006, 0.0004)), at=line, by="front", role="visual", rgb=(0.1, 0.1, 0.1))

slider = obj.part("slider", material=steel)
low, high, wide = THICK + 0.0005, height, 0.055
y = zero - 0.0005
for px in (x - BEAM / 2 - 0.0008, x + BEAM / 2 + 0.0008):
    face = "front" if px < x else "back"
    slider.add(box((0.003, wide, low + 0.002)), at=(px, y, 0), by=f"left.bottom.{face}")
slider.add(box((BEAM + 0.0076, wide, 0.0025)), at=(x, y, low), by="left.bottom")
inner = [
    (x + BEAM / 2 + 0.002, y - 0.024),
    (front, y - 0.004),
    (front, y),
    (x + BEAM / 2 + 0.002, y),
]
slider.add(prism(inner, THICK), at=(0, 0, THICK / 2))
upper = [
    (x - BEAM / 2 - 0.002, y - 0.012),
    (x - BEAM / 2 - 0.002, y),
    (-front, y),
    (-front, y - 0.003),
]
slider.add(prism(upper[::-1], THICK), at=(0, 0, THICK / 2))
travel = width - 0.03 - wide - 0.025
slide = obj.prismatic("measure", base, slider, axis="right", range=(0, travel), friction=0.5)
top, centre = low + 0.0025, (x, y - wide / 2, 0)
if reading == "dial":
    dial = cylinder(0.0185, high - top - 0.0025)
    slider.add(dial, at=(x, y - 0.025, top), by="bottom", rgb=(0.15, 0.15, 0.16))
    face = cylinder(0.0165, 0.0006)
    slider.add(face, at=(x, y - 0.025, high - 0.0025), role="visual", rgb=(0.95, 0.95, 0.93))
    needle = obj.part("needle", material="plastic")
    tip = (x, y - 0.025, high - 0.0015)
    needle.add(
        box((0.019, 0.0014, 0.001)),
        at=(x - 0.004, y - 0.025, tip[2]),
        by="centre",
        rgb=(0.8, 0.1, 0.1),
    )
    needle.add(cylinder(0.002, 0.0018), at=(tip[0], tip[1], high), by="top", rgb=(0.1, 0.1, 0.1))
    obj.continuous(
        "needle_turn", slider, needle, at=tip, axis="bottom", mimic=slide, multiplier=200
    )
else:
    case = (0.03, wide - 0.004, high - top) if reading == "digital" else (BEAM, wide, 0.002)
    shade = (0.15, 0.15, 0.16) if reading == "digital" else (0.7, 0.7, 0.72)
    slider.add(box(case), at=(x - 0.002, y - wide / 2, top), by="bottom", rgb=shade)
    glass = (0.014, 0.7 * wide, 0.0005)
    tint = (0.62, 0.7, 0.6) if reading == "digital" else (0.95, 0.95, 0.93)
    slider.add(box(glass), at=(x - 0.002, centre[1], top + case[2]), role="visual", rgb=tint)
if reading == "vernier":
    slider.add(box((0.01, 0.01, high - top)), at=(x - 0.006, y - 0.006, top), by="bottom")
roller = obj.part("thumb_roller", material="steel")
pin = (x + BEAM / 2 + 0.0028 + 0.0052, y - wide + 0.012, 0.5 * THICK + 0.002)
roller.add(cylinder(0.005, 0.004), at=pin)
obj.continuous("roll", slider, roller, at=pin, axis="top")
screw = obj.part("lock_screw", material="brass")
at = (x - BEAM / 2 - 0.0038, y - 0.02, 0.004)
screw.add(
    cylinder(0.003, 0.007), at=(at[0] - 0.0005, at[1], at[2]), rpy=(0, math.pi / 2, 0), by="front"
)
obj.continuous("lock", slider, screw, at=at, axis="back")
if depth_rod == "rod":
    rod = box((0.002, 0.03, 0.0012))
    slider.add(rod, at=(x, y - wide + 0.004, low - 0.0002), by="left.bottom", role="visual")
