# Label: flip phone
# PartNet-Mobility: Phone
from neoworld_mjx.program.sdk import Object, box, capsule, cylinder, grid, rounded_box

depth = 0.1  # 0.09 to 0.115 m
width = 0.05  # 0.045 to 0.06 m
height = 0.025  # 0.021 to 0.03 m
antenna = "yes"  # one of yes, no
window = "round"  # one of round, square
keys = "square"  # one of square, round
colour = "silver"  # one of silver, red, black, pink

phone = Object("flip_phone", label="flip phone")
shade = {
    "silver": (0.72, 0.73, 0.76),
    "red": (0.68, 0.08, 0.12),
    "black": (0.12, 0.12, 0.13),
    "pink": (0.9, 0.55, 0.66),
}
phone.material("case", like="electronics", rgb=shade[colour])
STUB = 0.012 if antenna == "yes" else 0.0
long, half, KEY = depth - STUB, 0.5 * height, 0.0025
front = depth / 2
back = front - long
body = phone.part("body", material="case")
deck = half - 0.001 - KEY - 0.0012
body.add(rounded_box((long, width, deck), 0.003), at=(front, 0, 0), by="front.bottom")
# The hinge's knuckles stand up at the rear, the lid's own between them.
line = (back + 0.004, 0, half)
for y in (-0.38 * width, 0.38 * width):
    body.add(
        box((0.008, 0.22 * width, half - deck + 0.004)),
        at=(back, y, deck - 0.002),
        by="back.bottom",
    )
lid = phone.part("lid", material="case")
lid.add(
    rounded_box((long - 0.009, width, height - half - 0.0006), 0.003),
    at=(front, 0, height),
    by="front.top",
)
arm = box((0.0085, 0.48 * width, height - half - 0.0006))
lid.add(arm, at=(line[0], 0, height), by="back.top")
lid.add(cylinder(0.0034, 0.48 * width), at=line, rpy=(1.5708, 0, 0))
lid.add(
    box((0.6 * long, 0.8 * width, 0.0006)),
    at=(front - 0.1 * long, 0, half + 0.0006),
    by="front.bottom",
    rgb=(0.1, 0.2, 0.35),
    role="visual",
)
face = (front - 0.35 * long, 0, height - 0.0004)
glass = (
    cylinder(0.28 * width, 0.0006) if window == "round" else box((0.25 * long, 0.6 * width, 0.0006))
)
lid.add(glass, at=face, by="bottom", rgb=(0.05, 0.07, 0.12), role="visual")
lens = cylinder(0.004, 0.0008)
lid.add(
    lens,
    at=(back + 0.2 * long, 0, height - 0.0004),
    by="bottom",
    rgb=(0.05, 0.05, 0.06),
    role="visual",
)
phone.revolute(
    "flip", body, lid, at=line, axis=(0, -1, 0), range=(0, 2.4), opens="up", friction=0.03
)


def key(name, at, size, rgb=(0.85, 0.86, 0.88)):
    """Add a key on the deck."""
    part = phone.part(name, material="silicone")
    cap = cylinder(min(size) / 2, KEY) if keys == "round" else box((*size, KEY))
    part.add(cap, at=(*at, deck + 0.0012), by="bottom", rgb=rgb)
    phone.prismatic(f"press_{name}", body, part, axis="down", range=(0, 0.0011), friction=0.05)


pitch = (0.125 * long, 0.29 * width)
for k, (dx, dy, _) in enumerate(grid((4, 3), pitch)):
    key(f"key_{k + 1}", (front - 0.3 * long + dx, dy), (0.75 * pitch[0], 0.8 * pitch[1]))
row = front - 0.66 * long
key("call", (row, 0.29 * width), (0.1 * long, 0.22 * width), (0.1, 0.6, 0.2))
key("end", (row, -0.29 * width), (0.1 * long, 0.22 * width), (0.75, 0.1, 0.1))
key("select", (row, 0), (0.14 * long, 0.24 * width), (0.5, 0.52, 0.55))
if antenna == "yes":
    rod = phone.part("antenna", material="nylon")
    at = (back - 0.0008, 0.38 * width, 0.5 * deck)
    rod.add(
        capsule(0.0025, STUB - 0.0058), at=at, rpy=(0, 1.5708, 0), by="front", rgb=(0.1, 0.1, 0.1)
    )
    phone.prismatic("antenna_pull", body, rod, axis="back", range=(0, 0.05))
