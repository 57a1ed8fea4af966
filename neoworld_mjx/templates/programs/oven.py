# Label: oven with a hob
# PartNet-Mobility: Oven
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, grid, hollow_box, mirror, panel, torus

depth = 0.62  # 0.56 to 0.7 m
width = 0.6  # 0.5 to 0.76 m
height = 0.9  # 0.84 to 0.95 m
racks = 2  # 1 to 3
hob = "rings"  # one of rings, grates, glass
base = "drawer"  # one of drawer, plinth
finish = "stainless"  # one of stainless, white, black

FRONT, PULL, WALL, TOP = 0.035, 0.045, 0.035, 0.012
PANEL, LOW = 0.12, 0.2 if base == "drawer" else 0.09
oven = Object("oven", label="oven with a hob")
shade = {"stainless": (0.7, 0.71, 0.72), "white": (0.92, 0.92, 0.9), "black": (0.12, 0.12, 0.13)}[
    finish
]
oven.material("finish", like="insulated", rgb=shade)
oven.material("dark_glass", like="glass", rgb=(0.05, 0.05, 0.06))
body = oven.part("body", material="finish")
body_depth, tall = depth - FRONT - PULL, height - TOP
shell = body.add(hollow_box((body_depth, width, tall), WALL, open="+x"), by="bottom")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
inside = (-width / 2 + WALL, width / 2 - WALL)
oven.shelf(body, x=(back + WALL, x), y=inside, z=LOW + 0.02, thickness=0.04)
oven.shelf(body, x=(back + WALL, x), y=inside, z=tall - PANEL + 0.03, thickness=0.03)
front = body.add(box((FRONT, width, PANEL - 0.003)), at=(x, 0, tall), by="back.top")
face = front.anchor("front")[0]

# Four burners, a knob for each and one for the oven.
spread, radius = (0.45 * body_depth, 0.45 * width), 0.17 * min(body_depth, width)
for at in grid((2, 2), spread, (0, 0, tall)):
    if hob == "glass":
        body.add(cylinder(radius, 0.001), at=at, by="bottom", rgb=(0.5, 0.5, 0.52), role="visual")
        continue
    body.add(cylinder(0.4 * radius, TOP - 0.003), at=at, by="bottom", material="cast_iron")
    body.add(torus(radius, 0.004), at=(at[0], at[1], height), by="top", material="cast_iron")
    for turn in (0, math.pi / 2):
        bar = box((2 * radius, 0.006, TOP - (0.004 if hob == "rings" else 0)))
        body.add(bar, at=at, rpy=(0, 0, turn), by="bottom", material="cast_iron")
if hob == "glass":
    body.add(box((body_depth, width, TOP)), at=(0, 0, tall), by="bottom", material="dark_glass")
for k in range(5):
    knob = oven.part(f"knob_{k + 1}", material="abs")
    at = (face + 0.0008, (k - 2) * 0.19 * width, tall - PANEL / 2)
    dial = knob.add(
        cylinder(0.024, 0.025), at=at, rpy=(0, math.pi / 2, 0), by="back", rgb=(0.15, 0.15, 0.16)
    )
    knob.add(
        box((0.002, 0.005, 0.022)),
        at=dial.anchor("front"),
        by="bottom",
        rgb=(0.9, 0.9, 0.9),
        role="visual",
    )
    oven.continuous(f"turn_{k + 1}", body, knob, at="centre", axis="front")

door = oven.part("door", material="finish")
size = (width, tall - PANEL - LOW - 0.002)
hole = (0, -0.03, width - 0.16, size[1] - 0.2)
frame = panel(size, FRONT, [hole])
leaf = door.add(
    frame, at=(x + 0.0005, 0, LOW + 0.001), rpy=(math.pi / 2, 0, math.pi / 2), by="back.bottom"
)
low, high = leaf.anchor("bottom")[2], leaf.anchor("top")[2]
pane = box((0.015, hole[2] + 0.01, hole[3] + 0.01))
door.add(pane, at=(x + FRONT / 2, 0, (low + high) / 2 - 0.03), material="dark_glass")
bar = (face + PULL, 0, high - 0.05)
door.add(
    cylinder(0.012, 0.8 * width), at=bar, rpy=(math.pi / 2, 0, 0), by="front", material="steel"
)
for post in mirror((face - 0.003, 0.33 * width, high - 0.05)):
    door.add(
        cylinder(0.008, PULL - 0.006), at=post, rpy=(0, math.pi / 2, 0), by="back", material="steel"
    )
oven.revolute(
    "hinge",
    body,
    door,
    at=leaf.anchor("bottom.front"),
    axis=(0, 1, 0),
    range=(0, 1.5),
    opens="front",
)

# Wire racks on rails at the side walls.
deep, span = body_depth - WALL - 0.03, width - 2 * WALL - 0.012
step = (tall - PANEL - LOW - 0.05) / (racks + 1)
for k in range(racks):
    z = LOW + 0.02 + (k + 0.7) * step
    for rail in mirror((x - 0.02, inside[1] + 0.002, z)):
        body.add(
            box((deep, 0.02, 0.006)),
            at=rail,
            by="front.left.top" if rail[1] > 0 else "front.right.top",
            material="steel",
        )
    rack = oven.part(f"rack_{k + 1}", material="steel")
    for rail in mirror((x - 0.01, span / 2, z + 0.0008)):
        rack.add(
            box((deep, 0.006, 0.006)),
            at=rail,
            by="front.left.bottom" if rail[1] > 0 else "front.right.bottom",
        )
    for i in range(8):
        rack.add(
            box((0.004, span, 0.004)),
            at=(x - 0.01 - i * (deep - 0.004) / 7, 0, z + 0.0018),
            by="front.bottom",
        )
    oven.prismatic(
        f"rack_slide_{k + 1}", body, rack, axis="front", range=(0, 0.6 * deep), after=door
    )
if base == "drawer":
    tray = oven.drawer(
        "drawer",
        body,
        x=x,
        y=inside,
        z=(WALL, LOW - 0.02),
        depth=0.85 * body_depth,
        front=FRONT,
        overlay=0.018,
    )
    lip = (x + FRONT - 0.002, 0, LOW - 0.03)
    tray.add(box((0.02, 0.5 * width, 0.012)), at=lip, by="back", material="steel")
else:
    body.add(
        box((FRONT - 0.01, width, LOW - 0.005)),
        by="back.bottom",
        at=(x, 0, 0),
        rgb=(0.08, 0.08, 0.08),
    )
