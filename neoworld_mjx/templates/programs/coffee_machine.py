# Label: coffee machine
# PartNet-Mobility: CoffeeMachine
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    hollow_box,
    lathe,
    panel,
    sphere,
    sweep,
)

depth = 0.34  # 0.28 to 0.42 m
width = 0.26  # 0.2 to 0.36 m
height = 0.36  # 0.32 to 0.42 m
brews = "espresso"  # one of espresso, drip
buttons = 2  # 1 to 4
finish = "steel"  # one of steel, black, red, cream

flat, across = (0, math.pi / 2, 0), (math.pi / 2, 0, 0)
machine = Object("coffee_machine", label="coffee machine")
shade = {
    "steel": (0.72, 0.73, 0.74),
    "black": (0.12, 0.12, 0.13),
    "red": (0.65, 0.1, 0.1),
    "cream": (0.9, 0.86, 0.75),
}
machine.material("casing", like="abs", rgb=shade[finish])
machine.material("tank", like="acrylic", rgb=(0.7, 0.8, 0.85), alpha=0.6)
body = machine.part("body", material="casing")
OUT = 0.08 if brews == "espresso" else 0.05
BASE, HEAD, WALL = 0.06, 0.32 * height, 0.004
deep = depth - OUT
back, x = -depth / 2, -depth / 2 + deep
# A column at the back holds the water; its lid is on top.
column = 0.42 * deep
tank = hollow_box((column, width, height - BASE - 0.012), WALL, open="+z")
body.add(tank, at=(back, 0, BASE), by="back.bottom", name="column")
head = hollow_box((deep - column + WALL, width, HEAD - 0.012), WALL, open=[])
body.add(head, at=(x, 0, height - 0.012), by="front.top", name="head")
base = hollow_box((deep, width, BASE), WALL, open="+x" if brews == "espresso" else [])
body.add(base, at=(back, 0, 0), by="back.bottom", name="base")
lid = machine.part("lid", material="tank")
lid.add(box((column - 0.002, width, 0.0115)), at=(back, 0, height), by="back.top")
machine.revolute("lid_hinge", body, lid, at="back.hinge", range=(0, 1.5), friction=0.3)
body.add(box((deep - column, width, 0.012)), at=(x, 0, height), by="front.top")

middle = x - (deep - column) / 2
level = height - HEAD
if brews == "espresso":
    tray = machine.drawer(
        "drip_tray", body, x=x, y=(-width / 2 + WALL, width / 2 - WALL), z=(WALL, BASE - WALL),
        depth=0.9 * deep, wall=0.002, front=0.004, gap=0.001,
    )  # fmt: skip
    lip = (x + 0.003, 0, BASE / 2)
    tray.add(box((0.02, 0.3 * width, 0.01)), at=lip, by="back", material="abs")
    slits = [
        (0, y, 0.6 * (deep - column), 0.004) for y in [(k - 4) * 0.09 * width for k in range(9)]
    ]
    body.add(
        panel((deep - column - 0.01, 0.9 * width), 0.003, slits),
        at=(middle, 0, BASE),
        by="bottom",
        material="steel",
    )
    body.add(cylinder(0.036, 0.025), at=(middle, 0, level + 0.001), by="top", material="steel")
    filter_ = machine.part("portafilter", material="steel")
    z = level - 0.025
    cup = lathe([(0, 0), (0.02, 0), (0.032, 0.012), (0.032, 0.03)], thickness=0.002)
    filter_.add(cup, at=(middle, 0, z - 0.031))
    filter_.add(cylinder(0.006, 0.03), at=(middle, 0, z - 0.03), by="top")
    grip = [(middle + 0.03, 0, z - 0.015), (x, 0, z - 0.02), (x + OUT, 0, z - 0.03)]
    filter_.add(sweep(grip, radius=[0.006, 0.01, 0.012]), material="abs")
    machine.revolute(
        "portafilter_turn",
        body,
        filter_,
        at=(middle, 0, z),
        axis="up",
        range=(0, 0.8),
        friction=0.05,
    )
    # The wand hangs from a ball at the side of the head.
    wand = machine.part("steam_wand", material="stainless_steel")
    at = (x - 0.03, 0.38 * width, level - 0.008)
    wand.add(sphere(0.0075), at=at)
    low = BASE + 0.05
    pipe = [at, (at[0] + 0.01, at[1], at[2] - 0.02), (at[0] + 0.015, at[1] + 0.005, low)]
    wand.add(sweep(pipe, radius=0.004))
    machine.ball("wand_swing", body, wand, at=at, swing=0.35, friction=0.02)
    knobs = 2
