# Label: stapler
# PartNet-Mobility: Stapler
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    extrusion,
    hollow_box,
    mirror,
    rounded_box,
)

depth = 0.15  # 0.12 to 0.19 m
width = 0.038  # 0.034 to 0.048 m
height = 0.06  # 0.052 to 0.07 m
head = "round"  # one of round, wedge
foot = "pads"  # one of pads, plate
colour = "black"  # one of black, red, blue, grey

across = (math.pi / 2, 0, 0)
stapler = Object("stapler", label="stapler")
tones = {
    "black": (0.13, 0.13, 0.14),
    "red": (0.72, 0.1, 0.1),
    "blue": (0.15, 0.3, 0.6),
    "grey": (0.55, 0.56, 0.58),
}
stapler.material("cover", like="abs", rgb=tones[colour])
stapler.material("metal", like="aluminium", rgb=(0.75, 0.76, 0.78))
front, rear = depth / 2, -depth / 2
PAD = 0.003 if foot == "pads" else 0.0
base = stapler.part("base", material="metal", mass=0.18)
plate = 0.2 * height
base.add(
    rounded_box((depth, width, plate - PAD), 0.003), at=(0, 0, PAD), by="bottom", material="cover"
)
if foot == "pads":
    for x in (-0.36 * depth, 0.36 * depth):
        base.add(
            box((0.14 * depth, 0.8 * width, PAD + 0.001)),
            at=(x, 0, 0),
            by="bottom",
            material="rubber",
        )
# The cheeks at the rear carry the pin of magazine and cover.
pivot = (rear + 0.014, 0, 0.52 * height)
for side in mirror((pivot[0], width / 2 - 0.001, plate - 0.001)):
    cheek = box((0.024, 0.0025, pivot[2] - plate + 0.009))
    base.add(cheek, at=side, by="left.bottom" if side[1] > 0 else "right.bottom")
wide = width - 0.0085
magazine = stapler.part("magazine", material="metal")
low, tall = 0.42 * height, 0.22 * height
start = rear + 0.006
length = front - 0.006 - start
channel = hollow_box((length, wide, tall), 0.0012, open="+z")
magazine.add(channel, at=(start, 0, low), by="back.bottom")
down = (low - plate - 0.0032) / (front - 0.006 - pivot[0])  # until it meets the anvil
stapler.revolute("press", base, magazine, at=pivot, axis=(0, 1, 0), range=(0, down), friction=0.25)
strip = box((0.4 * length, 0.6 * wide, 0.6 * tall))
magazine.add(strip, at=(front - 0.008, 0, low + 0.001), by="front.bottom", material="steel")
pusher = stapler.part("pusher", material="cover")
pusher.add(
    box((0.012, wide - 0.0038, 0.7 * tall)),
    at=(front - 0.009 - 0.4 * length, 0, low + 0.0018),
    by="front.bottom",
    rgb=(0.3, 0.3, 0.32),
)
stapler.prismatic("push", magazine, pusher, axis="back", range=(0, 0.4 * length), friction=0.3)
cover = stapler.part("cover", material="cover")
top = low + tall + 0.0008
rise = height - top
if head == "round":
    side = [
        (start, 0),
        (front, 0),
        (front, 0.5 * rise),
        (front - 0.015, 0.85 * rise),
        (front - 0.04, rise),
        (start + 0.02, 0.9 * rise),
        (start, 0.5 * rise),
    ]
else:
    side = [
        (start, 0),
        (front, 0),
        (front, 0.45 * rise),
        (front - 0.02, 0.6 * rise),
        (start + 0.03, rise),
        (start, 0.8 * rise),
    ]
cover.add(extrusion(side, wide + 0.003), at=(0, 0, top), rpy=across)
hinge = (start, 0, top)
stapler.revolute(
    "load", magazine, cover, at=hinge, axis=(0, -1, 0), range=(0, 1.8), opens="up", friction=0.1
)
# The anvil turns for staples that bend outwards.
anvil = stapler.part("anvil", material="metal")
disc = anvil.add(cylinder(0.3 * width, 0.002), at=(front - 0.016, 0, plate + 0.0006), by="bottom")
for x in (-0.003, 0.003):
    groove = box((0.0015, 0.3 * width, 0.0004))
    anvil.add(groove, at=(front - 0.016 + x, 0, plate + 0.0026), rgb=(0.2, 0.2, 0.2), role="visual")
stapler.continuous("anvil_turn", base, anvil, at=disc.anchor("centre"), axis="up")
