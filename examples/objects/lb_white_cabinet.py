from neoworld_mjx.program.sdk import Object, box, cylinder, mirror

# Bedside cabinet, box 0.465 x 0.535 x 0.45 m: three drawers with inset fronts, thick bar handles.
X, Y, Z = 0.465, 0.535, 0.45
TOP, LIP, OVER = 0.010, 0.018, 0.024  # top board, its overhang in front and at the sides
SLAB = 0.422  # depth of the top board
BACK = -X / 2
FRONT = BACK + SLAB - LIP  # plane of the fronts and of the front edges of the sides
W, WALL, BASE = Y - 2 * OVER, 0.018, 0.012
DEPTH = FRONT - BACK

cab = Object("lb_white_cabinet", label="white cabinet with three drawers")
white = cab.material(
    "white_wood",
    like="pine",
    rgb=(0.87, 0.86, 0.85),
    rgb2=(0.82, 0.81, 0.80),
    pattern="grain",
    along="y",
)
grey = cab.material(
    "dark_grey_metal", like="aluminium", rgb=(0.30, 0.30, 0.30), metallic=0.1, roughness=0.6
)

body = cab.part("body", material=white)
body.add(box((SLAB, Y, TOP)), at=(BACK, 0, Z), by="back.top", name="top")
side_high = Z - TOP
for name, y, by in (("left_side", W / 2, "left"), ("right_side", -W / 2, "right")):
    body.add(box((DEPTH, WALL, side_high)), at=(BACK, y, 0), by=f"back.{by}.bottom", name=name)
body.add(box((WALL, W - 2 * WALL, side_high)), at=(BACK, 0, 0), by="back.bottom", name="rear")
body.add(box((DEPTH - 0.02, W + 0.006, 0.006)), at=(BACK, 0, 0), by="back.bottom", name="base")
inside = W - 2 * WALL

PITCH = (side_high - BASE) / 3
TRAY = DEPTH - WALL - 0.012
PANEL, R, POST, HANDLE = 0.018, 0.0165, 0.0105, 0.185
PULL = X / 2 - FRONT  # how far the handles protrude
for i, name in enumerate(("bottom_drawer", "middle_drawer", "top_drawer")):
    low = BASE + i * PITCH
    drawer = cab.part(name, material=white)
    high = PITCH - 0.0035
    panel = drawer.add(
        box((PANEL, inside - 0.003, high)),
        at=(FRONT, 0, low + 0.001),
        by="front.bottom",
        name="front",
    )
    # A tray of four boards behind the panel
    tx = FRONT - PANEL
    tall, t = high - 0.03, 0.010
    for side in mirror((tx, inside / 2 - 0.0015 - t / 2, low + 0.008)):
        drawer.add(box((TRAY - PANEL, t, tall)), at=side, by="front.bottom")
    drawer.add(
        box((TRAY - PANEL, inside - 0.003 - 2 * t, 0.006)),
        at=(tx, 0, low + 0.008),
        by="front.bottom",
        name="floor",
    )
    drawer.add(
        box((t, inside - 0.003 - 2 * t, tall - 0.006)),
        at=(tx - TRAY + PANEL, 0, low + 0.014),
        by="back.bottom",
        name="rear",
    )
    hz = low + PITCH / 2
    drawer.add(
        cylinder(R, HANDLE),
        at=(FRONT + PULL, 0, hz),
        rpy=(1.5708, 0, 0),
        by="front",
        material=grey,
        name="bar",
    )
    for post in mirror((FRONT - 0.003, 0.068, hz)):
        drawer.add(
            cylinder(POST, PULL - R + 0.003 - 0.006),
            at=post,
            rpy=(0, 1.5708, 0),
            by="back",
            material=grey,
        )
    cab.prismatic(name + "_slide", body, drawer, axis="front", range=(0, 0.7 * TRAY), opens="front")