else:
    plate = body.add(
        cylinder(0.3 * width, 0.004), at=(middle + 0.01, 0, BASE), by="bottom", material="cast_iron"
    )
    x0, radius, tall = middle + 0.01, 0.29 * min(width, deep - column), level - BASE - 0.06
    carafe = machine.part("carafe", material="glass")
    glass = [
        (0, 0),
        (0.85 * radius, 0),
        (radius, 0.3 * tall),
        (0.9 * radius, 0.7 * tall),
        (0.65 * radius, tall),
    ]
    z = BASE + 0.0045
    carafe.add(lathe(glass, thickness=0.003), at=(x0, 0, z))
    handle = [
        (x0 + 0.64 * radius, 0, z + tall - 0.008),
        (x - 0.01, 0, z + tall),
        (x + OUT, 0, z + 0.85 * tall),
        (x + OUT - 0.008, 0, z + 0.4 * tall),
        (x0 + radius - 0.003, 0, z + 0.3 * tall),
    ]
    shift = 0.006  # half of the handle's width
    handle = [(min(p[0], x + OUT - shift), p[1], p[2]) for p in handle]
    carafe.add(sweep(handle, width=0.018, thickness=0.012), material="abs")
    machine.prismatic("carafe_slide", body, carafe, axis="front", range=(0, 0.18))
    cap = machine.part("carafe_lid", material="abs")
    cap.add(cylinder(0.65 * radius, 0.012), at=(x0, 0, z + tall + 0.0008), by="bottom")
    machine.revolute(
        "carafe_lid_hinge",
        carafe,
        cap,
        at="front.hinge",
        range=(0, 1.6),
        after=carafe,
        friction=0.04,
    )
    basket = machine.part("basket", material="abs")
    funnel = lathe([(0, 0), (0.3 * radius, 0), (0.9 * radius, 0.038)], thickness=0.002)
    basket.add(funnel, at=(x0, 0, level - 0.039))
    hinge = (x0, -0.9 * radius - 0.01, level - 0.02)
    basket.add(box((0.02, 0.03, 0.03)), at=(x0, -0.9 * radius + 0.01, level - 0.001), by="top")
    machine.revolute("basket_swing", body, basket, at=hinge, axis=(0, 0, -1), range=(0, 1.2))
    knobs = 1

face, row = x, height - 0.012 - HEAD / 2
for k in range(knobs):
    knob = machine.part(f"knob_{k + 1}", material="abs")
    at = (face + 0.0008, (0.38 if k else -0.38) * width, row)
    dial = knob.add(cylinder(0.018, 0.02), at=at, rpy=flat, by="back", rgb=(0.2, 0.2, 0.21))
    knob.add(
        box((0.002, 0.003, 0.016)),
        at=dial.anchor("front"),
        by="bottom",
        rgb=(0.9, 0.9, 0.9),
        role="visual",
    )
    machine.continuous(f"turn_{k + 1}", body, knob, at=dial.anchor("centre"), axis="front")
for k in range(buttons):
    button = machine.part(f"button_{k + 1}", material="abs")
    at = (face + 0.0015, (k - (buttons - 1) / 2) * 0.14 * width, row + 0.01)
    button.add(cylinder(0.009, 0.005), at=at, rpy=flat, by="back", rgb=(0.85, 0.85, 0.86))
    machine.prismatic(f"press_{k + 1}", body, button, axis="back", range=(0, 0.0018))
