# Label: computer mouse
# PartNet-Mobility: Mouse
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, difference, ellipsoid, intersection

depth = 0.115  # 0.095 to 0.13 m
width = 0.064  # 0.055 to 0.075 m
height = 0.038  # 0.032 to 0.045 m
side_buttons = 2  # 0 to 2
shape = "round"  # one of round, slim
colour = "black"  # one of black, white, red, blue

FOOT, GAP = 0.001, 0.0012
mouse = Object("computer_mouse", label="computer mouse")
shade = {
    "black": (0.14, 0.14, 0.15),
    "white": (0.93, 0.93, 0.93),
    "red": (0.65, 0.1, 0.12),
    "blue": (0.15, 0.3, 0.6),
}
mouse.material("shell", like="abs", rgb=shade[colour])
body = mouse.part("body", material="shell", mass=0.09)
tall = height - FOOT
# An egg cut off at its middle; round mice are cut off lower, where the egg is wider.
cut = 0.12 if shape == "round" else 0.0


def grown(by):
    """Return the egg with all radii larger by so much."""
    radii = (depth / 2 + by, width / 2 + by, tall / (1 + cut) + by)
    return ellipsoid(radii).moved((0, 0, FOOT + cut * tall / (1 + cut)))


def piece(low, high):
    """Return the part of the egg within a box, given by two corners."""
    size = tuple(high[i] - low[i] for i in range(3))
    middle = tuple((low[i] + high[i]) / 2 for i in range(3))
    return intersection(grown(0), box(size).moved(middle))


split, seam, far = 0.08 * depth, FOOT + 0.5 * tall, 1.0
slot = 0.005
body.add(piece((-far, -far, FOOT), (split, far, far)), name="palm")
body.add(piece((split - 0.001, -far, FOOT), (far, far, seam)), name="nose")
for at in ((0.3 * depth, 0), (-0.3 * depth, 0)):
    body.add(box((0.012, 0.4 * width, FOOT + 0.002)), at=(*at, 0), by="bottom", rgb=(0.3, 0.3, 0.3))
for name, sign in (("left", 1), ("right", -1)):
    button = mouse.part(f"{name}_button", material="shell")
    low = (split + GAP, slot if sign > 0 else -far, seam + GAP)
    button.add(piece(low, (far, far if sign > 0 else -slot, far)), rgb=shade[colour])
    line = (split + GAP, sign * 0.2 * width, seam + GAP)
    mouse.revolute(
        f"{name}_click", body, button, at=line, axis=(0, 1, 0), range=(0, 0.03), friction=0.01
    )
wheel = mouse.part("wheel", material="rubber")
hub = (0.28 * depth, 0, seam + 0.0088)
wheel.add(cylinder(0.008, 0.006), at=hub, rpy=(math.pi / 2, 0, 0), rgb=(0.35, 0.36, 0.38))
mouse.continuous("scroll", body, wheel, at=hub, axis="left")
for k in range(side_buttons):
    button = mouse.part(f"side_{k + 1}", material="abs")
    at = (-0.02 * depth - 0.19 * depth * k, 0, FOOT + 0.62 * tall)
    room = box((0.16 * depth, width, 0.005)).moved((at[0], width / 2, at[2]))
    cap = difference(intersection(grown(0.0022), room), grown(0.0006))
    button.add(cap, rgb=(0.4, 0.4, 0.42))
    mouse.prismatic(
        f"side_press_{k + 1}", body, button, axis="right", range=(0, 0.0008), friction=0.05
    )
