# Label: washing machine
# PartNet-Mobility: WashingMachine
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, lathe, mirror, panel, torus

depth = 0.6  # 0.5 to 0.68 m
width = 0.6  # 0.55 to 0.7 m
height = 0.85  # 0.82 to 0.98 m
loads = "front"  # one of front, top
buttons = 3  # 2 to 5
knobs = 1  # 1 to 2
finish = "white"  # one of white, grey, black

WALL, FOOT, RIM = 0.025, 0.02, 0.045
flat = (0, math.pi / 2, 0)
machine = Object("washing_machine", label="washing machine")
shade = {"white": (0.94, 0.94, 0.93), "grey": (0.55, 0.57, 0.6), "black": (0.13, 0.13, 0.14)}[
    finish
]
machine.material("finish", like="insulated", rgb=shade)
machine.material("dark_glass", like="glass", rgb=(0.15, 0.18, 0.22), alpha=0.8)
body = machine.part("body", material="finish", mass=45)
top_loader = loads == "top"
CONTROLS = 0.14
body_depth = depth if top_loader else depth - RIM
tall = height - FOOT - (CONTROLS if top_loader else 0)
shell = body.add(
    hollow_box((body_depth, width, tall), WALL, open="+z" if top_loader else "+x"),
    at=(0, 0, FOOT),
    by="bottom",
)
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
for foot in mirror(mirror((0.4 * body_depth, 0.4 * width, 0)), "x"):
    body.add(cylinder(0.025, FOOT), at=foot, by="bottom", material="rubber")
drum = machine.part("drum", material="stainless_steel")
if top_loader:
    deck, opening = FOOT + tall, 0.3 * min(body_depth, width)
    hole = (0.05, 0, opening)
    body.add(panel((body_depth, width), WALL, [hole]), at=(0, 0, deck), by="top", name="deck")
    console = body.add(
        box((0.1, width, CONTROLS)), at=(back, 0, deck), by="back.bottom", rgb=(0.3, 0.31, 0.33)
    )
    face, level = console.anchor("front")[0], deck + CONTROLS / 2
    bowl = [(0, 0), (opening + 0.02, 0), (opening + 0.02, 0.6 * tall)]
    floor = FOOT + 0.25 * tall
    body.add(
        cylinder(0.04, floor - FOOT - 0.001), at=(0.05, 0, FOOT), by="bottom", material="steel"
    )
    drum.add(lathe(bowl, thickness=0.002), at=(0.05, 0, floor))
    drum.add(cylinder(0.05, 0.4 * tall), at=(0.05, 0, floor), by="bottom", material="polypropylene")
    machine.continuous("spin", body, drum, at=(0.05, 0, floor), axis="up")
    lid = machine.part("lid", material="finish")
    size = (body_depth - 0.16, width - 0.04, 0.014)
    lid.add(box(size), at=(back + 0.145, 0, deck + 0.0005), by="back.bottom")
    pane = box((0.6 * size[0], 0.7 * size[1], 0.001))
    lid.add(pane, at=lid.anchor("top"), material="dark_glass", role="visual")
    lip = (back + 0.14 + size[0], 0, deck + 0.012)
    lid.add(box((0.03, 0.2, 0.01)), at=lip, by="bottom", rgb=(0.5, 0.51, 0.53))
    machine.revolute("lid_hinge", body, lid, at="back.hinge", range=(0, 1.45))
