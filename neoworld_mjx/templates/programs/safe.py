# Label: safe with a wheel and a lock
# PartNet-Mobility: Safe
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    grid,
    hollow_box,
    mirror,
    ring,
    sphere,
    torus,
)

depth = 0.45  # 0.35 to 0.6 m
width = 0.42  # 0.32 to 0.6 m
height = 0.48  # 0.36 to 0.8 m
lock = "dial"  # one of dial, keypad
grip = "wheel"  # one of wheel, lever
shelves = 1  # 0 to 2
finish = "grey"  # one of grey, green, black, white

FRONT, PULL, WALL, FOOT = 0.03, 0.055, 0.03, 0.015
safe = Object("safe", label="safe")
shade = {
    "grey": (0.36, 0.38, 0.4),
    "green": (0.16, 0.3, 0.22),
    "black": (0.1, 0.1, 0.1),
    "white": (0.88, 0.87, 0.84),
}
safe.material("armour", like="concrete", density=1300, rgb=shade[finish])
body = safe.part("body", material="armour")
body_depth = depth - FRONT - PULL
shell = body.add(
    hollow_box((body_depth, width, height - FOOT), WALL, open="+x"), at=(0, 0, FOOT), by="bottom"
)
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
for foot in mirror(mirror((0.38 * body_depth, 0.38 * width, 0)), "x"):
    body.add(cylinder(0.025, FOOT), at=foot, by="bottom", material="rubber")
inside, low = (-width / 2 + WALL, width / 2 - WALL), FOOT + WALL
step = (height - FOOT - 2 * WALL) / (shelves + 1)
for k in range(shelves):
    safe.shelf(
        body,
        x=(back + WALL, x - 0.04),
        y=inside,
        z=low + (k + 1) * step,
        thickness=0.01,
        material="chipboard",
    )

door = safe.door(
    "door", body, x=x, y=(-width / 2, width / 2), z=(FOOT, height), hinge="right", thickness=FRONT
)
face, middle = door.anchor("front")[0], (FOOT + height) / 2
flat = (0, math.pi / 2, 0)
for z in (-0.32, 0.32):
    at = (face, -width / 2 + 0.012, middle + z * height)
    door.add(cylinder(0.012, 0.12 * height), at=at, material="steel")
frame = (width - 0.09, height - FOOT - 0.07)
for s in (-1, 1):
    door.add(
        box((0.004, 0.006, frame[1])),
        at=(face - 0.001, s * frame[0] / 2, middle),
        by="back",
        material="steel",
    )
    door.add(
        box((0.004, frame[0], 0.006)),
        at=(face - 0.001, 0, middle + s * frame[1] / 2),
        by="back",
        material="steel",
    )

# The handle turns the bolts; the drawing shows it locked.
centre = (face + 0.0008, -0.06 * width, middle - 0.14 * height)
handle = safe.part("handle", material="steel")
if grip == "wheel":
    reach = 0.16 * min(width, height)
    hub = handle.add(cylinder(0.018, PULL - 0.001), at=centre, rpy=flat, by="back")
    tip = (face + PULL - 0.015, centre[1], centre[2])
    handle.add(torus(reach, 0.006), at=tip, rpy=flat)
    for _, dy, dz in [(0, p[0], p[1]) for p in ring(3, reach / 2, start=math.pi / 2)]:
        turn = math.atan2(dz, dy)
        spoke = cylinder(0.005, reach)
        handle.add(spoke, at=(tip[0], tip[1] + dy, tip[2] + dz), rpy=(math.pi / 2 + turn, 0, 0))
    safe.continuous("handle_turn", door, handle, at=hub.anchor("centre"), axis="front")
else:
    hub = handle.add(cylinder(0.016, PULL - 0.001), at=centre, rpy=flat, by="back")
    end = hub.anchor("front")
    lever = (end[0] - 0.012, end[1] + 0.01, end[2])
    handle.add(cylinder(0.009, 0.28 * width), at=lever, rpy=(math.pi / 2, 0, 0), by="right")
    handle.add(sphere(0.013), at=(end[0] - 0.013, end[1] + 0.01 + 0.28 * width, end[2]))
    safe.revolute(
        "handle_turn",
        door,
        handle,
        at=hub.anchor("centre"),
        axis=(-1, 0, 0),
        range=(0, 1.4),
        friction=0.5,
    )

place = (face + 0.0008, -0.06 * width, middle + 0.18 * height)
if lock == "dial":
    dial = safe.part("dial", material="steel")
    door.add(
        cylinder(0.042, 0.003),
        at=(face - 0.0022, *place[1:]),
        rpy=flat,
        by="back",
        rgb=(0.85, 0.85, 0.85),
        role="visual",
    )
    knob = dial.add(cylinder(0.035, 0.02), at=place, rpy=flat, by="back", rgb=(0.12, 0.12, 0.12))
    dial.add(cylinder(0.015, 0.035), at=place, rpy=flat, by="back")
    for dy, dz, _ in ring(10, 0.029):
        tick = (knob.anchor("front")[0], place[1] + dy, place[2] + dz)
        dial.add(cylinder(0.0025, 0.002), at=tick, rpy=flat, rgb=(0.95, 0.95, 0.95), role="visual")
    safe.continuous("dial_turn", door, dial, at=knob.anchor("centre"), axis="front")
else:
    door.add(box((0.012, 0.105, 0.125)), at=(face - 0.002, *place[1:]), by="back", material="abs")
    for k, (dy, dz, _) in enumerate(grid((3, 4), (0.03, 0.028))):
        key = safe.part(f"key_{k + 1}", material="abs")
        at = (face + 0.0115, place[1] + dy, place[2] + dz)
        key.add(box((0.005, 0.022, 0.02)), at=at, by="back", rgb=(0.85, 0.85, 0.86))
        safe.prismatic(f"press_{k + 1}", door, key, axis="back", range=(0, 0.0018))
tray = safe.drawer(
    "drawer",
    body,
    x=x - 0.05,
    y=inside,
    z=(low, low + 0.08),
    depth=body_depth - WALL - 0.06,
    wall=0.004,
    front=0.006,
    after=door,
    material="chipboard",
)
tray.add(sphere(0.009), at=(x - 0.05 + 0.012, 0, low + 0.04), material="brass")
