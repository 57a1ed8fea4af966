# Label: computer display
# PartNet-Mobility: Display
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, rounded_box

depth = 0.22  # 0.18 to 0.28 m
width = 0.6  # 0.48 to 0.9 m
height = 0.5  # 0.42 to 0.56 m
foot = "plate"  # one of plate, disc, legs
turns = "yes"  # one of yes, no
buttons = 4  # 3 to 6
finish = "black"  # one of black, silver, white

display = Object("computer_display", label="computer display")
shade = {"black": (0.1, 0.1, 0.11), "silver": (0.7, 0.71, 0.73), "white": (0.93, 0.93, 0.93)}[
    finish
]
display.material("case", like="abs", rgb=shade)
base = display.part("base", material="case", mass=2.6)
THICK, wide = 0.03, min(0.5 * width, 0.32)
back = -depth / 2
if foot == "plate":
    base.add(box((depth, wide, 0.012)), by="bottom")
elif foot == "disc":
    base.add(cylinder(depth / 2, 0.012), by="bottom")
else:
    for sign in (-1, 1):
        leg = box((depth * 1.0, 0.03, 0.012))
        base.add(leg, at=(0, sign * (wide / 2 - 0.02), 0), by="bottom")
    base.add(box((0.08, wide - 0.02, 0.012)), at=(back + 0.04, 0, 0), by="bottom")
post_x = back + 0.045
base.add(cylinder(0.035, 0.012), at=(post_x, 0, 0.0115), by="bottom")

column = display.part("column", material="case")
screen = min(0.85 * height, 0.62 * width)
centre = height - screen / 2
tall = centre + 0.02 - 0.0245
column.add(box((0.03, 0.05, tall)), at=(post_x, 0, 0.0243), by="bottom")
if turns == "yes":
    display.continuous("swivel", base, column, at=(post_x, 0, 0.024), axis="up", friction=0.3)
else:
    display.fixed("post", base, column)
slider = display.part("slider", material="aluminium")
slider.add(box((0.012, 0.044, 0.09)), at=(post_x + 0.0158, 0, centre), by="back")
display.prismatic(
    "lift", column, slider, axis="up", range=(-0.4 * (height - screen), 0.03), friction=45
)
joint = post_x + 0.0278
head = display.part("head", material="case")
head.add(cylinder(0.012, 0.05), at=(joint + 0.0125, 0, centre), rpy=(math.pi / 2, 0, 0))
head.add(box((0.02, 0.06, 0.06)), at=(joint + 0.018, 0, centre), by="back")
display.revolute(
    "tilt",
    slider,
    head,
    at=(joint + 0.006, 0, centre),
    axis=(0, -1, 0),
    range=(-0.08, 0.3),
    friction=6,
)
panel = display.part("panel", material="case", mass=2.8)
face = panel.add(
    rounded_box((THICK, width, screen), 0.006), at=(joint + 0.0388, 0, centre), by="back"
)
x = face.anchor("front")[0]
area = box((0.001, width - 0.02, screen - 0.035))
panel.add(area, at=(x, 0, centre + 0.0075), by="back", rgb=(0.12, 0.2, 0.34), role="visual")
line = (joint + 0.0388, 0, centre)
if turns == "yes":
    display.revolute("pivot", head, panel, at=line, axis="front", range=(-0.12, 0.12), friction=2)
else:
    display.fixed("mount", head, panel)
for k in range(buttons):
    button = display.part(f"button_{k + 1}", material="abs")
    at = (x - 0.012, -width / 2 + 0.04 + 0.024 * k, height - screen - 0.0015)
    button.add(box((0.008, 0.014, 0.003)), at=at, by="top", rgb=(0.5, 0.5, 0.52))
    display.prismatic(f"press_{k + 1}", panel, button, axis="up", range=(0, 0.0014))
