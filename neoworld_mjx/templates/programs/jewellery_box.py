# Label: jewellery box
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, sphere

depth = 0.18  # 0.14 to 0.24 m
width = 0.28  # 0.22 to 0.36 m
height = 0.24  # 0.18 to 0.32 m
drawers = 3  # 1 to 4
sides = "wings"  # one of wings, plain
feet = "balls"  # one of balls, blocks
wood = "walnut"  # one of walnut, oak, pine

WALL, KNOB, LID, FOOT = 0.006, 0.012, 0.022, 0.012
FRONT, LEAF = 0.008, 0.008
wing = 0.035 if sides == "wings" else 0.0
deep, x = depth - FRONT - KNOB, depth / 2 - FRONT - KNOB
wide = width - (2 * (LEAF + KNOB + 0.0005) if wing else 0.0)
obj = Object("jewellery_box", label="jewellery box")
felt = obj.material("felt", like="fabric", rgb=(0.5, 0.1, 0.15))
mirror_glass = obj.material("mirror", like="glass", rgb=(0.75, 0.82, 0.86))
body = obj.part("body", material=wood)
top, well = height - LID - 0.001, 0.05
core = wide - 2 * wing
stack = hollow_box((deep, core, top - well - FOOT), WALL, open="+x")
body.add(stack, at=(x, 0, FOOT), by="front.bottom")
body.add(hollow_box((deep, core, well), WALL), at=(x, 0, top), by="front.top")
body.add(box((deep - 0.014, core - 0.014, 0.002)), at=(x - 0.007, 0, top - well + 0.007),
         by="front.bottom", material=felt)  # fmt: skip
for y in (-deep / 2.6, deep / 2.6):
    for across in (-wide / 2 + 0.02, wide / 2 - 0.02):
        at = (x - deep / 2 + y, across, 0)
        foot = sphere(0.009) if feet == "balls" else box((0.02, 0.02, FOOT + 0.001))
        body.add(foot, at=at, by="bottom", material="brass" if feet == "balls" else wood)

step = (top - well - FOOT - 2 * WALL) / drawers
for k in range(drawers):
    low = FOOT + WALL + k * step
    inner = core / 2 - WALL
    if k:
        obj.shelf(body, x=(x - deep + WALL, x), y=(-inner, inner), z=low, thickness=0.003)
    chest = obj.drawer(
        f"drawer_{k + 1}", body, x=x, y=(-inner, inner),
        z=(low, low + step - (0.003 if k < drawers - 1 else 0)), depth=deep - WALL - 0.004,
        wall=0.003, front=FRONT, gap=0.0012, overlay=0.001,
    )  # fmt: skip
    for y in (-core / 5, core / 5):
        at = (x + FRONT + KNOB, y, low + step / 2)
        chest.add(sphere(0.006), at=at, by="front", material="brass")
        stem = cylinder(0.003, 0.008)
        chest.add(stem, at=(x + FRONT, y, at[2]), rpy=(0, math.pi / 2, 0), material="brass")

lid = obj.part("lid", material=wood)
lid.add(hollow_box((deep, wide, LID), WALL, open="-z"), at=(x, 0, height), by="front.top")
glass = box((deep - 0.03, wide - 0.03, 0.002))
lid.add(glass, at=(x - 0.015, 0, height - WALL + 0.0005), by="front.top", material=mirror_glass)
obj.revolute("lid_hinge", body, lid, at="back.hinge", range=(0, 1.7))
for side, name in ((1, "left"), (-1, "right")) if wing else ():
    edge = side * wide / 2
    body.add(
        hollow_box((deep, wing, top - FOOT), WALL, open="+y" if side > 0 else "-y"),
        at=(x, edge, FOOT), by=f"front.{name}.bottom",
    )  # fmt: skip
    leaf = obj.part(f"{name}_wing", material=wood)
    inside = "right" if side > 0 else "left"
    panel = box((deep, LEAF, top - FOOT - 0.002))
    at = (x, edge + side * 0.0005, FOOT + 0.001)
    leaf.add(panel, at=at, by=f"front.bottom.{inside}")
    knob = (x - 0.02, side * width / 2, (top + FOOT) / 2)
    leaf.add(sphere(0.0065), at=knob, by=name, material="brass")
    pivot = leaf.anchor(f"back.{inside}")
    obj.revolute(f"{name}_wing_hinge", body, leaf, at=pivot, axis=(0, 0, side), range=(0, 1.55))
