# Label: bucket
# PartNet-Mobility: Bucket
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe, mirror, sweep, tube

depth = 0.28  # 0.22 to 0.34 m
width = 0.3  # 0.25 to 0.36 m
height = 0.44  # 0.36 to 0.54 m
lid = "yes"  # one of yes, no
grip = "roller"  # one of roller, plain
hoops = 2  # 0 to 3
finish = "zinc"  # one of zinc, red, blue, yellow, white

EAR = 0.014
bucket = Object("bucket", label="bucket")
tones = {
    "zinc": (0.62, 0.65, 0.67),
    "red": (0.7, 0.12, 0.1),
    "blue": (0.15, 0.35, 0.65),
    "yellow": (0.9, 0.75, 0.15),
    "white": (0.93, 0.93, 0.92),
}
bucket.material("wall", like="steel" if finish == "zinc" else "polyethylene", rgb=tones[finish])
body = bucket.part("body", material="wall")
wall = 0.001 if finish == "zinc" else 0.0025
r, wide = depth / 2, width / 2 - EAR
oval = wide / r
rim = 0.6 * height
low = 0.72 * r
body.add(lathe([(0, 0), (low, 0), (r, rim)], thickness=wall, sectors=20, oval=oval), name="wall")
for k in range(hoops):
    t = 0.25 + 0.3 * k
    q = low + (r - low) * t - 0.001
    ring = [
        (q * math.cos(a), q * oval * math.sin(a), t * rim)
        for a in [math.pi * i / 12 for i in range(24)]
    ]
    body.add(sweep(ring, radius=0.003, closed=True))
edge = [
    (0.985 * r * math.cos(a), 0.985 * r * oval * math.sin(a), rim)
    for a in [math.pi * i / 12 for i in range(24)]
]
body.add(sweep(edge, radius=0.0035, closed=True), name="rim")
pin = rim - 0.03
for side in mirror((0, wide - 0.012, pin)):
    body.add(box((0.03, 0.0195, 0.03)), at=side, by="right" if side[1] > 0 else "left")

# The bail stands up; it falls to either side.
handle = bucket.part("handle", material="steel")
y, top = width / 2 - 0.003, height - (0.012 if grip == "roller" else 0.003)
bend = min(0.6 * y, top - pin - 0.05)
path = [
    (0, -y, pin - 0.008),
    (0, -y, top - bend),
    (0, -0.07, top),
    (0, 0.07, top),
    (0, y, top - bend),
    (0, y, pin - 0.008),
]
handle.add(sweep(path, radius=0.003))
if lid == "yes":
    swing = bucket.revolute(
        "handle_fall", body, handle, at=(0, 0, pin), axis=(0, -1, 0), range=(0, 1.3), friction=0.6
    )
    cover = bucket.part("lid", material="wall")
    plate = lathe([(0, 0), (0.985 * r, 0), (0.985 * r, 0.006)], sectors=20, oval=oval)
    cover.add(plate, at=(0, 0, rim + 0.0042), material="polyethylene", rgb=tones[finish])
    cover.add(cylinder(0.018, 0.025), at=(0, 0, rim + 0.01), by="bottom", material="wood")
    bucket.prismatic("lid_lift", body, cover, axis="up", range=(0, 0.15), after=swing, damping=30)
else:
    bucket.revolute(
        "handle_fall",
        body,
        handle,
        at=(0, 0, pin),
        axis=(0, -1, 0),
        range=(-1.3, 1.3),
        friction=0.6,
    )
if grip == "roller":
    roller = bucket.part("grip", material="wood")
    roller.add(tube(0.012, 0.0075, 0.11), at=(0, 0, top), rpy=(math.pi / 2, 0, 0))
    bucket.continuous("grip_roll", handle, roller, at=(0, 0, top), axis="left")
