# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, sweep

# Sink with a tap, given box 0.53 x 0.50 x 0.60 m: the tap stands behind the basin (-x), its spout
# points to the front over it.
X, Y, DEEP, Z = 0.44, 0.50, 0.205, 0.60  # of the basin with its rim; the whole height
RIM, WALL = 0.018, 0.003
TAP = -X / 2 - 0.06


def rounded(x, y, r):
    points = []
    for k in range(12):
        a = math.pi / 6 * (k + 0.5)
        sx = 1 if math.cos(a) > 0 else -1
        sy = 1 if math.sin(a) > 0 else -1
        points.append((sx * (x / 2 - r) + r * math.cos(a), sy * (y / 2 - r) + r * math.sin(a)))
    return points


sink = Object("sink", label="steel sink with a tap")
sink.material("brushed", like="stainless_steel", rgb=(0.74, 0.74, 0.74))
# A tap is hollow brass: two thirds of its volume are water and air.
sink.material("chrome", like="stainless_steel", density=2600, rgb=(0.78, 0.78, 0.78))
basin = sink.part("basin", material="brushed")
x, y = X - 2 * RIM, Y - 2 * RIM
outer, inner = rounded(x, y, 0.035), rounded(x - 2 * WALL, y - 2 * WALL, 0.032)
basin.add(extrusion(outer, WALL), at=(0, 0, 0), by="bottom", name="floor")
basin.add(extrusion(outer, DEEP, holes=[inner]), at=(0, 0, 0), by="bottom", name="walls")
basin.add(
    extrusion(rounded(X, Y, 0.02), 0.004, holes=[inner]), at=(0, 0, DEEP), by="top", name="rim"
)
basin.add(cylinder(0.045, 0.004), at=(0, 0, WALL), by="bottom", role="visual", rgb=(0.5, 0.5, 0.5))
# The tap stands on the worktop; a tongue of sheet holds it where that is missing.
basin.add(box((0.10, 0.06, 0.004)), at=(-X / 2 + 0.01, 0, DEEP), by="top.front", name="tongue")
basin.add(cylinder(0.025, 0.012), at=(TAP, 0, DEEP), by="bottom", material="chrome", name="foot")
neck = basin.add(
    cylinder(0.02, 0.13), at=(TAP, 0, DEEP), by="bottom", material="chrome", name="neck"
)
across = (math.pi / 2, 0, 0)
basin.add(
    cylinder(0.022, 0.085),
    at=(TAP, -0.005, DEEP + 0.09),
    rpy=across,
    material="chrome",
    name="crosspiece",
)

handle = sink.part("handle", material="chrome")
knob = handle.add(
    cylinder(0.026, 0.018), at=(TAP, 0.0382, DEEP + 0.09), rpy=across, by="right", name="knob"
)
handle.add(cylinder(0.004, 0.05), at=(TAP, 0.047, DEEP + 0.11), by="bottom", name="stick")
sink.revolute("mix", basin, handle, at=knob.anchor("centre"), axis=(0, -1, 0), range=(-0.8, 0.8))

spout = sink.part("spout", material="chrome")
top = Z - 0.02
foot = DEEP + 0.1305
path = [
    (TAP, 0, foot),
    (TAP, 0, top - 0.07),
    (TAP + 0.02, 0, top - 0.02),
    (TAP + 0.07, 0, top),
    (TAP + 0.28, 0, top),
]
spout.add(sweep(path, radius=0.0195, smooth=2), name="arm")
spout.add(cylinder(0.012, 0.015), at=(TAP + 0.26, 0, top - 0.017), by="top", name="outlet")
sink.revolute("swivel", basin, spout, at=(TAP, 0, foot), axis=(0, 0, 1), range=(-1.57, 1.57))
