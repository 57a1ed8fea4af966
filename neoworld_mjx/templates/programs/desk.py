# Label: desk with drawers
# PartNet-Mobility: Table
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror, sphere

depth = 0.65  # 0.55 to 0.8 m
width = 1.3  # 1.1 to 1.7 m
height = 0.74  # 0.7 to 0.78 m
chest = "left"  # one of left, right, both, row
drawers = 3  # 2 to 4
pull = "knob"  # one of knob, bar
keyboard = "yes"  # one of yes, no
wood = "oak"  # one of oak, walnut, pine, white

TOP, WALL, FRONT, LEG, CHEST = 0.028, 0.018, 0.018, 0.05, 0.38
OUT = 0.03
desk = Object("desk", label="desk with drawers")
desk.material(
    "board",
    like="mdf" if wood == "white" else wood,
    rgb=(0.92, 0.91, 0.89) if wood == "white" else None,
)
body = desk.part("body", material="board")
body.add(box((depth, width, TOP)), at=(0, 0, height), by="top", name="top")
low, under = 0.06, height - TOP
x = depth / 2 - OUT - FRONT
deep = depth - OUT - FRONT - 0.02


def handle(tray, y, z, wide):
    """Add a pull to a drawer's front."""
    face = x + FRONT
    if pull == "knob":
        tray.add(sphere(0.013), at=(face + OUT - 0.002, y, z), by="front", material="brass")
        stem = cylinder(0.006, OUT - 0.012)
        tray.add(
            stem, at=(face - 0.002, y, z), rpy=(0, math.pi / 2, 0), by="back", material="brass"
        )
        return
    tray.add(
        cylinder(0.006, 0.4 * wide),
        at=(face + OUT - 0.002, y, z),
        rpy=(math.pi / 2, 0, 0),
        by="front",
        material="steel",
    )
    for post in mirror((face - 0.002, y + 0.15 * wide, z), at=y):
        tray.add(
            cylinder(0.005, OUT - 0.006),
            at=post,
            rpy=(0, math.pi / 2, 0),
            by="back",
            material="steel",
        )


def column(name, y):
    """Add a chest of drawers that stands under the top, its middle at y."""
    body.add(
        hollow_box((deep, CHEST, under - low + 0.001), WALL, open="+x"),
        at=(x, y, low),
        by="front.bottom",
        name=name,
    )
    for foot in mirror(
        mirror((x - deep / 2 + 0.4 * deep, y + 0.15, 0), at=y), "x", at=x - deep / 2
    ):
        body.add(cylinder(0.018, low + 0.002), at=foot, by="bottom", material="steel")
    inside = (y - CHEST / 2 + WALL, y + CHEST / 2 - WALL)
    step = (under - low - WALL) / drawers
    for k in range(drawers):
        floor, ceiling = low + WALL + k * step, low + (k + 1) * step
        if k:
            desk.shelf(body, x=(x - deep + WALL, x), y=inside, z=floor, thickness=WALL)
        tray = desk.drawer(
            f"{name}_{k + 1}",
            body,
            x=x,
            y=inside,
            z=(floor, ceiling),
            depth=0.85 * deep,
            front=FRONT,
            overlay=WALL / 2 - 0.001,
        )
        handle(tray, y, (floor + ceiling) / 2, CHEST)


legs, span = [-1, 1], [-width / 2 + 0.06, width / 2 - 0.06]
if chest in ("right", "both"):
    column("right_drawer", -width / 2 + 0.02 + CHEST / 2)
    legs.remove(-1)
    span[0] = -width / 2 + 0.02 + CHEST
if chest in ("left", "both"):
    column("left_drawer", width / 2 - 0.02 - CHEST / 2)
    legs.remove(1)
    span[1] = width / 2 - 0.02 - CHEST
for sign in legs:
    for lx in (depth / 2 - 0.01 - LEG / 2, -depth / 2 + 0.01 + LEG / 2):
        body.add(
            box((LEG, LEG, under + 0.001)),
            at=(lx, sign * (width / 2 - 0.01 - LEG / 2), 0),
            by="bottom",
        )
body.add(
    box((0.016, span[1] - span[0] + 0.02, 0.25)),
    at=(-depth / 2 + 0.03, sum(span) / 2, under + 0.001),
    by="top",
)
if chest == "row":
    # A row of flat drawers right under the top, between the legs.
    tall = 0.13
    frame = hollow_box((deep, span[1] - span[0], tall), WALL, open="+x")
    body.add(frame, at=(x, 0, under + 0.001), by="front.top", name="row")
    step = (span[1] - span[0] - WALL) / drawers
    for k in range(drawers):
        y = (span[0] + WALL + k * step, span[0] + (k + 1) * step)
        if k:
            post = box((deep, WALL, tall - 0.01))
            body.add(post, at=(x, y[0], under - tall / 2), by="front.left")
        tray = desk.drawer(
            f"drawer_{k + 1}",
            body,
            x=x,
            y=y,
            z=(under - tall + WALL, under - WALL),
            depth=0.85 * deep,
            front=FRONT,
            overlay=WALL / 2 - 0.001,
        )
        handle(tray, (y[0] + y[1]) / 2, under - tall / 2, step)
elif keyboard == "yes":
    y, half = sum(span) / 2, min(0.6, span[1] - span[0] - 0.14) / 2
    for side in (y - half - 0.02, y + half + 0.02):
        body.add(
            box((0.35, 0.039, 0.07)),
            at=(x - 0.02, side, under + 0.001),
            by="front.top",
            material="steel",
        )
    board = desk.part("keyboard_tray", material="board")
    board.add(
        box((0.36, 2 * half - 0.002, 0.016)), at=(x - 0.01, y, under - 0.065), by="front.bottom"
    )
    desk.prismatic("keyboard_slide", body, board, axis="front", range=(0, 0.24))
