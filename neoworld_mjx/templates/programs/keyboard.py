# Label: compact keyboard
# PartNet-Mobility: Keyboard
from neoworld_mjx.program.sdk import Object, box, cylinder, mirror

depth = 0.115  # 0.1 to 0.13 m
width = 0.22  # 0.19 to 0.26 m
height = 0.028  # 0.024 to 0.034 m
columns = 8  # 7 to 9
dial = "yes"  # one of yes, no
colour = "black"  # one of black, white, grey, cream

FOOT, KEY = 0.003, 0.007
keyboard = Object("keyboard", label="compact keyboard")
tones = {
    "black": ((0.12, 0.12, 0.13), (0.24, 0.24, 0.26)),
    "white": ((0.8, 0.81, 0.83), (0.96, 0.96, 0.96)),
    "grey": ((0.3, 0.31, 0.33), (0.8, 0.45, 0.2)),
    "cream": ((0.75, 0.7, 0.6), (0.93, 0.9, 0.82)),
}[colour]
keyboard.material("case", like="abs", rgb=tones[0])
keyboard.material("caps", like="abs", rgb=tones[1])
body = keyboard.part("body", material="case", mass=0.5)
deck = height - KEY - 0.0018
body.add(box((depth, width, deck - FOOT)), at=(0, 0, FOOT), by="bottom")
for rim in mirror((depth / 2 - 0.002, 0, deck - 0.001), "x"):
    body.add(box((0.004, width - 0.01, 0.005)), at=rim, by="bottom")
for foot in mirror((depth / 2 - 0.012, 0.4 * width, 0)):
    body.add(cylinder(0.006, FOOT + 0.001), at=foot, by="bottom", material="rubber")
    rear = (-foot[0], foot[1], 0)
    body.add(cylinder(0.006, FOOT + 0.001), at=rear, by="bottom", material="rubber")
# Two stands fold down from the bottom behind the rear feet.
for k, at in enumerate(mirror((-depth / 2 + 0.022, 0.3 * width, FOOT - 0.0008))):
    stand = keyboard.part(f"stand_{k + 1}", material="abs")
    leaf = stand.add(box((0.02, 0.03, 0.0018)), at=at, by="back.top", rgb=(0.5, 0.5, 0.52))
    edge = leaf.anchor("back.top")
    keyboard.revolute(
        f"stand_fold_{k + 1}", body, stand, at=edge, axis=(0, 1, 0), range=(0, 0.05), friction=0.06
    )

top = 0.022 if dial == "yes" else 0.0
pitch_x, pitch_y = (depth - 0.018 - top) / 4, (width - 0.016) / columns
front = depth / 2 - 0.009


def key(name, x, y, wide):
    """Add a key whose middle is at (x, y)."""
    part = keyboard.part(name, material="caps")
    cap = (pitch_x - 0.0025, wide - 0.0025)
    part.add(box((*cap, KEY)), at=(x, y, deck + 0.0018), by="bottom")
    keyboard.prismatic(f"press_{name}", body, part, axis="down", range=(0, 0.0018), friction=0.3)


for r in range(2):
    for c in range(columns):
        y = width / 2 - 0.008 - (c + 0.5) * pitch_y
        key(f"key_{r + 1}_{c + 1}", front - (r + 1.5) * pitch_x, y, pitch_y)
# The last row is of flat keys that feel the finger.
for c in range(columns):
    pad = box((pitch_x - 0.005, pitch_y - 0.004, 0.002))
    at = (front - 3.5 * pitch_x, width / 2 - 0.008 - (c + 0.5) * pitch_y, deck)
    body.add(pad, at=at, rgb=tones[1], role="visual")
# The first row holds the long bar between keys of one and a half widths.
x = front - 0.5 * pitch_x
side = 0.5 * (width - 0.016) - 0.75 * pitch_y
for name, y in (("control", side), ("enter", -side)):
    key(name, x, y, 1.5 * pitch_y)
key("space", x, 0, (columns - 5.5) * pitch_y)
for name, y in (("alt", side - 1.5 * pitch_y + 0.125 * pitch_y), ("menu", -side + 1.375 * pitch_y)):
    key(name, x, y, 1.25 * pitch_y)
if dial == "yes":
    knob = keyboard.part("volume", material="aluminium")
    at = (-depth / 2 + 0.5 * (top + 0.01), -width / 2 + 0.03, deck + 0.0008)
    knob.add(cylinder(0.009, height - at[2]), at=at, by="bottom")
    keyboard.continuous("volume_turn", body, knob, at=at, axis="up")
