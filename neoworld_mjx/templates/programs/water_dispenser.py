# Label: water dispenser
# PartNet-Mobility: Dispenser
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, lathe, mirror, panel

depth = 0.34  # 0.3 to 0.4 m
width = 0.32  # 0.28 to 0.4 m
height = 1.3  # 1.15 to 1.45 m
taps = 2  # 1 to 3
supply = "bottle"  # one of bottle, lid
lever = "paddle"  # one of paddle, button
colour = "white"  # one of white, silver, black

FOOT, WALL, FRONT, BASE = 0.02, 0.02, 0.016, 0.03
cooler = Object("water_dispenser", label="water dispenser")
shade = {"white": (0.93, 0.94, 0.94), "silver": (0.68, 0.7, 0.72), "black": (0.13, 0.13, 0.14)}[
    colour
]
cooler.material("casing", like="insulated", rgb=shade)
cooler.material("bottle", like="pet", rgb=(0.45, 0.68, 0.9), alpha=0.55)
body = cooler.part("body", material="casing", mass=14.0)
deep = depth - FRONT - 0.01
x = deep / 2
top = height * (0.72 if supply == "bottle" else 0.985)
for foot in mirror(mirror((0.38 * deep, 0.38 * width, 0)), "x"):
    body.add(cylinder(0.02, FOOT), at=foot, by="bottom", material="rubber")
# A cupboard below, an alcove with the taps, a closed head above.
low, high = FOOT + 0.55 * (top - FOOT), FOOT + 0.82 * (top - FOOT)
body.add(
    hollow_box((deep, width, low - FOOT), WALL, open="+x"),
    at=(0, 0, FOOT),
    by="bottom",
    name="cupboard",
)
body.add(
    hollow_box((deep, width, high - low), WALL, open="+x"),
    at=(0, 0, low),
    by="bottom",
    name="alcove",
)
body.add(
    hollow_box((deep, width, top - high), WALL, open=[]), at=(0, 0, high), by="bottom", name="head"
)
lining = box((0.5 * deep, width - 2 * WALL + 0.002, high - low - 2 * WALL + 0.002))
body.add(lining, at=(-x + WALL - 0.001, 0, (low + high) / 2), by="back", rgb=(0.25, 0.27, 0.3))
wall = -x + WALL - 0.001 + 0.5 * deep
door = cooler.door(
    "door", body, x=x, y=(-width / 2, width / 2), z=(FOOT, low), hinge="left", thickness=FRONT
)
pull = (x + FRONT + 0.0005, -width / 2 + 0.03, low - 0.12)
door.add(box((0.0095, 0.014, 0.12)), at=pull, by="back", rgb=(0.5, 0.5, 0.52))
cooler.shelf(
    body,
    x=(-x + WALL, x - 0.03),
    y=(-width / 2 + WALL, width / 2 - WALL),
    z=FOOT + 0.45 * (low - FOOT),
    thickness=0.008,
)

tray = cooler.part("drip_tray", material="abs")
bowl = hollow_box((0.42 * deep, width - 2 * WALL - 0.02, 0.03), 0.002)
tray.add(bowl, at=(x, 0, low + WALL + 0.0005), by="front.bottom", rgb=(0.2, 0.2, 0.22))
slits = [((k - 2) * 0.07 * deep, 0, 0.012, 0.7 * (width - 2 * WALL)) for k in range(5)]
grille = panel((0.42 * deep, width - 2 * WALL - 0.02), 0.003, slits)
tray.add(grille, at=(x, 0, low + WALL + 0.03), by="front.bottom", material="steel")
cooler.prismatic("tray_slide", body, tray, axis="front", range=(0, 0.3 * deep))

colours = ((0.15, 0.35, 0.8), (0.8, 0.12, 0.1), (0.85, 0.85, 0.85))
for k in range(taps):
    y = (k - (taps - 1) / 2) * 0.26 * width
    z = high - WALL - 0.07
    body.add(
        box((0.05, 0.032, 0.03)), at=(wall - 0.002, y, z), by="back.bottom", rgb=(0.85, 0.85, 0.86)
    )
    body.add(
        cylinder(0.008, 0.02), at=(wall + 0.036, y, z + 0.001), by="top", rgb=(0.85, 0.85, 0.86)
    )
    tap = cooler.part(f"tap_{k + 1}", material="abs")
    if lever == "paddle":
        # Pressed back by the cup, it turns about its upper edge.
        leaf = tap.add(
            box((0.006, 0.03, 0.07)), at=(wall + 0.021, y, z - 0.001), by="top", rgb=colours[k]
        )
        cooler.revolute(
            f"tap_press_{k + 1}", body, tap, at=leaf.anchor("top"), axis=(0, 1, 0), range=(0, 0.22)
        )
    else:
        tap.add(
            cylinder(0.012, 0.006), at=(wall + 0.025, y, z + 0.0315), by="bottom", rgb=colours[k]
        )
        cooler.prismatic(
            f"tap_press_{k + 1}", body, tap, axis="down", range=(0, 0.0018), friction=0.1
        )
if supply == "bottle":
    jug = cooler.part("bottle", material="bottle", mass=9.0)
    r, tall = 0.43 * min(deep, width), height - top - 0.0005
    profile = [
        (0, 0),
        (0.3 * r, 0),
        (0.35 * r, 0.12 * tall),
        (r, 0.3 * tall),
        (r, 0.6 * tall),
        (0.95 * r, 0.63 * tall),
        (r, 0.66 * tall),
        (r, 0.96 * tall),
        (0.93 * r, tall),
    ]
    jug.add(lathe(profile, thickness=0.002), at=(0, 0, top + 0.0005))
    jug.add(cylinder(0.93 * r, 0.002), at=(0, 0, height), by="top")
    cooler.prismatic("bottle_lift", body, jug, axis="up", range=(0, 0.3))
else:
    lid = cooler.part("lid", material="casing")
    lid.add(
        box((deep - 0.02, width, height - top - 0.0005)),
        at=(0, 0, height),
        by="top",
        rgb=(0.3, 0.32, 0.34),
    )
    cooler.revolute("lid_hinge", body, lid, at="back.hinge", range=(0, 1.4))
for k, lamp in enumerate(((0.1, 0.7, 0.2), (0.9, 0.6, 0.1))):
    at = (x, (k - 0.5) * 0.06, high + 0.6 * (top - high))
    body.add(cylinder(0.006, 0.003), at=at, rpy=(0, math.pi / 2, 0), rgb=lamp, role="visual")
switch = cooler.part("switch", material="abs")
at = (x + 0.0015, 0.3 * width, high + 0.6 * (top - high))
switch.add(box((0.006, 0.024, 0.014)), at=at, by="back", rgb=(0.75, 0.1, 0.1))
cooler.prismatic("switch_press", body, switch, axis="back", range=(0, 0.0018))
