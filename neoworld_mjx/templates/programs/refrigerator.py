# Label: refrigerator
# PartNet-Mobility: Refrigerator
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror

depth = 0.7  # 0.62 to 0.8 m
width = 0.7  # 0.6 to 0.92 m
height = 1.75  # 1.5 to 1.9 m
layout = "bottom_freezer"  # one of bottom_freezer, top_freezer, side_by_side, french
shelves = 3  # 2 to 4
pull = "bar"  # one of bar, ledge
finish = "steel"  # one of steel, white, black, mint

FRONT, PULL, WALL, FOOT = 0.05, 0.05, 0.045, 0.03
fridge = Object("refrigerator", label="refrigerator")
shade = {
    "steel": (0.72, 0.73, 0.75),
    "white": (0.94, 0.94, 0.93),
    "black": (0.11, 0.11, 0.12),
    "mint": (0.62, 0.82, 0.76),
}[finish]
fridge.material("finish", like="insulated", rgb=shade)
fridge.material("liner", like="insulated", rgb=(0.95, 0.95, 0.95))
fridge.material("clear", like="acrylic", rgb=(0.8, 0.88, 0.92), alpha=0.5)
body = fridge.part("body", material="finish")
body_depth = depth - FRONT - PULL
shell = body.add(
    hollow_box((body_depth, width, height - FOOT), WALL, open="+x"),
    at=(0, 0, FOOT),
    by="bottom",
    material="liner",
)
for foot in mirror(mirror((0.4 * body_depth, 0.4 * width, 0)), "x"):
    body.add(cylinder(0.02, FOOT), at=foot, by="bottom", material="rubber")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
skin = 0.002
for side in mirror((0, width / 2, FOOT)):
    body.add(
        box((body_depth, skin, height - FOOT)),
        at=side,
        by="left.bottom" if side[1] > 0 else "right.bottom",
    )
body.add(box((body_depth, width, skin)), at=(0, 0, height), by="top")
low, high = FOOT + WALL, height - WALL
split = {"bottom_freezer": 0.38, "top_freezer": 0.7, "french": 0.34, "side_by_side": 1.0}[layout]
line = FOOT + split * (height - FOOT)
wall = width * -0.08  # of side by side: the freezer is the narrower half, at -y
if layout == "side_by_side":
    deck = box((body_depth - WALL, WALL, high - low + 0.004))
    body.add(deck, at=(x, wall, low - 0.002), by="front.bottom", material="liner")
else:
    inside = (-width / 2 + WALL, width / 2 - WALL)
    fridge.shelf(
        body, x=(back + WALL, x), y=inside, z=line + WALL / 2, thickness=WALL, material="liner"
    )


def handle(part, y, z, tall):
    """Add an upright handle at (y, z), or a level one where tall is negative."""
    face = x + 0.0005 + FRONT
    flat = (math.pi / 2, 0, 0) if tall < 0 else (0, 0, 0)
    if pull == "ledge":
        part.add(
            box((PULL - 0.0005, 0.025, abs(tall))),
            at=(face, y, z),
            rpy=flat,
            by="back",
            material="aluminium",
        )
        return
    part.add(
        cylinder(0.012, abs(tall)),
        at=(face + PULL - 0.0005, y, z),
        rpy=flat,
        by="front",
        material="steel",
    )
    for s in (-0.42 * tall, 0.42 * tall):
        at = (face - 0.003, y + (s if tall < 0 else 0), z + (0 if tall < 0 else s))
        part.add(
            cylinder(0.008, PULL - 0.005),
            at=at,
            rpy=(0, math.pi / 2, 0),
            by="back",
            material="steel",
        )


def door(name, y, z, hinge):
    """Hang a door with a bin inside."""
    leaf = fridge.door(name, body, x=x, y=y, z=z, hinge=hinge, thickness=FRONT, gap=0.002)
    edge = y[0] + 0.05 if hinge == "left" else y[1] - 0.05
    handle(leaf, edge, (z[0] + z[1]) / 2, min(0.5, 0.6 * (z[1] - z[0])))
    return leaf


def inner(name, y, low, high, leaf):
    """Put a clear drawer on the floor at low, and shelves above it."""
    tray = fridge.drawer(
        name, body, x=x - 0.12, y=y, z=(low, low + 0.2), depth=body_depth - WALL - 0.14,
        front=0.01, wall=0.006, after=leaf, material="clear", gap=0.004,
    )  # fmt: skip
    grip = (x - 0.113, (y[0] + y[1]) / 2, low + 0.15)
    tray.add(box((0.02, 0.3 * (y[1] - y[0]), 0.015)), at=grip, by="back", material="liner")
    for k in range(shelves):
        z = low + 0.22 + k * (high - low - 0.22) / shelves
        fridge.shelf(body, x=(back + WALL, x - 0.1), y=y, z=z, thickness=0.01, material="clear")


halves = ((-width / 2, 0), (0, width / 2))
if layout == "side_by_side":
    cold = door("freezer_door", (-width / 2, wall), (FOOT, height), "right")
    leaf = door("fridge_door", (wall, width / 2), (FOOT, height), "left")
    inner("freezer_drawer", (-width / 2 + WALL, wall - WALL / 2), low, high, cold)
    inner("crisper", (wall + WALL / 2, width / 2 - WALL), low, high, leaf)
else:
    lower, upper = (low, line - WALL / 2), (line + WALL / 2, high)
    cells = (
        {"fridge": lower, "freezer": upper}
        if layout == "top_freezer"
        else {"freezer": lower, "fridge": upper}
    )
    fronts = {"freezer": (FOOT, line), "fridge": (line, height)}
    if layout == "top_freezer":
        fronts = {"fridge": (FOOT, line), "freezer": (line, height)}
    if layout == "french":
        doors = [door("right_door", halves[0], fronts["fridge"], "right")]
        doors.append(door("left_door", halves[1], fronts["fridge"], "left"))
        bin_ = fridge.drawer(
            "freezer_drawer", body, x=x, y=inside, z=lower, depth=body_depth - WALL - 0.02,
            front=FRONT, overlay=WALL / 2 - 0.002, material="finish",
        )  # fmt: skip
        handle(bin_, 0, line - 0.1, -0.6 * width)
        inner("crisper", inside, *upper, doors)
    else:
        leaf = door("fridge_door", (-width / 2, width / 2), fronts["fridge"], "left")
        inner("crisper", inside, *cells["fridge"], leaf)
        cold = door("freezer_door", (-width / 2, width / 2), fronts["freezer"], "left")
        z = cells["freezer"]
        half = (z[0] + z[1]) / 2
        fridge.shelf(
            body, x=(back + WALL, x - 0.1), y=inside, z=half, thickness=0.01, material="clear"
        )
        for k, span in enumerate(((z[0], half - 0.012), (half, z[1] - 0.02))):
            tray = fridge.drawer(
                f"freezer_drawer_{k + 1}",
                body,
                x=x - 0.05,
                y=inside,
                z=span,
                depth=body_depth - WALL - 0.07,
                front=0.01,
                wall=0.006,
                after=cold,
                material="clear",
                gap=0.004,
            )
            grip = (x - 0.043, 0, (span[0] + span[1]) / 2)
            tray.add(box((0.02, 0.3 * width, 0.015)), at=grip, by="back", material="liner")
