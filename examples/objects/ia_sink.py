import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, sweep

# Sink, box 0.44 x 0.48 x 0.465 m: open bowl with a flat rim, faucet beside the rim at -y.
X, Y, Z = 0.44, 0.48, 0.465
RIM_Y = 0.408  # width of the rim
H = 0.190  # height of the bowl
RIM, WALL, CORNER = 0.018, 0.002, 0.025

sink = Object("ia_sink", label="kitchen sink with faucet")
steel = sink.material(
    "matt_steel", like="stainless_steel", rgb=(0.68, 0.68, 0.68), metallic=0.3, roughness=0.5
)


def rounded(x, y, r):
    """Outline of a rectangle with round corners."""
    points = []
    for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        for i in range(4):
            a = math.pi / 2 * (k + i / 3)
            points.append((sx * (x / 2 - r) + r * math.cos(a), sy * (y / 2 - r) + r * math.sin(a)))
    return points


cy = Y / 2 - RIM_Y / 2  # middle of the bowl; the box is centred at y = 0
bx, by = X - 2 * RIM, RIM_Y - 2 * RIM  # outer size of the bowl
inner = rounded(bx - 2 * WALL, by - 2 * WALL, CORNER - WALL)

body = sink.part("body", material=steel)
body.add(
    extrusion(rounded(bx, by, CORNER), H - 0.010, holes=[inner]),
    at=(0, cy, 0.010),
    by="bottom",
    name="walls",
)
# Chamfered lower edge and floor
low = rounded(bx - 0.016, by - 0.016, CORNER - 0.006)
body.add(
    extrusion(rounded(bx - 0.002, by - 0.002, CORNER), 0.006),
    at=(0, cy, 0.006),
    by="bottom",
    name="floor",
)
body.add(extrusion(low, 0.0065), at=(0, cy, 0), by="bottom", name="underside")
body.add(
    extrusion(rounded(X, RIM_Y, 0.012), 0.004, holes=[inner]), at=(0, cy, H), by="top", name="rim"
)
body.add(
    cylinder(0.04, 0.002),
    at=(0, cy, 0.012),
    by="bottom",
    rgb=(0.6, 0.6, 0.6),
    role="visual",
    name="drain",
)

# Foot of the faucet, joined to the rim by a thin bar at its level.
fx, fy = 0.01, -Y / 2 + 0.022
edge = cy - RIM_Y / 2
body.add(box((0.03, edge - fy + 0.006, 0.002)), at=(fx, fy, H), by="right.top", name="bridge")
body.add(cylinder(0.021, 0.008), at=(fx, fy, H - 0.002), by="bottom", name="ring")
body.add(cylinder(0.0185, 0.076), at=(fx, fy, H), by="bottom", name="foot")
cz = H + 0.055
body.add(
    cylinder(0.020, 0.045),
    at=(fx + 0.025, fy, cz),
    rpy=(0, math.pi / 2, 0),
    by="front",
    name="cross",
)

spout = sink.part("spout", material=steel, mass=0.7)
r = 0.0150
top, low = Z - r + 0.0003, H + 0.0765
path = [
    (fx, fy, low),
    (fx, fy, top - 0.057),
    (fx, fy + 0.009, top - 0.026),
    (fx, fy + 0.034, top - 0.006),
    (fx, fy + 0.060, top),
    (fx, fy + 0.212, top),
]
pipe = spout.add(sweep(path, radius=r), name="pipe")
spout.add(cylinder(0.008, 0.012), at=(fx, fy + 0.198, top - r + 0.003), by="top", name="nozzle")
sink.revolute("swivel", body, spout, at=(fx, fy, low + 0.02), axis=(0, 0, 1), range=(-1.57, 1.57))

handle = sink.part("handle", material=steel)
knob = handle.add(
    cylinder(0.022, 0.036),
    at=(fx + 0.025 - 0.045 - 0.0007, fy, cz),
    rpy=(0, math.pi / 2, 0),
    by="front",
    name="knob",
)
sink.revolute("turn", body, handle, at=knob.anchor("centre"), axis=(1, 0, 0), range=(0, 1.57))
