# Label: eyeglasses
# PartNet-Mobility: Eyeglasses
import math

from neoworld_mjx.program.sdk import Object, box, ellipsoid, extrusion, sweep

depth = 0.135  # 0.125 to 0.14 m
width = 0.145  # 0.14 to 0.16 m
height = 0.046  # 0.038 to 0.054 m
rims = "round"  # one of round, square, oval
clip = "no"  # one of no, yes
colour = "tortoise"  # one of tortoise, black, gold, red, clear

upright = (math.pi / 2, 0, math.pi / 2)
RIM, THICK = 0.003, 0.004
glasses = Object("eyeglasses", label="eyeglasses")
tones = {
    "tortoise": (0.36, 0.2, 0.1),
    "black": (0.1, 0.1, 0.1),
    "gold": (0.82, 0.66, 0.3),
    "red": (0.6, 0.1, 0.12),
    "clear": (0.85, 0.88, 0.9),
}
glasses.material("frame", like="nylon", rgb=tones[colour])
glasses.material("lens", like="acrylic", rgb=(0.85, 0.92, 0.95), alpha=0.3)
glasses.material("shade", like="acrylic", rgb=(0.15, 0.18, 0.12), alpha=0.75)
SHADE = 0.004 if clip == "yes" else 0.0
front = depth / 2 - SHADE - THICK / 2
frame = glasses.part("frame", material="frame")
b = height / 2
a = min(0.5 * (width - 0.024) / 2 - 0.001, {"round": b, "square": 1.2 * b, "oval": 1.3 * b}[rims])
power = {"round": 2.0, "square": 4.5, "oval": 2.3}[rims]
eye = width / 2 - 0.005 - a


def outline(shrink):
    """Return the outline of a rim, smaller by so much."""
    points = []
    for k in range(12):
        c, s = math.cos(math.pi * k / 6), math.sin(math.pi * k / 6)
        u = math.copysign((a - shrink) * abs(c) ** (2 / power), c)
        points.append((u, math.copysign((b - shrink) * abs(s) ** (2 / power), s)))
    return points


shades = glasses.part("clip", material="frame") if clip == "yes" else frame
for y in (-eye, eye):
    rim = extrusion(outline(0), THICK, [outline(RIM)])
    frame.add(rim, at=(front, y, b), rpy=upright)
    frame.add(
        extrusion(outline(RIM - 0.0008), 0.0012), at=(front, y, b), rpy=upright, material="lens"
    )
    if clip == "yes":
        shades.add(
            extrusion(outline(0.001), 0.0016),
            at=(front + THICK / 2 + 0.0012, y, b),
            rpy=upright,
            material="shade",
        )
gap = eye - a
bridge = [
    (front, -gap - 0.002, 1.25 * b),
    (front + 0.001, 0, 1.4 * b),
    (front, gap + 0.002, 1.25 * b),
]
frame.add(sweep(bridge, radius=0.002, smooth=3))
if clip == "yes":
    top = front + THICK / 2 + 0.0014
    bar = [(top, -gap - 0.006, 1.55 * b), (top, gap + 0.006, 1.55 * b)]
    shades.add(sweep(bar, width=0.003, thickness=0.0012))
    shades.add(box((SHADE, 0.006, 0.004)), at=(depth / 2, 0, 1.55 * b), by="front")
    glasses.revolute(
        "clip_flip",
        frame,
        shades,
        at=(top, 0, 1.55 * b),
        axis=(0, -1, 0),
        range=(0, 1.4),
        friction=0.01,
    )
# The hinges differ in height and depth, so that one temple folds above and behind the other.
high, lead = 1.5 * b, None
for side, sign, far in (("left", 1, 0.012), ("right", -1, 0.018)):
    y = sign * (width / 2 - 0.002)
    inner = sign * (eye + 0.93 * a) if rims != "square" else sign * (eye + a - 0.002)
    frame.add(box((THICK, abs(y - inner) + 0.002, 0.006)), at=(front, (y + inner) / 2, high))
    pivot = front - far
    frame.add(box((far - 0.0008, 0.0032, 0.01)), at=(front, y, high + 0.0025), by="front")
    temple = glasses.part(f"{side}_temple", material="frame")
    rear = -depth / 2 + 0.0015
    z = high + (0.0 if sign > 0 else 0.0055)
    path = [(pivot, y, z), (rear + 0.03, y, z - 0.7 * high), (rear, y, z - high + 0.0022)]
    temple.add(sweep(path, width=0.0028, thickness=0.004))
    # Hands fold both at once; one after the other they would meet half-way.
    lead = glasses.revolute(
        f"{side}_fold",
        frame,
        temple,
        at=(pivot, y, high),
        axis=(0, 0, sign),
        range=(0, 1.55),
        friction=0.01,
        mimic=lead,
    )
    pad = glasses.part(f"{side}_pad", material="silicone")
    spot = (front - 0.008, sign * (gap + 0.001), 0.85 * b)
    frame.add(
        sweep(
            [(front, sign * (gap + 0.002), 0.95 * b), (spot[0] + 0.0022, spot[1], 0.85 * b)],
            radius=0.0007,
        )
    )
    pad.add(ellipsoid((0.0015, 0.0022, 0.005)), at=spot)
    tilt = (-0.25, 0.25)
    glasses.revolute(f"{side}_pad_tilt", frame, pad, at=spot, axis="left", range=tilt)
