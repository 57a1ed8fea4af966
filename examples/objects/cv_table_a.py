import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, rounded_box, sphere, tube

# Play desk: a table with a slanted cabinet along its back. It fills 0.595 x 1.20 x 0.957 m.
X, Y = 0.495, 1.20  # of the table, without the drawer's handle
H, T = 0.604, 0.889  # heights of the table top and of the cabinet
TOP, LEG, BOARD = 0.049, 0.055, 0.015
BACK, FOOT, RIDGE = (
    -X / 2,
    -0.020,
    -0.193,
)  # x of the back, of the slope's foot and of its upper edge
A = math.atan2(FOOT - RIDGE, T - H)  # the slope's angle from the vertical
LENGTH = math.hypot(FOOT - RIDGE, T - H)
ON_SLOPE = (0, -A, 0)  # turns x out of the slope, z up along it


def on_slope(up, y, out):
    return (
        FOOT - up * math.sin(A) + out * math.cos(A),
        y,
        H + up * math.cos(A) + out * math.sin(A),
    )


desk = Object("cv_table_a", label="play desk with drawer, sliding door, slider and button")
wood = desk.material(
    "brown_wood", like="pine", rgb=(0.62, 0.42, 0.24), rgb2=(0.52, 0.34, 0.19), pattern="grain"
)
light = desk.material(
    "light_wood", like="pine", rgb=(0.74, 0.50, 0.30), rgb2=(0.64, 0.42, 0.24), pattern="grain"
)
black = desk.material("black_plastic", like="abs", rgb=(0.015, 0.015, 0.015), roughness=0.9)
white = desk.material("white_plastic", like="abs", rgb=(0.95, 0.95, 0.95))

# Table.
body = desk.part("body", material=wood)
body.add(box((X, Y, TOP)), at=(0, 0, H), by="top", name="table_top")
UNDER = H - TOP
for i, sx in enumerate((-1, 1)):
    for j, sy in enumerate((-1, 1)):
        at = (sx * (X - LEG) / 2, sy * (Y - LEG) / 2, 0)
        body.add(box((LEG, LEG, UNDER)), at=at, by="bottom", name=f"leg_{i}{j}")
for i, sy in enumerate((-1, 1)):
    body.add(
        box((X - 2 * LEG, 0.02, 0.13)),
        at=(0, sy * (Y / 2 - 0.02), UNDER),
        by="top",
        name=f"side_apron_{i}",
    )
body.add(box((0.02, Y - 2 * LEG, 0.13)), at=(BACK + 0.03, 0, UNDER), by="top", name="back_apron")

# Front aprons, set back, and the drawer's housing between them.
FRONT_X = X / 2 - 0.031
LOW_Y, HIGH_Y, FLOOR, CEILING = -0.165, 0.420, 0.430, 0.538
for name, low, high in (
    ("front_apron_0", -Y / 2 + LEG, LOW_Y),
    ("front_apron_1", HIGH_Y, Y / 2 - LEG),
):
    body.add(
        box((0.02, high - low, 0.13)), at=(FRONT_X, low, UNDER), by="front.right.top", name=name
    )
RUN = FRONT_X - (BACK + 0.03)
for i, (y, side) in enumerate(((LOW_Y, "left"), (HIGH_Y, "right"))):
    body.add(
        box((RUN, 0.012, UNDER - FLOOR + 0.012)),
        at=(FRONT_X, y, UNDER),
        by=f"front.{side}.top",
        name=f"housing_{i}",
    )
body.add(
    box((RUN, HIGH_Y - LOW_Y + 0.02, 0.010)),
    at=(FRONT_X, (LOW_Y + HIGH_Y) / 2, FLOOR),
    by="front.top",
    name="housing_floor",
)

# Slanted cabinet: a back, a ridge, two closed ends, and two compartments between them.
profile = [(FOOT, H), (RIDGE, T), (BACK, T), (BACK, H)]


def cheek(name, low, high):
    body.add(
        extrusion(profile, high - low),
        at=(0, (low + high) / 2, 0),
        rpy=(math.pi / 2, 0, 0),
        name=name,
    )


def slope_board(name, low, high, up, length, material):
    body.add(
        box((BOARD, high - low, length)),
        at=on_slope(up + length / 2, (low + high) / 2, -BOARD / 2),
        rpy=ON_SLOPE,
        material=material,
        name=name,
    )


