import math

from neoworld_mjx.program.sdk import Object, box, difference, extrusion, hollow_box, sweep

# Microwave, given box 0.37 x 0.50 x 0.27 m: door hinged on its right (-y, the picture's left),
# controls at +y.
X, Y, Z = 0.37, 0.50, 0.27
FRONT, PULL, WALL, GAP = 0.035, 0.055, 0.012, 0.0012
DEPTH = X - FRONT - PULL - GAP
SEAM = -Y / 2 + 0.385  # between door and control panel
R = 0.013

oven = Object("fs_microwave", label="microwave oven")
black = oven.material("black_enamel", like="abs", rgb=(0.17, 0.17, 0.17), roughness=0.7)
metal = oven.material(
    "grey_metal", like="aluminium", rgb=(0.62, 0.62, 0.62), metallic=0.2, roughness=0.6
)
dark_glass = oven.material("dark_glass", like="glass", rgb=(0.24, 0.24, 0.24), alpha=0.75)

body = oven.part("body", material=black, mass=10)
cavity = body.add(
    hollow_box((DEPTH, SEAM + Y / 2, Z), WALL, open="+x"),
    at=(0, -Y / 2, 0),
    by="right.bottom",
    name="cavity",
)
x = cavity.anchor("front")[0]
PANEL_W = Y / 2 - SEAM
body.add(
    hollow_box((DEPTH, PANEL_W, Z), WALL, open="+x"),
    at=(0, SEAM, 0),
    by="right.bottom",
    name="compartment",
)

# Control panel, flush with the door, with a pocket for the button bar.
panel_y = SEAM + PANEL_W / 2
BUTTON = (0.010, 0.088, 0.026)
BUTTON_Z = 0.021
face = x + GAP + FRONT
panel = box((FRONT + GAP + 0.002, PANEL_W, Z)).moved(
    (face - (FRONT + GAP + 0.002) / 2, panel_y, Z / 2)
)
pocket = box((0.022, BUTTON[1] + 0.0015, BUTTON[2] + 0.0015)).moved((face, panel_y, BUTTON_Z))
body.add(difference(panel, pocket), name="control_panel")
body.add(
    box((0.002, 0.090, 0.182)),
    at=(face + 0.0002, panel_y, 0.129),
    role="visual",
    rgb=(0.10, 0.10, 0.10),
    name="frame",
)
body.add(
    box((0.002, 0.086, 0.178)),
    at=(face + 0.0006, panel_y, 0.129),
    role="visual",
    rgb=(0.17, 0.17, 0.17),
    name="keypad",
)

button = oven.part("button", material=metal)
button.add(box(BUTTON), at=(face + 0.002, panel_y, BUTTON_Z), by="front", name="bar")
oven.prismatic("button_press", body, button, axis="back", range=(0, 0.0015), opens="back")

# Door: a frame around a recessed window of dark glass.
door = oven.part("door", material=black)
low, high = -Y / 2, SEAM - 0.001
wy, wz = (-Y / 2 + 0.066, -Y / 2 + 0.323), (0.045, 0.223)
outline = [(low, 0.001), (high, 0.001), (high, Z), (low, Z)]
window = [(wy[0], wz[0]), (wy[1], wz[0]), (wy[1], wz[1]), (wy[0], wz[1])]
door.add(
    extrusion(outline, FRONT, holes=[window]),
    at=(x + GAP + FRONT / 2, 0, 0),
    rpy=(math.pi / 2, 0, math.pi / 2),
    name="door_frame",
)
door.add(
    box((0.005, wy[1] - wy[0] + 0.004, wz[1] - wz[0] + 0.004)),
    at=(x + GAP + 0.009, (wy[0] + wy[1]) / 2, (wz[0] + wz[1]) / 2),
    by="back",
    material=dark_glass,
    name="window",
)
oven.revolute(
    "door_hinge",
    body,
    door,
    at=(x + GAP, low, Z / 2),
    axis=(0, 0, -1),
    range=(0, 1.57),
    opens="front",
)

hy, out = -Y / 2 + 0.350, face + PULL - R
path = [(face - 0.003, hy, 0.227), (out, hy, 0.227), (out, hy, 0.032), (face - 0.003, hy, 0.032)]
door.add(sweep(path, radius=R), material=metal, name="handle")
