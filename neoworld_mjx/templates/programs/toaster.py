# Label: toaster
# PartNet-Mobility: Toaster
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror, panel

depth = 0.3  # 0.26 to 0.4 m
width = 0.17  # 0.15 to 0.19 m
height = 0.19  # 0.17 to 0.21 m
slots = 2  # 1 to 3
buttons = 2  # 1 to 3
style = "steel"  # one of steel, plastic, retro
colour = "white"  # one of white, red, black, mint

OUT, FOOT, TRAY = 0.025, 0.008, 0.025
toaster = Object("toaster", label="toaster")
tint = {
    "white": (0.93, 0.92, 0.9),
    "red": (0.72, 0.1, 0.1),
    "black": (0.12, 0.12, 0.12),
    "mint": (0.6, 0.82, 0.75),
}
toaster.material("casing", like="abs", rgb=tint[colour])
toaster.material("shell", like="abs", rgb=(0.75, 0.76, 0.78) if style == "steel" else tint[colour])
body = toaster.part("body", material="shell", mass=1.6)
long = depth - OUT
base = FOOT + TRAY + 0.008
for foot in mirror(mirror((0.4 * long, 0.38 * width, 0)), "x"):
    body.add(cylinder(0.012, FOOT), at=foot, by="bottom", material="rubber")
# Between the feet and the slots a bay for the crumb tray, open at the back.
bay = body.add(
    hollow_box((long, width, base - FOOT), 0.004, open="-x"),
    at=(0, 0, FOOT),
    by="bottom",
    material="casing",
)
x = bay.anchor("front")[0]
# Slots of bread, side by side, from the base to the top.
gap, inner = 0.034, long - 0.07
lines = [(k - (slots - 1) / 2) * min(0.05, 0.8 * width / slots) for k in range(slots)]
block = panel(
    (long - (0.02 if style == "retro" else 0), width),
    height - base,
    [(0, y, inner, gap) for y in lines],
)
body.add(block, at=(0, 0, base), by="bottom", name="block")
if style == "retro":
    for side in mirror((0, width / 2 - 0.001, base + 0.5 * (height - base))):
        body.add(box((0.8 * long, 0.002, 0.012)), at=side, rgb=(0.8, 0.8, 0.82), role="visual")
    for end in mirror((long / 2, 0, FOOT), "x"):
        by = "front.bottom" if end[0] > 0 else "back.bottom"
        body.add(
            box((0.012, width - 0.02, height - FOOT - 0.012)), at=end, by=by, material="casing"
        )
else:
    body.add(
        box((0.004, 0.9 * width, height - base - 0.02)),
        at=(x, 0, base),
        by="back.bottom",
        material="casing",
    )
face = x + (0 if style == "retro" else 0.004)

# The lever carries the racks down.
lever = toaster.part("lever", material="abs")
drop, z = 0.4 * (height - base), height - 0.03
lever.add(
    box((x + OUT - face - 0.0008, 0.035, 0.014)),
    at=(face + 0.0008, 0, z),
    by="back",
    rgb=(0.15, 0.15, 0.16),
)
body.add(
    box((0.001, 0.006, drop + 0.02)),
    at=(face, 0, z + 0.01),
    by="back.top",
    rgb=(0.05, 0.05, 0.05),
    role="visual",
)
push = toaster.prismatic("lever_push", body, lever, axis="down", range=(0, drop), friction=0.5)
for k, y in enumerate(lines):
    rack = toaster.part(f"rack_{k + 1}", material="steel")
    at = (0, y, height - 0.55 * (height - base))
    rack.add(box((inner - 0.02, 0.004, 0.004)), at=at)
    for i in range(5):
        cross = ((i - 2) * (inner - 0.03) / 4, y, at[2])
        rack.add(box((0.004, gap - 0.002, 0.004)), at=cross)
    toaster.prismatic(
        f"rack_sink_{k + 1}", body, rack, axis="down", range=(0, drop), mimic=push, friction=0.5
    )

knob = toaster.part("knob", material="abs")
spot = (face + 0.0008, 0, base + 0.022)
dial = knob.add(
    cylinder(0.014, 0.015), at=spot, rpy=(0, math.pi / 2, 0), by="back", rgb=(0.75, 0.75, 0.77)
)
knob.add(
    box((0.002, 0.003, 0.012)),
    at=dial.anchor("front"),
    by="bottom",
    rgb=(0.8, 0.1, 0.1),
    role="visual",
)
toaster.continuous("browning", body, knob, at=dial.anchor("centre"), axis="front")
for k in range(buttons):
    button = toaster.part(f"button_{k + 1}", material="abs")
    at = (face + 0.0015, 0.3 * width, base + 0.018 + 0.024 * k)
    button.add(box((0.005, 0.02, 0.014)), at=at, by="back", rgb=(0.7, 0.7, 0.72))
    toaster.prismatic(f"press_{k + 1}", body, button, axis="back", range=(0, 0.0018))
tray = toaster.part("crumb_tray", material="steel")
tray.add(
    hollow_box((long - 0.02, width - 0.014, 0.012), 0.001),
    at=(-long / 2 + 0.004, 0, FOOT + 0.0045),
    by="back.bottom",
)
tray.add(
    box((0.004, 0.06, 0.018)), at=(-long / 2, 0, FOOT + 0.0045), by="back.bottom", material="casing"
)
toaster.prismatic("tray_slide", body, tray, axis="back", range=(0, 0.7 * long))
