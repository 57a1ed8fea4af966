# Label: drawer cabinet
# PartNet-Mobility: StorageFurniture
import math

from neoworld_mjx.program.sdk import Object, cylinder, hollow_box, sphere

depth = 0.5  # 0.35 to 0.65 m
width = 0.6  # 0.35 to 1.2 m
height = 0.75  # 0.45 to 1.2 m
drawers = 3  # 2 to 5
pull = "bar"  # one of bar, knob
wood = "oak"  # one of oak, pine, walnut, mdf

FRONT, PULL, WALL = 0.018, 0.035, 0.018
body_depth = depth - FRONT - PULL
cabinet = Object("drawer_cabinet", label="drawer cabinet")
body = cabinet.part("body", material=wood)
shell = body.add(hollow_box((body_depth, width, height), WALL, open="+x"), by="bottom")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
inside = (-width / 2 + WALL, width / 2 - WALL)
level = (height - WALL) / drawers
for k in range(drawers):
    low, high = k * level + WALL, (k + 1) * level
    if k:
        cabinet.shelf(body, x=(back + WALL, x), y=inside, z=low, thickness=WALL)
    tray = cabinet.drawer(
        f"drawer_{k + 1}",
        body,
        x=x,
        y=inside,
        z=(low, high),
        depth=0.9 * body_depth,
        front=FRONT,
        overlay=WALL / 2 - 0.001,
    )
    px = tray.anchor("front")[0]
    middle = (low + high) / 2
    if pull == "knob":
        tray.add(sphere(0.014), at=(px + PULL, 0, middle), by="front", material="brass")
        stem = cylinder(0.006, PULL - 0.014)
        tray.add(
            stem, at=(px - 0.003, 0, middle), rpy=(0, math.pi / 2, 0), by="back", material="brass"
        )
    else:
        bar = cylinder(0.006, width / 3)
        tray.add(
            bar, at=(px + PULL, 0, middle), rpy=(math.pi / 2, 0, 0), by="front", material="steel"
        )
        for y in (-width / 8, width / 8):
            post = cylinder(0.005, PULL - 0.004)
            at = (px - 0.003, y, middle)
            tray.add(post, at=at, rpy=(0, math.pi / 2, 0), by="back", material="steel")
