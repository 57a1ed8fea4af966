# Label: desktop printer
# PartNet-Mobility: Printer

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror

depth = 0.4  # 0.34 to 0.48 m
width = 0.44  # 0.36 to 0.55 m
height = 0.36  # 0.26 to 0.5 m
trays = 1  # 1 to 2
buttons = 4  # 2 to 6
top = "feeder"  # one of feeder, scanner
finish = "grey"  # one of grey, white, black

FOOT, WALL, LID, FRONT = 0.01, 0.005, 0.045, 0.012
printer = Object("printer", label="desktop printer")
shade = {"grey": (0.6, 0.61, 0.63), "white": (0.93, 0.93, 0.92), "black": (0.13, 0.13, 0.14)}[
    finish
]
printer.material("casing", like="abs", rgb=shade)
body = printer.part("body", material="casing", mass=8.0)
deep = depth - FRONT
x = depth / 2 - FRONT
top_z = height - LID
paper = FOOT + (0.3 + 0.06 * trays) * (top_z - FOOT)
bay = paper + 0.3 * (top_z - FOOT)
for foot in mirror(mirror((-FRONT / 2 + 0.4 * deep, 0.4 * width, 0)), "x", at=-FRONT / 2):
    body.add(cylinder(0.014, FOOT), at=foot, by="bottom", material="rubber")
# From below: paper trays, the bay where prints come out, the scanner.
body.add(
    hollow_box((deep, width, paper - FOOT), WALL, open="+x"),
    at=(x, 0, FOOT),
    by="front.bottom",
    name="store",
)
body.add(
    hollow_box((deep, width, bay - paper), 0.04, open="+x"),
    at=(x, 0, paper),
    by="front.bottom",
    name="bay",
)
scanner = hollow_box((deep, width, top_z - bay), WALL, open=[])
body.add(scanner, at=(x, 0, bay), by="front.bottom", name="scanner")
glass = box((0.75 * deep, 0.75 * width, 0.002))
body.add(
    glass, at=(x - deep / 2, 0, top_z - 0.001), by="bottom", rgb=(0.08, 0.1, 0.12), role="visual"
)
step = (paper - FOOT - 2 * WALL) / trays
for k in range(trays):
    low = FOOT + WALL + k * step
    if k:
        printer.shelf(
            body,
            x=(x - deep + WALL, x),
            y=(-width / 2 + WALL, width / 2 - WALL),
            z=low,
            thickness=WALL,
        )
    tray = printer.drawer(
        f"paper_tray_{k + 1}",
        body,
        x=x,
        y=(-width / 2 + WALL, width / 2 - WALL),
        z=(low, low + step - (0 if k == trays - 1 else WALL)),
        depth=0.9 * deep,
        wall=0.003,
        front=FRONT,
        gap=0.0015,
    )
    grip = (x + FRONT, 0, low + 0.5 * step)
    tray.add(
        box((0.002, 0.3 * width, 0.25 * step)),
        at=grip,
        by="front",
        rgb=(0.05, 0.05, 0.05),
        role="visual",
    )
    sheets = (x - 0.03, 0, low + 0.004)
    tray.add(
        box((0.7 * deep, 0.6 * width, 0.3 * step)), at=sheets, by="front.bottom", material="paper"
    )
slide = printer.part("output_tray", material="abs")
floor = paper + 0.04
shelf = box((0.5 * deep, 0.5 * width, 0.004))
slide.add(shelf, at=(x, 0, floor + 0.0008), by="front.bottom", rgb=(0.25, 0.25, 0.27))
slide.add(
    box((0.008, 0.3 * width, 0.012)),
    at=(x, 0, floor + 0.0008),
    by="back.bottom",
    rgb=(0.25, 0.25, 0.27),
)
printer.prismatic("output_slide", body, slide, axis="front", range=(0, 0.35 * deep))

lid = printer.part("lid", material="casing")
if top == "scanner":
    lid.add(
        box((deep - 0.03, width - 0.01, LID - 0.0006)), at=(x - 0.03, 0, height), by="front.top"
    )
    at = (x - deep, 0, top_z + 0.0006)
else:
    # A document feeder: a block at the right, and a chute that folds up beside it.
    plate = lid.add(
        box((deep - 0.03, width - 0.01, 0.018)), at=(x - 0.03, 0, top_z + 0.0006), by="front.bottom"
    )
    block = (x - 0.03, plate.anchor("right")[1], height)
    lid.add(box((deep - 0.03, 0.4 * width, LID - 0.004)), at=block, by="front.right.top")
    at = (x - deep, 0, top_z + 0.0006)
    chute = printer.part("chute", material="casing")
    leaf = box((0.8 * deep, 0.46 * width, 0.008))
    edge = (x - 0.05, plate.anchor("right")[1] + 0.4 * width + 0.012, top_z + 0.0196)
    chute.add(leaf, at=edge, by="front.right.bottom", rgb=(0.3, 0.31, 0.33))
    printer.revolute("chute_fold", lid, chute, at="right.hinge", range=(0, 0.9), friction=0.25)
for side in mirror((x - deep + 0.015, 0.35 * width, top_z + 0.0006)):
    lid.add(box((0.035, 0.05, 0.012)), at=side, by="bottom")
printer.revolute("lid_hinge", body, lid, at=at, axis=(0, -1, 0), range=(0, 1.3), opens="up")

# The panel tips out from the scanner's front.
rise = top_z - bay
tilt = printer.part("panel", material="abs")
board = tilt.add(
    box((FRONT - 0.002, 0.62 * width, 0.8 * rise)),
    at=(x + 0.001, 0.15 * width, top_z - 0.05 * rise),
    by="back.top",
)
face, y, z = tilt.anchor("front")
screen = box((0.002, 0.2 * width, 0.5 * rise))
tilt.add(screen, at=(face, y - 0.16 * width, z), by="front", rgb=(0.15, 0.35, 0.5), role="visual")
printer.revolute(
    "panel_tilt",
    body,
    tilt,
    at=board.anchor("top.back"),
    axis=(0, -1, 0),
    range=(0, 0.9),
    friction=0.2,
)
for k in range(buttons):
    button = printer.part(f"button_{k + 1}", material="abs")
    at = (face + 0.0012, y + 0.01 * width + 0.05 * width * k, z)
    button.add(box((0.0008, 0.036 * width, 0.2 * rise)), at=at, by="back", rgb=(0.7, 0.71, 0.73))
    printer.prismatic(f"press_{k + 1}", tilt, button, axis="back", range=(0, 0.0014))