body.add(
    box((BOARD, Y, T - H + 0.002)), at=(BACK, 0, H - 0.002), by="back.bottom", name="cabinet_back"
)
body.add(box((RIDGE - BACK, Y, BOARD)), at=(BACK, 0, T), by="back.top", name="ridge")
for name, low, high in (
    ("cheek_0", -Y / 2, -Y / 2 + BOARD),
    ("cheek_1", -0.512, -0.497),
    ("divider_0", -0.130, -0.115),
    ("divider_1", 0.255, 0.270),
    ("cheek_2", Y / 2 - BOARD, Y / 2),
):
    cheek(name, low, high)
slope_board("end_board_0", -Y / 2, -0.497, 0, LENGTH, light)
slope_board("end_board_1", 0.265, Y / 2, 0, LENGTH, light)
slope_board("upper_strip", -0.500, 0.268, LENGTH - 0.030, 0.030, wood)

# Sliding door in front of the slope; it moves to the right (-y), in front of the open compartment.
door = desk.part("sliding_door", material=light)
GAP, LEAF = 0.001, 0.014
door.add(
    box((LEAF, 0.395, 0.304)),
    at=on_slope(0.006 + 0.152, 0.0675, GAP + LEAF / 2),
    rpy=ON_SLOPE,
    name="leaf",
)
desk.prismatic("door_slide", body, door, axis="right", range=(0, 0.36), opens="right")
HANDLE_Y, OUT = 0.075, 0.100
door.add(
    box((0.030, 0.048, 0.205)),
    at=on_slope(0.1575, HANDLE_Y, OUT - 0.015),
    rpy=ON_SLOPE,
    material=black,
    name="grip",
)
for i, up in enumerate((0.0725, 0.2425)):
    out = (GAP + LEAF - 0.003, OUT - 0.028)
    door.add(
        box((out[1] - out[0], 0.048, 0.035)),
        at=on_slope(up, HANDLE_Y, sum(out) / 2),
        rpy=ON_SLOPE,
        material=black,
        name=f"grip_post_{i}",
    )

# Slider in two slots.
SLIDER_Y, SLIDER_UP, TRAVEL = 0.425, 0.105, 0.125
for i, y in enumerate((0.345, 0.482)):
    body.add(
        box((0.002, 0.010, 0.175)),
        at=on_slope(0.1675, y, 0),
        rpy=ON_SLOPE,
        role="visual",
        rgb=(0.18, 0.11, 0.05),
        name=f"slot_{i}",
    )
    body.add(
        box((0.002, 0.026, 0.010)),
        at=on_slope(0.252, y - 0.008, 0),
        rpy=ON_SLOPE,
        role="visual",
        rgb=(0.18, 0.11, 0.05),
        name=f"slot_end_{i}",
    )
slider = desk.part("slider", material=white)
slider.add(
    rounded_box((0.075, 0.190, 0.040), 0.008),
    at=on_slope(SLIDER_UP, SLIDER_Y, GAP + 0.0375),
    rpy=ON_SLOPE,
    name="block",
)
desk.prismatic(
    "slider_slide",
    body,
    slider,
    axis=(-math.sin(A), 0, math.cos(A)),
    range=(0, TRAVEL),
    friction=6,
    opens="up",
)

# Light bar and lamp on the ridge.
body.add(
    box((0.040, 0.220, 0.022)),
    at=(-0.228, -0.380, T),
    by="bottom",
    material=white,
    name="light_bar",
)
body.add(
    cylinder(0.022, 0.008), at=(-0.220, 0.411, T), by="bottom", material=white, name="lamp_socket"
)
body.add(sphere(0.034), at=(-0.220, 0.411, 0.923), material=white, name="lamp")

# Push button in a wooden collar.
BX, BY = 0.153, -0.372
body.add(tube(0.0565, 0.0080, 0.026, sectors=24), at=(BX, BY, H), by="bottom", name="collar")
button = desk.part("button", material=black)
button.add(cylinder(0.0475, 0.050), at=(BX, BY, H + 0.008), by="bottom", name="cap")
desk.prismatic("button_press", body, button, axis="down", range=(0, 0.006), opens="down")

# Drawer.
drawer = desk.drawer(
    "drawer",
    body,
    x=FRONT_X,
    y=(LOW_Y, HIGH_Y),
    z=(FLOOR, CEILING),
    depth=0.40,
    front=0.030,
    overlay=0.010,
    travel=0.28,
    material=wood,
)
fx = drawer.anchor("front")[0]
END = X / 2 + 0.100
drawer.add(
    box((0.030, 0.315, 0.045)), at=(END, 0.137, 0.488), by="front", material=black, name="pull"
)
for i, y in enumerate((-0.0055, 0.2795)):
    drawer.add(
        box((END - 0.028 - fx + 0.003, 0.030, 0.045)),
        at=(fx - 0.003, y, 0.488),
        by="back",
        material=black,
        name=f"pull_post_{i}",
    )
