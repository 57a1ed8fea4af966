# Label: microwave oven
# PartNet-Mobility: Microwave
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, grid, hollow_box, mirror, panel

depth = 0.38  # 0.33 to 0.5 m
width = 0.5  # 0.44 to 0.6 m
height = 0.29  # 0.26 to 0.36 m
controls = "knobs"  # one of knobs, buttons
pull = "bar"  # one of bar, button
finish = "silver"  # one of silver, white, black

FRONT, PULL, WALL, FOOT = 0.03, 0.03, 0.025, 0.012
oven = Object("microwave", label="microwave oven")
shade = {"silver": (0.7, 0.7, 0.72), "white": (0.93, 0.93, 0.91), "black": (0.1, 0.1, 0.11)}[finish]
oven.material("finish", like="insulated", rgb=shade)
oven.material("dark_glass", like="glass", rgb=(0.06, 0.06, 0.08))
body = oven.part("body", material="finish")
body_depth, side = depth - FRONT - PULL, 0.24 * width
cavity = width - side
tall = height - FOOT
shell = body.add(
    hollow_box((body_depth, cavity, tall), WALL, open="+x"),
    at=(0, -side / 2, FOOT),
    by="bottom",
    rgb=shade,
)
x = shell.anchor("front")[0]
for foot in mirror(mirror((0.35 * body_depth, 0.4 * width, 0)), "x"):
    body.add(cylinder(0.015, FOOT), at=foot, by="bottom", material="rubber")
# The electronics beside the cavity, and their panel, flush with the door.
edge = width / 2 - side
body.add(box((body_depth, side, tall)), at=(0, width / 2, FOOT), by="left.bottom")
plate = body.add(
    box((FRONT, side - 0.002, tall)),
    at=(x, width / 2, FOOT),
    by="back.left.bottom",
    rgb=(0.12, 0.12, 0.13),
)
face, centre = plate.anchor("front")[0], edge + side / 2
display = box((0.002, 0.7 * side, 0.13 * tall))
body.add(
    display,
    at=(face, centre, height - 0.14 * tall),
    by="back",
    rgb=(0.1, 0.45, 0.35),
    role="visual",
)

door = oven.part("door", material="finish")
size = (cavity - 0.002, tall)
window = (0, 0, size[0] - 0.11, size[1] - 0.1)
upright = (math.pi / 2, 0, math.pi / 2)
at = (x + 0.0005, -width / 2, FOOT)
leaf = door.add(
    panel(size, FRONT, [window]), at=at, rpy=upright, by="back.right.bottom", name="leaf"
)
pane = box((0.01, window[2] + 0.01, window[3] + 0.01))
middle = leaf.anchor("centre")
door.add(pane, at=middle, material="dark_glass")
oven.revolute(
    "hinge",
    body,
    door,
    at=leaf.anchor("right.back"),
    axis=(0, 0, -1),
    range=(0, 1.57),
    opens="front",
)
if pull == "bar":
    grip = (face + PULL, edge - 0.03, middle[2])
    door.add(cylinder(0.008, 0.7 * tall), at=grip, by="front", material="steel")
    for z in (-0.28 * tall, 0.28 * tall):
        post = (face - 0.002, edge - 0.03, middle[2] + z)
        door.add(
            cylinder(0.006, PULL - 0.004),
            at=post,
            rpy=(0, math.pi / 2, 0),
            by="back",
            material="steel",
        )
else:
    latch = oven.part("latch", material="abs")
    latch.add(
        box((PULL - 0.0015, 0.7 * side, 0.12 * tall)),
        at=(face + 0.0015, centre, FOOT + 0.1 * tall),
        by="back",
        rgb=shade,
    )
    oven.prismatic("latch_press", body, latch, axis="back", range=(0, 0.0018))

low = FOOT + 0.25 * tall
if controls == "knobs":
    radius = min(0.3 * side, 0.13 * tall)
    for k in range(2):
        knob = oven.part(f"knob_{k + 1}", material="abs")
        at = (face + 0.0008, centre, low + (0.08 + 0.32 * k) * tall)
        dial = knob.add(
            cylinder(radius, 0.02), at=at, rpy=(0, math.pi / 2, 0), by="back", rgb=(0.7, 0.7, 0.72)
        )
        mark = box((0.002, 0.004, radius))
        knob.add(mark, at=dial.anchor("front"), by="bottom", rgb=(0.1, 0.1, 0.1), role="visual")
        oven.continuous(f"turn_{k + 1}", body, knob, at="centre", axis="front")
else:
    pitch, rise = 0.27 * side, 0.13 * tall
    for k, (dy, dz, _) in enumerate(grid((3, 4), (pitch, rise))):
        key = oven.part(f"key_{k + 1}", material="abs")
        at = (face + 0.0015, centre + dy, low + 0.25 * tall + dz)
        key.add(box((0.004, 0.8 * pitch, 0.7 * rise)), at=at, by="back", rgb=(0.75, 0.75, 0.77))
        oven.prismatic(f"press_{k + 1}", body, key, axis="back", range=(0, 0.0018))

# The turntable runs on a hub in the cavity's floor.
centre = (0, -side / 2, FOOT + WALL)
body.add(
    cylinder(0.02, 0.012),
    at=(0, -side / 2, FOOT + WALL - 0.002),
    by="bottom",
    material="polypropylene",
)
table = oven.part("turntable", material="glass")
radius = 0.5 * min(body_depth - WALL, cavity - 2 * WALL) - 0.015
disc = table.add(cylinder(radius, 0.006), at=(0, -side / 2, FOOT + WALL + 0.0108), by="bottom")
table.add(box((2 * radius - 0.04, 0.006, 0.002)), at=disc.anchor("top"), by="bottom")
oven.continuous("spin", body, table, at=disc.anchor("centre"), axis="up")