else:
    centre, opening = FOOT + 0.46 * tall, 0.29 * min(width, tall)
    hole = (0, centre - FOOT - tall / 2, opening)
    slot = (-0.3 * width, tall / 2 - 0.075, 0.28 * width, 0.075)
    face, level = x, FOOT + tall - 0.075
    board = panel((width, tall), WALL, [hole, slot])
    body.add(
        board, at=(x, 0, FOOT), rpy=(math.pi / 2, 0, math.pi / 2), by="front.bottom", name="front"
    )
    bowl = [(0, 0), (opening + 0.03, 0), (opening + 0.03, 0.62 * body_depth)]
    end = x - WALL - 0.02 - 0.62 * body_depth
    drum.add(lathe(bowl, thickness=0.002), at=(end, 0, centre), rpy=flat)
    for turn in range(3):
        a = 2 * math.pi * turn / 3
        at = (end + 0.3 * body_depth, opening * math.sin(a), centre + opening * math.cos(a))
        drum.add(
            box((0.5 * body_depth, 0.03, 0.075)), at=at, rpy=(-a, 0, 0), material="polypropylene"
        )
    body.add(
        cylinder(0.05, end - 0.001 - back - 0.02),
        at=(back + 0.02, 0, centre),
        rpy=flat,
        by="back",
        material="steel",
    )
    machine.continuous("spin", body, drum, at=(end, 0, centre), axis="front")
    # The round door: a rim that holds a bowl of glass, hinged at its left.
    door = machine.part("door", material="abs")
    ring = torus(opening + 0.005, RIM / 2 - 0.001, sectors=8)
    rim = door.add(ring, at=(x + 0.001, 0, centre), rpy=flat, by="back", rgb=(0.75, 0.76, 0.78))
    glass = lathe([(0, 0), (0.6 * opening, 0.004), (opening - 0.004, 0.03)], thickness=0.004)
    door.add(glass, at=(x + 0.004, 0, centre), rpy=flat, material="dark_glass")
    hinge = (x + 0.001, opening + 0.02, centre)
    door.add(box((0.02, 0.03, 0.1)), at=hinge, by="back", rgb=(0.6, 0.6, 0.62))
    grip = (x + RIM, -opening + 0.012, centre)
    door.add(box((0.02, 0.02, 0.12)), at=grip, by="front", rgb=(0.5, 0.5, 0.52))
    machine.revolute(
        "door_hinge",
        body,
        door,
        at=door.anchor("left.back"),
        axis=(0, 0, 1),
        range=(0, 1.57),
        opens="front",
    )
    y, z = -0.3 * width, FOOT + tall - 0.075
    soap = machine.part("soap_drawer", material="polypropylene")
    tray = hollow_box((0.22, 0.28 * width - 0.003, 0.055), 0.002)
    soap.add(tray, at=(x - 0.004, y, z - 0.0365), by="front.bottom")
    soap.add(box((0.018, 0.28 * width - 0.003, 0.072)), at=(x + 0.008, y, z), by="front", rgb=shade)
    soap.add(box((0.01, 0.1 * width, 0.012)), at=(x + 0.006, y, z), by="back", rgb=(0.5, 0.5, 0.52))
    machine.prismatic("soap_slide", body, soap, axis="front", range=(0, 0.15))
for k in range(buttons):
    button = machine.part(f"button_{k + 1}", material="abs")
    at = (face + 0.0015, 0.46 * width - 0.03 - 0.032 * k, level)
    button.add(cylinder(0.011, 0.006), at=at, rpy=flat, by="back", rgb=(0.6, 0.62, 0.65))
    machine.prismatic(f"press_{k + 1}", body, button, axis="back", range=(0, 0.0018))
for k in range(knobs):
    knob = machine.part(f"knob_{k + 1}", material="abs")
    at = (
        face + 0.0008,
        -0.02 * width - 0.08 * k if top_loader else 0.02 - 0.07 * k + 0.035 * (knobs - 1),
        level,
    )
    dial = knob.add(cylinder(0.028, 0.025), at=at, rpy=flat, by="back", rgb=(0.7, 0.71, 0.73))
    knob.add(
        box((0.002, 0.004, 0.024)),
        at=dial.anchor("front"),
        by="bottom",
        rgb=(0.1, 0.1, 0.1),
        role="visual",
    )
    machine.continuous(f"turn_{k + 1}", body, knob, at="centre", axis="front")
