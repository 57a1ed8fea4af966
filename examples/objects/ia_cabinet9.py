from neoworld_mjx.program.sdk import Object, box, hollow_box, mirror

# Base cabinet, box 0.60 x 0.60 x 0.78 m: open at the top between two rails, three drawers.
X, Y, Z = 0.60, 0.60, 0.78
WALL, FRONT, PULL, GAP = 0.018, 0.018, 0.034, 0.001
DEPTH = X - FRONT - PULL - GAP

cab = Object("ia_cabinet9", label="base cabinet with three drawers")
grey = cab.material("light_grey", like="mdf", rgb=(0.74, 0.74, 0.74))
pale = cab.material("pale_tray", like="chipboard", rgb=(0.82, 0.82, 0.82))
metal = cab.material(
    "matt_metal", like="steel", rgb=(0.78, 0.78, 0.78), metallic=0.1, roughness=0.6
)

carcass = cab.part("carcass", material=grey)
shell = carcass.add(hollow_box((DEPTH, Y, Z), WALL, open=["+x", "+z"]), by="bottom")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
inside = Y - 2 * WALL
carcass.add(box((0.072, inside, WALL)), at=(x, 0, Z), by="front.top", name="front_rail")
carcass.add(box((0.095, inside, WALL)), at=(back + WALL, 0, Z), by="back.top", name="rear_rail")

# name, lower and upper edge of the front, height of the tray
HIGH = [0, 0.505 * Z, 0.834 * Z, Z]
TRAY = DEPTH - WALL - 0.012
for name, low, high, deep in (
    ("bottom_drawer", HIGH[0], HIGH[1], 0.20),
    ("middle_drawer", HIGH[1], HIGH[2], 0.16),
    ("top_drawer", HIGH[2], HIGH[3], 0.08),
):
    drawer = cab.part(name, material=grey)
    drawer.add(
        box((FRONT, Y - 0.002, high - low - 0.002)),
        at=(x + GAP, 0, (low + high) / 2),
        by="back",
        name="front",
    )
    tray = hollow_box((TRAY, inside - 0.003, deep), 0.012, open="+z")
    drawer.add(tray, at=(x + GAP, 0, low + 0.022), by="front.bottom", material=pale, name="tray")
    px = drawer.anchor("front")[0]
    hz, length, bar = high - 0.040, 0.19, 0.012
    drawer.add(
        box((bar, length, bar)), at=(px + PULL, 0, hz), by="front", material=metal, name="bar"
    )
    for post in mirror((px - 0.003, length / 2 - bar / 2, hz)):
        drawer.add(box((PULL - 0.006, bar, bar)), at=post, by="back", material=metal)
    cab.prismatic(
        name + "_slide", carcass, drawer, axis=(1, 0, 0), range=(0, 0.7 * TRAY), opens="front"
    )
