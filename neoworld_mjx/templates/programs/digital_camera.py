# Label: digital camera
# PartNet-Mobility: Camera
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, rounded_box, tube

depth = 0.11  # 0.085 to 0.15 m
width = 0.13  # 0.11 to 0.15 m
height = 0.095  # 0.085 to 0.11 m
top = "flash"  # one of flash, shoe
screen = "flip"  # one of flip, fixed
buttons = 3  # 2 to 4
colour = "black"  # one of black, silver, brown

flat = (0, math.pi / 2, 0)
camera = Object("digital_camera", label="digital camera")
tones = {"black": (0.11, 0.11, 0.12), "silver": (0.72, 0.72, 0.73), "brown": (0.42, 0.28, 0.18)}
camera.material("case", like="electronics", rgb=tones[colour])
camera.material("dark", like="abs", rgb=(0.1, 0.1, 0.11))
body = camera.part("body", material="case")
deep, SCREEN = 0.045, 0.011
back = -depth / 2 + SCREEN
x = back + deep
roof = height - (0.022 if top == "flash" else 0.012)
body.add(rounded_box((deep, width, roof), 0.006), at=(back, 0, 0), by="back.bottom")
grip = rounded_box((0.03, 0.035, 0.92 * roof), 0.008)
body.add(grip, at=(x + 0.014, -width / 2, 0.004), by="front.right.bottom", material="dark")
body.add(
    box((deep + 0.001, width - 0.012, 0.012)),
    at=(back, 0, roof - 0.001),
    by="back.top",
    rgb=(0.2, 0.2, 0.21),
)

# Mount, focus ring, zoom ring that slides out with the front glass.
axis = (0.06 * width, 0.47 * roof)
radius, reach = min(0.42 * roof, 0.034), depth - SCREEN - deep
body.add(
    tube(radius, 0.006, 0.3 * reach, sectors=24),
    at=(x - 0.001, *axis),
    rpy=flat,
    by="back",
    material="dark",
)
body.add(
    cylinder(radius - 0.007, 0.72 * reach),
    at=(x - 0.001, *axis),
    rpy=flat,
    by="back",
    material="dark",
)
focus = camera.part("focus_ring", material="dark")
ring = tube(radius, 0.0045, 0.36 * reach, sectors=24)
focus.add(ring, at=(x + 0.3 * reach, *axis), rpy=flat, by="back", rgb=(0.22, 0.22, 0.23))
for k in range(12):
    a = math.pi * k / 6
    rib = (x + 0.48 * reach, axis[0] + radius * math.sin(a), axis[1] + radius * math.cos(a))
    focus.add(box((0.3 * reach, 0.003, 0.001)), at=rib, rpy=(-a, 0, 0), rgb=(0.3, 0.3, 0.32))
camera.continuous("focus", body, focus, at=(x + 0.4 * reach, *axis), axis="front")
zoom = camera.part("zoom", material="dark")
front = (x + reach, *axis)
zoom.add(tube(radius - 0.003, 0.0055, 0.3 * reach, sectors=24), at=front, rpy=flat, by="front")
zoom.add(
    cylinder(radius - 0.008, 0.004),
    at=(x + 0.72 * reach + 0.0005, *axis),
    rpy=flat,
    by="back",
    rgb=(0.08, 0.1, 0.22),
)
camera.prismatic("zoom_out", body, zoom, axis="front", range=(0, 0.4 * reach), friction=0.6)

shutter = camera.part("shutter", material="steel")
shutter.add(cylinder(0.006, 0.005), at=(x - 0.012, -0.38 * width, roof + 0.0015), by="bottom")
camera.prismatic("shutter_press", body, shutter, axis="down", range=(0, 0.0014), friction=0.3)
dial = camera.part("mode_dial", material="dark")
dial.add(
    cylinder(0.011, 0.009),
    at=(back + 0.018, -0.24 * width, roof + 0.0006),
    by="bottom",
    rgb=(0.3, 0.3, 0.32),
)
camera.continuous("mode", body, dial, at=dial.anchor("centre"), axis="up")
hump = (back + 0.5 * deep, axis[0], roof - 0.001)
if top == "flash":
    body.add(box((0.8 * deep, 0.034, 0.014)), at=hump, by="bottom")
    flash = camera.part("flash", material="dark")
    low = roof + 0.0136
    lid = flash.add(
        box((0.9 * deep, 0.036, height - low)), at=(hump[0] + 0.1 * deep, axis[0], low), by="bottom"
    )
    lens = box((0.001, 0.026, 0.6 * (height - low)))
    flash.add(lens, at=lid.anchor("front"), rgb=(0.92, 0.92, 0.85), role="visual")
    camera.revolute("flash_up", body, flash, at="back.hinge", range=(0, 1.1), friction=0.02)
else:
    body.add(box((0.02, 0.02, height - roof + 0.001)), at=hump, by="bottom", material="steel")

face = back - 0.0008
y = 0.12 * width
if screen == "flip":
    # The screen turns out to the left on a bracket, then about its own length.
    hinge = camera.part("screen_hinge", material="dark")
    edge = y + 0.3 * width
    hinge.add(box((0.008, 0.008, 0.4 * roof)), at=(face, edge, 0.45 * roof), by="front")
    camera.revolute(
        "screen_out",
        body,
        hinge,
        at=(face - 0.0004, edge + 0.004, 0.45 * roof),
        axis=(0, 0, -1),
        range=(0, 1.57),
        friction=0.03,
    )
    leaf = camera.part("screen", material="dark")
    board = leaf.add(
        box((SCREEN - 0.0018, 0.56 * width, 0.62 * roof)),
        at=(-depth / 2, edge - 0.0048, 0.45 * roof),
        by="back.left",
    )
    camera.revolute(
        "screen_turn",
        hinge,
        leaf,
        at=board.anchor("left"),
        axis=(0, 1, 0),
        range=(0, 3.1),
        friction=0.02,
        after=hinge,
    )
else:
    board = body.add(
        box((SCREEN, 0.56 * width, 0.62 * roof)), at=(back + 0.0002, y, 0.45 * roof), by="front"
    )
glass = box((0.0006, 0.5 * width, 0.54 * roof))
(leaf if screen == "flip" else body).add(
    glass, at=board.anchor("back"), rgb=(0.1, 0.16, 0.28), role="visual"
)
for k in range(buttons):
    button = camera.part(f"button_{k + 1}", material="abs")
    at = (back - 0.0015, -0.37 * width, 0.2 * roof + 0.17 * roof * k)
    button.add(cylinder(0.005, 0.003), at=at, rpy=flat, by="front", rgb=(0.55, 0.55, 0.57))
    camera.prismatic(f"press_{k + 1}", body, button, axis="front", range=(0, 0.0014))
