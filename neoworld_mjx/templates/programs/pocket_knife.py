# Label: pocket knife
# PartNet-Mobility: Knife
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, torus

depth = 0.095  # 0.08 to 0.12 m
width = 0.026  # 0.023 to 0.034 m
height = 0.019  # 0.016 to 0.024 m
blades = 3  # 1 to 4
ends = "round"  # one of round, square
ring = "yes"  # one of yes, no
colour = "red"  # one of red, black, wood, green

knife = Object("pocket_knife", label="pocket knife")
tones = {
    "red": (0.72, 0.08, 0.1),
    "black": (0.12, 0.12, 0.13),
    "wood": (0.42, 0.27, 0.15),
    "green": (0.2, 0.35, 0.22),
}
knife.material("scale", like="oak" if colour == "wood" else "nylon", rgb=tones[colour])
LOOP = 0.01 if ring == "yes" else 0.0
long = depth - LOOP
middle = LOOP / 2  # of the handle along x
half = width / 2


def handle(inset):
    """Return the outline of the handle, smaller by so much."""
    a, b = long / 2 - inset, half - inset
    if ends == "square":
        return [
            (middle + x, y)
            for x, y in (
                (a, b - 0.003),
                (a - 0.003, b),
                (-a + 0.003, b),
                (-a, b - 0.003),
                (-a, -b),
                (a, -b),
            )
        ]
    turn = [math.pi * k / 8 for k in range(-4, 5)]
    right = [(middle + a - b + b * math.cos(t), b * math.sin(t)) for t in turn]
    return right + [(2 * middle - x, y) for x, y in reversed(right)]


body = knife.part("handle", material="scale")
scale = 0.2 * height
for z, by in ((0, "bottom"), (height, "top")):
    body.add(extrusion(handle(0), scale), at=(middle, 0, z), by=by)
# The spine along -y keeps the two sides apart; the blades lie before it.
slot = (height - 2 * scale) / blades
body.add(
    box((long - width, 0.004, height - 2 * scale + 0.001)),
    at=(middle, -half + 0.0015, height / 2),
    by="right",
    material="steel",
)
for arm in (box((0.012, 0.004, 0.0004)), box((0.004, 0.012, 0.0004))):
    body.add(
        arm, at=(middle + 0.2 * long, 0, height), by="centre", rgb=(0.92, 0.92, 0.92), role="visual"
    )
for k in range(blades):
    blade = knife.part(f"blade_{k + 1}", material="stainless_steel")
    sign = 1 if k % 2 == 0 else -1
    pivot = (middle + sign * (long / 2 - half), 0.1 * half)
    reach = (long - 1.3 * width) * (1 - 0.08 * k)
    boss = 0.55 * half
    # From its round root the blade points to the other end, its edge inside the handle.
    root = [
        (boss * math.cos(t), boss * math.sin(t))
        for t in [math.pi * (0.5 - q / 6) for q in range(7)]
    ]
    tip = [
        (-0.75 * reach, -0.9 * boss),
        (-reach, 0.15 * boss),
        (-0.9 * reach, 0.75 * boss),
        (-0.6 * reach, boss),
    ]
    outline = [(pivot[0] + sign * x, pivot[1] + y) for x, y in root + tip]
    z = scale + (k + 0.5) * slot
    thick = min(0.0022, slot - 0.0008)
    blade.add(extrusion(outline, thick), at=(0, 0, z))
    # A nick for the thumb nail.
    nick = box((0.2 * reach, 0.0012, 0.0003))
    blade.add(
        nick,
        at=(pivot[0] - 0.6 * sign * reach, pivot[1] + 0.6 * boss, z + thick / 2),
        rgb=(0.2, 0.2, 0.2),
        role="visual",
    )
    body.add(
        cylinder(0.0015, height - scale),
        at=(pivot[0], pivot[1], height / 2),
        rgb=(0.7, 0.7, 0.7),
        role="visual",
    )
    gap = slot - thick
    if gap > 0.003:
        # Liners fill the air between a thin blade and its neighbours.
        for s in (-1, 1):
            body.add(
                extrusion(handle(0.0006), (gap - 0.001) / 2),
                at=(0, 0, z + s * (thick / 2 + 0.0005 + (gap - 0.001) / 4)),
                material="steel",
            )
    knife.revolute(
        f"open_{k + 1}",
        body,
        blade,
        at=(pivot[0], pivot[1], z),
        axis=(0, 0, -sign),
        range=(0, 3.0),
        friction=0.02,
    )
if ring == "yes":
    x, y = middle - long / 2, -half + 0.0045
    lug = box((0.01, 0.004, height - scale))
    body.add(lug, at=(x - 0.003, y, height / 2), by="back", material="steel")
    loop = knife.part("ring", material="steel")
    loop.add(
        torus((LOOP - 0.0045) / 2, 0.0008),
        at=(-depth / 2 + (LOOP - 0.0045) / 2 + 0.0008, y, height / 2),
    )
    loop.add(box((0.0035, 0.002, 0.002)), at=(x - 0.0036, y, height / 2), by="front")
    knife.revolute(
        "ring_turn",
        body,
        loop,
        at=(x - 0.003, y, height / 2),
        axis=(0, 1, 0),
        range=(-0.9, 0.9),
        friction=0.001,
    )
