# Label: nightstand
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, frustum, hollow_box, sphere

depth = 0.4  # 0.3 to 0.5 m
width = 0.45  # 0.35 to 0.65 m
height = 0.58  # 0.45 to 0.7 m
drawers = 2  # 1 to 3
bottom = "door"  # one of door, open, drawers
legs = "tapered"  # one of tapered, plinth, frame
wood = "walnut"  # one of walnut, oak, pine, mdf

FRONT, KNOB, WALL, TOP = 0.018, 0.025, 0.016, 0.02
LEG = 0.05 if legs == "plinth" else 0.14
deep, x = depth - FRONT - KNOB, depth / 2 - FRONT - KNOB
obj = Object("nightstand", label="nightstand")
body = obj.part("body", material=wood)
case = hollow_box((deep, width - 0.02, height - LEG - TOP), WALL, open="+x")
body.add(case, at=(x, 0, LEG), by="front.bottom")
body.add(box((deep + FRONT, width, TOP)), at=(x - deep, 0, height), by="back.top")
for y in (-width / 2 + 0.04, width / 2 - 0.04):
    for fx in (x - 0.03, x - deep + 0.03):
        if legs == "tapered":
            body.add(frustum(0.011, 0.022, LEG), at=(fx, y, 0), by="bottom")
        elif legs == "frame":
            body.add(box((0.02, 0.02, LEG)), at=(fx, y, 0), by="bottom", material="abs")
    if legs == "frame":
        runner = box((deep - 0.04, 0.02, 0.02))
        body.add(runner, at=(x - deep / 2, y, 0), by="bottom", material="abs")
if legs == "plinth":
    body.add(box((deep - 0.03, width - 0.06, LEG)), at=(x - 0.03, 0, 0), by="front.bottom")

inner = width / 2 - 0.01 - WALL
low, high = LEG + WALL, height - TOP - WALL
upper = low if bottom == "drawers" else low + 0.5 * (high - low)
if bottom != "drawers":
    board = (x - deep + WALL, x)
    obj.shelf(body, x=board, y=(-inner, inner), z=upper, thickness=WALL)
step = (high - upper) / drawers
for k in range(drawers):
    a, b = upper + k * step, upper + (k + 1) * step
    if k:
        obj.shelf(body, x=(x - deep + WALL, x), y=(-inner, inner), z=a, thickness=0.012)
    top = b if k == drawers - 1 else b - 0.012
    chest = obj.drawer(
        f"drawer_{k + 1}",
        body,
        x=x,
        y=(-inner, inner),
        z=(a, top),
        depth=deep - WALL - 0.01,
        wall=0.008,
        overlay=0.0045,
    )
    face = chest.anchor("front")[0]
    stem = cylinder(0.006, KNOB - 0.01)
    at = (face - 0.003, 0, (a + top) / 2)
    chest.add(stem, at=at, rpy=(0, math.pi / 2, 0), by="back", material="brass")
    chest.add(sphere(0.011), at=(face + KNOB, 0, at[2]), by="front", material="brass")
if bottom == "door":
    door = obj.door(
        "door", body, x=x, y=(-width / 2 + 0.012, width / 2 - 0.012), z=(LEG, upper - 0.009),
        hinge="left",
    )  # fmt: skip
    at = (x + FRONT - 0.002, -width / 2 + 0.05, (LEG + upper) / 2 + 0.04)
    door.add(box((KNOB - 0.005, 0.012, 0.07)), at=at, by="back", material="brass")
