# Label: toilet
# PartNet-Mobility: Toilet
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    extrusion,
    hollow_box,
    lathe,
)

depth = 0.68  # 0.6 to 0.75 m
width = 0.38  # 0.34 to 0.45 m
height = 0.78  # 0.7 to 0.88 m
flush = "buttons"  # one of buttons, lever, pull
seat = "oval"  # one of oval, square
colour = "white"  # one of white, black, wood

RIM, TANK = 0.4, 0.17
toilet = Object("toilet", label="toilet")
toilet.material(
    "lid_colour",
    like="polypropylene",
    rgb={"white": (0.95, 0.95, 0.94), "black": (0.12, 0.12, 0.12), "wood": (0.55, 0.36, 0.2)}[
        colour
    ],
)
body = toilet.part("body", material="porcelain")
back = -depth / 2
long, wide = depth - TANK, 0.94 * min(width, 0.4)
centre = back + TANK + long / 2
# The bowl is an oval shell on a foot; its rim carries the seat.
r, oval = long / 2, wide / long
bowl = [(0, 0.14), (0.45 * r, 0.15), (0.75 * r, 0.25), (r, RIM - 0.03), (r, RIM)]
body.add(
    lathe([(q, z - 0.14) for q, z in bowl], thickness=0.02, sectors=16, oval=oval),
    at=(centre, 0, 0.14),
    name="bowl",
)
foot = lathe([(0, 0), (0.62 * r, 0), (0.5 * r, 0.1), (0.5 * r, 0.18)], thickness=0.02, oval=oval)
body.add(foot, at=(centre - 0.08, 0, 0), name="foot")
body.add(
    hollow_box((0.3, 0.5 * wide, RIM - 0.1), 0.02, open=[]),
    at=(back + 0.05, 0, 0),
    by="back.bottom",
    name="trap",
)
body.add(
    box((TANK + 0.06, 0.7 * wide, 0.05)), at=(back, 0, RIM - 0.06), by="back.bottom", name="deck"
)
tall = height - RIM - 0.03
cistern = hollow_box((TANK, width, tall), 0.012)
body.add(cistern, at=(back, 0, RIM - 0.012), by="back.bottom", name="cistern")


def outline(inset):
    """Return the seat's outline, an oval or a square with round corners, inset by so much."""
    a, b, n = 0.98 * r - inset, wide / 2 - inset, 2.0 if seat == "oval" else 3.6
    points = []
    for k in range(28):
        c, s = math.cos(2 * math.pi * k / 28), math.sin(2 * math.pi * k / 28)
        points.append(
            (math.copysign(a * abs(c) ** (2 / n), c), math.copysign(b * abs(s) ** (2 / n), s))
        )
    return points


# Seat and lid turn about one line, between them, on pins before the cistern.
line, level = back + TANK + 0.016, RIM + 0.001
ring = toilet.part("seat", material="lid_colour")
ring.add(extrusion(outline(0), 0.018, [outline(0.065)]), at=(centre + 0.01, 0, level), by="bottom")
lid = toilet.part("lid", material="lid_colour")
lid.add(extrusion(outline(0.002), 0.014), at=(centre + 0.01, 0, level + 0.019), by="bottom")
for part, z, thick in ((ring, level, 0.018), (lid, level + 0.019, 0.014)):
    part.add(box((0.06, 0.12, thick)), at=(line, 0, z), by="back.bottom")
at = (line, 0, level + 0.0185)
for y in (-0.045, 0.045):
    pin = cylinder(0.0065, level + 0.0186 - RIM + 0.02)
    body.add(pin, at=(line - 0.0078, y, RIM - 0.02), by="bottom", material="steel")
toilet.revolute(
    "lid_hinge", body, lid, at=at, axis=(0, -1, 0), range=(0, 1.5), opens="up", friction=0.3
)
toilet.revolute(
    "seat_hinge",
    body,
    ring,
    at=at,
    axis=(0, -1, 0),
    range=(0, 1.42),
    opens="up",
    after=lid,
    friction=0.3,
)

cover = toilet.part("tank_lid", material="porcelain")
top = RIM - 0.012 + tall
thick = height - top - 0.0005 - (0.008 if flush == "buttons" else 0.022 if flush == "pull" else 0)
slab = cover.add(box((TANK, width, thick)), at=(back, 0, top + 0.0005), by="back.bottom")
toilet.prismatic("tank_lid_lift", body, cover, axis="up", range=(0, 0.2), damping=150)
if flush == "buttons":
    for k, (size, y) in enumerate(((0.024, -0.02), (0.015, 0.024))):
        button = toilet.part(f"flush_{k + 1}", material="steel")
        button.add(cylinder(size, 0.0065), at=(back + TANK / 2, y, height), by="top")
        toilet.prismatic(
            f"flush_press_{k + 1}", cover, button, axis="down", range=(0, 0.0018), friction=1.0
        )
elif flush == "pull":
    knob = toilet.part("flush", material="steel")
    knob.add(cylinder(0.016, 0.021), at=(back + TANK / 2, 0, height), by="top")
    toilet.prismatic("flush_pull", cover, knob, axis="up", range=(0, 0.02))
else:
    lever = toilet.part("flush", material="steel")
    spot = (back + TANK + 0.001, -0.36 * width, top - 0.06)
    hub = lever.add(cylinder(0.014, 0.02), at=spot, rpy=(0, math.pi / 2, 0), by="back")
    lever.add(box((0.01, 0.09, 0.014)), at=(spot[0] + 0.014, spot[1] - 0.008, spot[2]), by="right")
    toilet.revolute(
        "flush_tip",
        body,
        lever,
        at=hub.anchor("centre"),
        axis=(-1, 0, 0),
        range=(0, 0.5),
        friction=0.1,
    )
