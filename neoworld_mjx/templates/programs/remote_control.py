# Label: remote control
# PartNet-Mobility: Remote
from neoworld_mjx.program.sdk import Object, box, cylinder, grid, rounded_box

depth = 0.18  # 0.14 to 0.22 m
width = 0.048  # 0.04 to 0.06 m
height = 0.022  # 0.018 to 0.026 m
rows = 4  # 3 to 5
pad = "ring"  # one of ring, cross, none
keys = "square"  # one of square, round
colour = "black"  # one of black, white, grey

KEY = 0.0025
remote = Object("remote_control", label="remote control")
shade = {"black": (0.12, 0.12, 0.13), "white": (0.92, 0.92, 0.92), "grey": (0.45, 0.46, 0.48)}[
    colour
]
bright = (0.25, 0.25, 0.27) if colour == "white" else (0.72, 0.73, 0.75)
remote.material("case", like="abs", rgb=shade)
remote.material("key", like="silicone", rgb=bright)
body = remote.part("body", material="case", mass=0.1)
deck = height - KEY - 0.0012
body.add(rounded_box((depth, width, deck), 0.004), by="bottom")
lens = box((0.001, 0.5 * width, 0.4 * deck))
body.add(
    lens, at=(-depth / 2 + 0.0005, 0, deck / 2), by="front", rgb=(0.3, 0.02, 0.05), role="visual"
)


def key(name, at, size, rgb=bright, round_=False):
    """Add a key on the deck."""
    part = remote.part(name, material="key")
    cap = cylinder(min(size) / 2, KEY) if round_ else box((*size, KEY))
    part.add(cap, at=(*at, deck + 0.0012), by="bottom", rgb=rgb)
    remote.prismatic(f"press_{name}", body, part, axis="down", range=(0, 0.0011), friction=0.1)


# It points away from whoever holds it: the far end is at the back.
unit, rear = depth / 12, -depth / 2
key("power", (rear + 0.9 * unit, 0.28 * width), (0.7 * unit, 0.7 * unit), (0.8, 0.1, 0.1), True)
key("source", (rear + 0.9 * unit, -0.28 * width), (0.7 * unit, 0.7 * unit), round_=True)
pitch = (4.3 * unit / rows, 0.29 * width)
for k, (dx, dy, _) in enumerate(grid((rows, 3), pitch)):
    size = (min(0.7 * pitch[0], 0.012), 0.75 * pitch[1])
    key(f"key_{k + 1}", (rear + 4.0 * unit + dx, dy), size, round_=keys == "round")
middle = rear + 8.0 * unit
if pad != "none":
    reach = 0.3 * width
    key("ok", (middle, 0), (0.28 * width, 0.28 * width), round_=pad == "ring")
    for name, dx, dy in (("up", -1, 0), ("down", 1, 0), ("left", 0, 1), ("right", 0, -1)):
        size = (0.2 * width, 0.26 * width) if dx else (0.26 * width, 0.2 * width)
        key(name, (middle + dx * reach, dy * reach), size, round_=pad == "ring")
for name, y in (("volume", 0.25 * width), ("channel", -0.25 * width)):
    # Rockers: they tip to both sides about their middle.
    part = remote.part(name, material="key")
    at = (rear + 10.4 * unit, y, deck + 0.0012)
    part.add(box((1.4 * unit, 0.24 * width, KEY)), at=at, by="bottom")
    remote.revolute(
        f"tip_{name}", body, part, at=at, axis="left", range=(-0.06, 0.06), friction=0.005
    )
cover = remote.part("battery_cover", material="case")
cover.add(
    box((0.3 * depth, 0.7 * width, 0.0012)),
    at=(depth / 2 - 0.02, 0, 0.0),
    by="front.top",
    rgb=(0.35, 0.36, 0.38),
)
remote.prismatic("cover_slide", body, cover, axis="front", range=(0, 0.06))
